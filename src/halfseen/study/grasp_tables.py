"""From the pieces of the grasp ablation to its tables."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from halfseen.study.design import StudyDesign
from halfseen.study.grasp import NUM_BINS, ORACLE
from halfseen.study.results import GRASP_MEASURES
from halfseen.study.statistics import holm, mean_and_error, paired_test

CLAIMED, RIVAL = "svm", "beta"
"""The paper claims that the first is better than the second."""


def grasp_frame(pieces: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """One row for each model, size of log and repetition."""
    return pd.DataFrame([{"repetition": piece["repetition"]} | row for piece in pieces for row in piece["grasp"]])


def grasp_table(frame: pd.DataFrame, design: StudyDesign) -> pd.DataFrame:
    """Mean of every measure with its standard error, and the paired difference from the true model with its own."""
    values = _values(frame)
    rows = []
    for num_paths in design.grasp_num_paths:
        for model in dict.fromkeys(frame["model"]):
            row: dict[str, Any] = {
                "model": model,
                "num_paths": num_paths,
                "cut_share": design.table_cut_share,
                "repetitions": frame["repetition"].nunique(),
            }
            for measure in GRASP_MEASURES:
                own, true = values[measure, num_paths, model], values[measure, num_paths, ORACLE]
                row[measure], row[f"{measure}_se"] = mean_and_error(own)
                row[f"{measure}_over_oracle"], row[f"{measure}_over_oracle_se"] = mean_and_error(own - true)
            rows.append(row)
    return pd.DataFrame(rows)


def grasp_tests(frame: pd.DataFrame, design: StudyDesign) -> pd.DataFrame:
    """Test whether the SVM is better than the Beta mean, on every measure and at every size of log.

    The tests are those of Table 1: one-sided, paired by repetition, adjusted together; the effect is SVM − Beta.
    """
    values = _values(frame)
    rows = []
    for measure in GRASP_MEASURES:
        for num_paths in design.grasp_num_paths:
            ours, other = values[measure, num_paths, CLAIMED], values[measure, num_paths, RIVAL]
            test = paired_test(ours, other, is_more_better=measure.endswith("reward"))
            means = float(np.mean(ours)), float(np.mean(other))
            rows.append((measure, num_paths, *means, test.p_value, test.effect, test.effect_low, test.effect_high))
    columns = ["measure", "num_paths", CLAIMED, RIVAL, "p_value", "effect", "effect_low", "effect_high"]
    table = pd.DataFrame(rows, columns=pd.Index(columns))
    table["p_holm"] = holm(table["p_value"].to_numpy())
    table["supported"] = table["p_holm"] < design.alpha
    return table.loc[:, [*columns[:5], "p_holm", "effect", "supported", "effect_low", "effect_high"]]


def calibration(frame: pd.DataFrame) -> pd.DataFrame:
    """Share of attempts that succeeded against the mean predicted chance, by bin of predicted chances.

    The standard error is of their difference, over repetitions: attempts of one path are no independent draws.
    """
    rows = []
    for num_paths in dict.fromkeys(frame["num_paths"]):
        for model in dict.fromkeys(frame["model"]):
            chosen = frame[(frame["num_paths"] == num_paths) & (frame["model"] == model)]
            bins = chosen["bins"].tolist()
            attempts, chances, successes = (
                np.array([of[name] for of in bins], dtype=np.float64) for name in ("attempts", "chances", "successes")
            )
            for k in range(NUM_BINS):
                total = attempts[:, k].sum()
                if total == 0:
                    continue
                chance, share = chances[:, k].sum() / total, successes[:, k].sum() / total
                residual = successes[:, k] - chances[:, k] - (share - chance) * attempts[:, k]
                error = np.sqrt(len(bins) / (len(bins) - 1) * np.sum(residual**2)) / total
                rows.append((model, num_paths, k / NUM_BINS, int(total), chance, share, error))
    columns = ["model", "num_paths", "bin_from", "attempts", "mean_chance", "share_succeeded", "se"]
    return pd.DataFrame(rows, columns=pd.Index(columns))


def _values(frame: pd.DataFrame) -> dict[tuple[str, int, str], np.ndarray]:
    """Values over repetitions, by measure, size of log and model."""
    ordered = frame.sort_values("repetition")
    values = {}
    for row in frame[["num_paths", "model"]].drop_duplicates().itertuples(index=False):
        num_paths, model = int(row[0]), str(row[1])
        group = ordered[(ordered["num_paths"] == num_paths) & (ordered["model"] == model)]
        for measure in GRASP_MEASURES:
            values[measure, num_paths, model] = np.asarray(group[measure], dtype=np.float64)
    return values
