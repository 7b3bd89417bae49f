"""Rewards that stand in the row after their action, as in logs of observations: o₁ a₁ –, o₂ a₂ r₁, o₃ – r₂."""

from collections.abc import Collection, Sequence
from typing import Any

from halfseen.errors import warn
from halfseen.logs.formats.table_cells import Cells

OR_LATER = ', or set reward.row = "next" if each row has the reward of the action in the row before'
"""Another remedy for a reward without an action, and for an action without a reward."""


def reward_first(values: Sequence[tuple[str, Any]], finishing: Collection[str]) -> list[tuple[str, Any]]:
    """Order the values of a row, by key, so that its reward is of the action in the row before.

    In a row with which a trajectory finishes nothing is done any more, whatever its action says.
    """
    rewards = [pair for pair in values if pair[0] == "reward"]
    others = [pair for pair in values if pair[0] != "reward"]
    ends = [pair for pair in others if pair[0] == "ending" and pair[1] in finishing]
    return [*rewards, *(ends or others)]


def warn_of_first_rewards(cells: Cells, rows: Sequence[int]) -> None:
    """Warn about first rows of trajectories with a reward other than 0, which is of no action."""
    if rows:
        trouble = f"its reward is left out, as in {len(rows):,} first rows of trajectories, before any action"
        warn(cells.place(rows[0]), f"{trouble}; leave reward.row out if each reward is in the row of its action")
