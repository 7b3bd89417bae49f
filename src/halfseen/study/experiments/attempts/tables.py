"""From the pieces of the experiment to its tables."""

from collections import Counter
from typing import Any

import numpy as np
import pandas as pd

from halfseen.evaluation.estimate import Estimate
from halfseen.study.experiment import Pieces, Setting, Tables
from halfseen.study.experiments.attempts.calibration import calibration_of
from halfseen.study.experiments.attempts.design import BETA, COMPLETED, MEASURES, PAIRS, AttemptsDesign
from halfseen.study.experiments.attempts.differences import ByTable, mean_of
from halfseen.study.experiments.attempts.occlusion import counts_of, held_by_occlusion, law_rows, slope_rows
from halfseen.study.experiments.attempts.sources import frame_of
from halfseen.study.statistics import columns, holm

BETTER, WORSE, UNDECIDED = "better", "worse", "no significant difference"


def tables_of(design: AttemptsDesign, setting: Setting, pieces: Pieces) -> Tables:
    """Make all tables; none where there are no attempts.

    Returns
    -------
    dict of pandas.DataFrame
        ``attempts``: planner, tables, decided, cut, held: what was counted.
        ``attempts_scores``: model, num_tables, repetitions, stood_in (repetitions in which one rate stood in for an
        SVM, as too few objects missed to fit one); and of each measure its mean, ``…_se``, ``…_low`` and ``…_high``,
        and the same of ``…_over_beta``, the difference from the Beta mean.
        ``attempts_tests``: model, rival, measure, num_tables, p_value, p_holm, effect, low, high, verdict: two-sided,
        adjusted within each pair of models; the effect is model − rival.
        ``attempts_calibration``: model, by (occlusion, or prediction), bin_from, bin_to, attempts, share_of_attempts,
        tables, mean_probability, share_held, difference, low, high: learned from the largest log.
        ``attempts_held``: planner, is_lying, bin_from, bin_to, occlusion, attempts, tables, share_held, low, high.
        ``attempts_law``: planner, parameter, estimate, se, low, high, p_value.
        ``attempts_slope``: law (of a planner, or assumed), is_lying, occlusion, share_held, low, high.
    """
    if COMPLETED not in pieces.prepared:
        return {}
    weights, scores = _scores(pieces)
    tried = frame_of(pieces.prepared[COMPLETED])
    return {
        "attempts": pd.DataFrame([counts_of(name, each) for name, each in pieces.prepared.items()]),
        "attempts_scores": _means(weights, scores, pieces),
        "attempts_tests": _tests(weights, scores, setting.alpha),
        "attempts_calibration": calibration_of(tried, pieces.repetitions),
        "attempts_held": pd.DataFrame(
            [row for name, each in pieces.prepared.items() for row in held_by_occlusion(name, frame_of(each))]
        ),
        "attempts_law": pd.DataFrame([row for name, each in pieces.prepared.items() for row in law_rows(name, each)]),
        "attempts_slope": slope_rows(pieces.prepared),
    }


Scores = dict[tuple[int, str, str], ByTable]
"""Sums by table and repetition, by size of log, model and measure."""


def _scores(pieces: Pieces) -> tuple[ByTable, Scores]:
    """Put what each repetition summed beside one another; tables that it did not hold out have 0."""
    names = np.unique(np.concatenate([piece["tables"] for piece in pieces.repetitions]))
    shape = len(names), len(pieces.repetitions)
    weights, scores = np.zeros(shape), {}
    for r, piece in enumerate(pieces.repetitions):
        place = np.searchsorted(names, piece["tables"])
        weights[place, r] = piece["weight"]
        for row in piece["scores"]:
            for measure in MEASURES:
                key = row["num_tables"], row["model"], measure
                scores.setdefault(key, np.zeros(shape))[place, r] = row[measure]
    return weights, scores


def _means(weights: ByTable, scores: Scores, pieces: Pieces) -> pd.DataFrame:
    stood_in = Counter(
        (row["num_tables"], row["model"]) for piece in pieces.repetitions for row in piece["scores"] if row["stands_in"]
    )
    rows: dict[tuple[int, str], dict[str, Any]] = {}
    for (size, model, measure), sums in scores.items():
        place = {"model": model, "num_tables": size, "repetitions": weights.shape[1]}
        place["stood_in"] = stood_in[size, model]
        row = rows.setdefault((size, model), place)
        for name, of in ((measure, sums), (f"{measure}_over_beta", sums - scores[size, BETA, measure])):
            row |= columns(mean_of(of, weights), name, f"{name}_se", f"{name}_low", f"{name}_high")
    return pd.DataFrame(list(rows.values()))


def _tests(weights: ByTable, scores: Scores, alpha: float) -> pd.DataFrame:
    sizes, rows = sorted({size for size, *_ in scores}), []
    for model, rival in PAIRS:
        places = [(measure, size) for measure in MEASURES for size in sizes]
        effects = [
            mean_of(scores[size, model, measure] - scores[size, rival, measure], weights) for measure, size in places
        ]
        p_holm = holm(np.array([effect.p_value for effect in effects]))
        for (measure, size), effect, p in zip(places, effects, p_holm, strict=True):
            row = {"model": model, "rival": rival, "measure": measure, "num_tables": size}
            row |= {"p_value": effect.p_value, "p_holm": float(p), "effect": effect.value}
            rows.append(row | {"low": effect.low, "high": effect.high, "verdict": _verdict(effect, p < alpha)})
    return pd.DataFrame(rows)


def _verdict(effect: Estimate, is_significant: bool | np.bool_) -> str:
    if not is_significant:
        return UNDECIDED
    return BETTER if effect.value < 0 else WORSE
