"""Words that several experiments share."""

from collections.abc import Callable, Sequence

import pandas as pd

from halfseen.evaluation.estimate import Estimate
from halfseen.study.experiment import Row
from halfseen.wording import INCONCLUSIVE, MISSING, NOT_SUPPORTED, SUPPORTED, estimated, p_value, share_in_words

TRAJECTORIES_AXIS = "logged trajectories that the policy was learned from (log scale)"
REWARD_AXIS = "mean reward of a trajectory, on fresh episodes"
CUT_KIND_NAMES = {
    "independent": "independent cuts",
    "occlusion": "cuts where much is hidden",
    "attempt": "the operator's hand",
}
"""Kind of cut → name for people."""
CUT_KIND_NOTES = {
    "independent": "they fall whatever happens on the table",
    "occlusion": "cuts whose hazard grows with occlusion",
    "attempt": "cuts whose hazard grows while an attempt drags on",
}
"""Kind of cut → what it is."""
EFFECT = ("effect", "effect_low", "effect_high")
"""Columns of a paired difference, ours − other, in tables of tests."""


def learned_from(num_trajectories: int, cut_share: float) -> str:
    """Say what was learned from."""
    cut = "none of them cut" if cut_share == 0 else f"of which about {share_in_words(cut_share)} were cut"
    return f"learned from {num_trajectories} logged trajectories, {cut},"


def estimated_in(row: Row, columns: Sequence[str], decimals: int = 2) -> str:
    """Write a value and its interval, which stand in these columns of a row."""
    return estimated(*(row[name] for name in columns), decimals=decimals)


def is_reward(measure: str) -> bool:
    """Say whether more of a measure is better: times and scores are better the smaller they are."""
    return measure.endswith("reward")


def gain_in(row: Row) -> Estimate:
    """The effect in a row of a table of tests, above 0 where ours is better."""
    value, low, high = (float(row[name]) for name in EFFECT)
    value, low, high = (value, low, high) if is_reward(row["measure"]) else (-value, -high, -low)
    return Estimate(value, low, high, float("nan"), float("nan"))


def verdict_of(row: Row) -> str:
    """Verdict on a row of a table of tests; a dash where there was no test."""
    if pd.isna(row["supported"]):
        return MISSING
    if row["supported"]:
        return SUPPORTED
    return NOT_SUPPORTED if gain_in(row).high < 0 else INCONCLUSIVE


TEST_CELLS: dict[str, Callable[[Row], str]] = {
    "p": lambda row: p_value(row["p_value"]),
    "p, adjusted": lambda row: p_value(row["p_holm"]),
    "claim": verdict_of,
}
"""Last columns of a listing of tests."""
