"""Words that several experiments share."""

from collections.abc import Sequence
from typing import Any

from halfseen.evaluation.estimate import Estimate
from halfseen.pages.numbers import estimated, share_in_words
from halfseen.pages.sentences import Claim
from halfseen.study.experiment import Row

PATHS_AXIS = "logged paths that the policy was learned from (log scale)"
REWARD_AXIS = "mean reward of a path, on fresh episodes"
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


def of_which_cut(cut_share: float) -> str:
    """Say what proportion of a log was cut."""
    return "none of them cut" if cut_share == 0 else f"of which about {share_in_words(cut_share)} were cut"


def learned_from(num_paths: int, cut_share: float) -> str:
    """Say what was learned from."""
    return f"learned from {num_paths} logged paths, {of_which_cut(cut_share)},"


def spelled(low: int, high: int) -> str:
    """Write a range: ``25``, ``25 to 50``."""
    return f"{low}" if low == high else f"{low} to {high}"


def estimated_in(row: Row, columns: Sequence[str], decimals: int = 2) -> str:
    """Write a value and its interval, which stand in these columns of a row."""
    return estimated(*(row[name] for name in columns), decimals=decimals)


def gain_in(row: Any, *, is_more_better: bool) -> Estimate:
    """The effect in a row of a table of tests, above 0 where ours is better."""
    value, low, high = (float(row[name]) for name in ("effect", "effect_low", "effect_high"))
    value, low, high = (value, low, high) if is_more_better else (-value, -high, -low)
    return Estimate(value, low, high, float("nan"), float("nan"))


def verdict_of(row: Any, alpha: float, *, is_more_better: bool) -> str:
    """Verdict on a row of a table of tests."""
    gain = gain_in(row, is_more_better=is_more_better)
    return Claim("", "", "", "", gain, float(row["p_holm"]), alpha).verdict
