"""From the pieces of the experiment to its tables."""

from typing import Any

import numpy as np
import pandas as pd

from halfseen.study.experiment import Pieces, Setting, Tables
from halfseen.study.experiments.grasp.design import CLAIMED, MEASURES, NUM_BINS, ORACLE, RIVAL, GraspDesign
from halfseen.study.statistics import adjusted, columns, over_repetitions, paired_test, tested_columns

Values = dict[tuple[str, int, str], np.ndarray]
"""Values over repetitions, by measure, size of log and model."""


def tables_of(design: GraspDesign, setting: Setting, pieces: Pieces) -> Tables:
    """Make all tables.

    Returns
    -------
    dict of pandas.DataFrame
        ``grasp``: model, num_paths, cut_share, repetitions; and of each measure its mean, ``…_se``, ``…_low`` and
        ``…_high``, and the same of ``…_over_oracle``, the paired difference from the true model.
        ``grasp_tests``: measure, num_paths, svm, beta, p_value, p_holm, effect, supported, effect_low, effect_high:
        whether the SVM is better than the Beta mean, tests as in Table 1; the effect is svm − beta.
        ``figure5``: model, num_paths, bin_from, attempts, mean_probability, share_succeeded, difference, se, low,
        high: calibration; the difference is share_succeeded − mean_probability.
    """
    frame = pd.DataFrame([{"index": piece["index"]} | row for piece in pieces.repetitions for row in piece["grasp"]])
    values: Values = {
        (measure, int(key[0]), str(key[1])): group.sort_values("index")[measure].to_numpy(dtype=float)  # pyright: ignore
        for key, group in frame.groupby(["num_paths", "model"], sort=False)
        for measure in MEASURES
    }
    return {
        "grasp": _means(design, frame, values),
        "grasp_tests": adjusted(pd.DataFrame(_tests(design, values)), setting.alpha),
        "figure5": calibration(frame),
    }


def _means(design: GraspDesign, frame: pd.DataFrame, values: Values) -> pd.DataFrame:
    rows = []
    for size in design.num_paths:
        for model in dict.fromkeys(frame["model"]):
            row: dict[str, Any] = {"model": model, "num_paths": size, "cut_share": design.cut_share}
            row["repetitions"] = frame["index"].nunique()
            for measure in MEASURES:
                own, true = values[measure, size, model], values[measure, size, ORACLE]
                for name, of in ((measure, own), (f"{measure}_over_oracle", own - true)):
                    row |= columns(over_repetitions(of), name, f"{name}_se", f"{name}_low", f"{name}_high")
            rows.append(row)
    return pd.DataFrame(rows)


def _tests(design: GraspDesign, values: Values) -> list[dict[str, Any]]:
    rows = []
    for measure in MEASURES:
        for size in design.num_paths:
            ours, other = values[measure, size, CLAIMED], values[measure, size, RIVAL]
            test = tested_columns(paired_test(ours, other, is_more_better=measure.endswith("reward")))
            means = {CLAIMED: float(ours.mean()), RIVAL: float(other.mean())}
            rows.append({"measure": measure, "num_paths": size} | means | test)
    return rows


def calibration(frame: pd.DataFrame) -> pd.DataFrame:
    """Proportion of attempts that succeeded against the mean predicted probability, by bin of predictions.

    The interval is of their difference, over repetitions: attempts of one path are no independent draws.
    """
    rows = []
    for key, chosen in frame.groupby(["num_paths", "model"], sort=False):
        bins = chosen["bins"].tolist()
        attempts, said, successes = (
            np.array([of[name] for of in bins], dtype=np.float64) for name in ("attempts", "probabilities", "successes")
        )
        for k in np.flatnonzero(attempts.sum(axis=0)):
            total = attempts[:, k].sum()
            mean, share = said[:, k].sum() / total, successes[:, k].sum() / total
            # The ratio's error is that of the mean of its residuals.
            residual = successes[:, k] - said[:, k] - (share - mean) * attempts[:, k]
            spread = over_repetitions(residual * len(bins) / total)
            place = {"model": key[1], "num_paths": key[0], "bin_from": k / NUM_BINS, "attempts": int(total)}  # pyright: ignore
            found = {"mean_probability": mean, "share_succeeded": share, "difference": share - mean}
            ends = {"se": spread.standard_error, "low": share - mean + spread.low, "high": share - mean + spread.high}
            rows.append(place | found | ends)
    return pd.DataFrame(rows)
