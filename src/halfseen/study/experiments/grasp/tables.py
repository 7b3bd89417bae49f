"""From the pieces of the experiment to its tables."""

from typing import Any

import numpy as np
import pandas as pd

from halfseen.study.experiment import Pieces, Setting, Tables
from halfseen.study.experiments.grasp.design import CLAIMED, MEASURES, NUM_BINS, ORACLE, RIVAL, GraspDesign
from halfseen.study.frames import stacked
from halfseen.study.statistics import adjusted, mean_columns, over_repetitions, paired_test, tested_columns
from halfseen.study.wording import is_reward

Found = dict[tuple[int, str], dict[str, Any]]
"""What was measured, as arrays over repetitions, by size of log and model."""


def tables_of(design: GraspDesign, setting: Setting, pieces: Pieces) -> Tables:
    """Make all tables.

    Returns
    -------
    dict of pandas.DataFrame
        ``grasp``: model, num_trajectories, cut_share, repetitions, and stood_in, in how many the Beta mean stood in for
        it; and of each measure its mean, ``…_se``, ``…_low`` and ``…_high``, and the same of ``…_over_oracle``, the
        paired difference from the true model. ``grasp_tests``: measure, num_trajectories, svm, beta, p_value, p_holm,
        effect, supported, effect_low, effect_high: whether the SVM is better than the Beta mean, tests as in Table 1;
        the effect is svm − beta. ``figure5``: model, num_trajectories, bin_from, attempts, mean_probability,
        share_succeeded, difference, se, low, high: calibration; the difference is share_succeeded − mean_probability.
    """
    rows = stacked(pieces.repetitions, "grasp", *MEASURES, "bins", "stands_in")
    found = {(row["num_trajectories"], row["model"]): row for row in rows}
    return {
        "grasp": _means(design, found),
        "grasp_tests": adjusted(_tests(design, found), setting.alpha),
        "figure5": pd.DataFrame([line for row in rows for line in calibration(row)]),
    }


def _means(design: GraspDesign, found: Found) -> pd.DataFrame:
    rows = []
    for (size, model), values in found.items():
        row: dict[str, Any] = {"model": model, "num_trajectories": size, "cut_share": design.cut_share}
        row |= {"repetitions": len(values["bins"]), "stood_in": int(values["stands_in"].sum())}
        for measure in MEASURES:
            over = values[measure] - found[size, ORACLE][measure]
            for name, of in ((measure, values[measure]), (f"{measure}_over_oracle", over)):
                row |= mean_columns(of, name, f"{name}_se", f"{name}_low", f"{name}_high")
        rows.append(row)
    return pd.DataFrame(rows)


def _tests(design: GraspDesign, found: Found) -> pd.DataFrame:
    rows = []
    for measure in MEASURES:
        for size in design.num_trajectories:
            ours, other = found[size, CLAIMED][measure], found[size, RIVAL][measure]
            test = tested_columns(paired_test(ours, other, is_more_better=is_reward(measure)))
            means = {CLAIMED: float(ours.mean()), RIVAL: float(other.mean())}
            rows.append({"measure": measure, "num_trajectories": size} | means | test)
    return pd.DataFrame(rows)


def calibration(row: dict[str, Any]) -> list[dict[str, Any]]:
    """Proportion of attempts that succeeded against the mean predicted probability, by bin of predictions.

    The interval is of their difference, over repetitions: attempts of one trajectory are no independent draws.
    """
    attempts, said, successes = (
        np.array([bins[name] for bins in row["bins"]], dtype=np.float64)
        for name in ("attempts", "probabilities", "successes")
    )
    lines = []
    for k in np.flatnonzero(attempts.sum(axis=0)):
        total = attempts[:, k].sum()
        mean, share = said[:, k].sum() / total, successes[:, k].sum() / total
        # The ratio's error is that of the mean of its residuals.
        residual = successes[:, k] - said[:, k] - (share - mean) * attempts[:, k]
        spread = over_repetitions(residual * len(attempts) / total)
        place = {
            "model": row["model"],
            "num_trajectories": row["num_trajectories"],
            "bin_from": k / NUM_BINS,
            "attempts": int(total),
        }
        means = {"mean_probability": mean, "share_succeeded": share, "difference": share - mean}
        ends = {"se": spread.standard_error, "low": share - mean + spread.low, "high": share - mean + spread.high}
        lines.append(place | means | ends)
    return lines
