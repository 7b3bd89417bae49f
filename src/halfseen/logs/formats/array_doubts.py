"""Doubts about arrays of steps: flags of ends that observations contradict, or that stay true."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from halfseen.errors import warn
from halfseen.shapes import Bool, Int

SEEN, NEXT_SEEN = "observations", "next_observations"
TIMEOUTS = ("timeouts", "truncations", "episode_terminals")
"""Names of the flags of truncation, of which the first that is there counts; the last are also true of other ends."""
FEWEST_ENDS, FEWEST_SHIFTED = 3, 5
"""Numbers of ends of episodes that show whether observations jump there, or beside them."""
USUAL, JUMP = 0.95, 2.0
"""Share of the steps of observations that are usual, and least jump in the largest of these."""


def warn_of_runs(place: str, done: str, is_terminal: Bool[np.ndarray, " N"]) -> None:
    """Warn about rows that terminate an episode just below such a row, unless most do, as where each has one step."""
    again = np.flatnonzero(is_terminal[1:] & is_terminal[:-1]) + 1
    if FEWEST_ENDS <= len(again) < len(is_terminal) / 2:
        warn(
            place,
            f"{done} is true in row {again[0]} and in the one above, as in {len(again):,} rows, and each counts as an "
            "episode of one step: if it stays true once a goal is reached, end the episode there, and drop the rest",
        )


def warn_of_shifted_ends(place: str, observed: Mapping[str, Any], ends: Int[np.ndarray, " E"]) -> None:
    """Warn where observations jump one row before or after the ends of episodes, and not there."""
    numbers = [values.astype(np.float64) for values in observed.values() if values.dtype.kind in "iuf"]
    below = ", or drop the rows below if environments reset themselves there, as vectors of Gymnasium do"
    for by, word in ((1, f"early; mark their last rows{below}"), (-1, "late; mark their last rows")):
        last = ends - 1
        last = last[(last >= 1) & (last < ends.max(initial=0) - 2)]
        for values in numbers if FEWEST_SHIFTED <= len(last) <= ends[-1] / 4 else ():
            with np.errstate(invalid="ignore"):  # infinity, which is refused later
                steps = np.abs(np.diff(values))
            most = JUMP * np.quantile(np.delete(steps, [*last, *(last + by)]), USUAL)
            if np.median(steps[last + by]) > most >= np.median(steps[last]):
                warn(place, f"{SEEN} jump as if ends of episodes were marked one row too {word}")
                return


def warn_of_others_below(
    place: str, observed: Mapping[str, Any], following: Mapping[str, Any], ends: Int[np.ndarray, " E"]
) -> None:
    """Warn where the observation after a step is not that of the row below, or is the first of the next episode."""
    is_end = np.isin(np.arange(1, len(next(iter(observed.values()), ()))), ends)
    is_same, is_jump = np.ones(len(is_end), dtype=bool), False
    for name, values in observed.items():
        after, below = following[name][:-1], values[1:]
        if values.dtype.kind not in "iuf":
            is_same &= after == below
            continue
        is_same &= np.isclose(after, below, equal_nan=True)
        with np.errstate(invalid="ignore"):  # infinity, which is refused later
            steps = np.abs(after.astype(np.float64) - values[:-1])
        is_jump |= is_end.sum() >= FEWEST_ENDS and np.median(steps[is_end]) > steps[~is_end].max(initial=0.0)
    apart = np.flatnonzero(~is_same & ~is_end)
    if len(apart):
        warn(
            place,
            f"in row {apart[0]} {NEXT_SEEN} are not the {SEEN} of the row below, yet no episode ends there, as in "
            f"{len(apart):,} rows: mark the ends of episodes in {TIMEOUTS[0]}, or put the steps in order",
        )
    is_varied = any(len(np.unique(values[ends[:-1]].astype(str))) > 1 for values in observed.values())
    if is_varied and is_end.sum() >= FEWEST_ENDS and is_same[is_end].all() and not is_jump:
        warn(
            place,
            f"the first {SEEN} of each episode are the last {NEXT_SEEN} of the one before: if environments reset "
            "themselves in a step of their own, as vectors of Gymnasium do, drop the first row of each but the first",
        )
    if is_jump and is_same[is_end].all():
        warn(
            place,
            f"{NEXT_SEEN} at the ends of episodes are the first {SEEN} of the next, as environments that reset "
            "themselves return them, and count as seen at a cut; record the final observation in their place",
        )
