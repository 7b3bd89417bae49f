"""Matching of objects between two looks: the assignment with the least total motion, and its ambiguities."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from halfseen.shapes import Bool, Float, Int

FARTHEST_M = 0.25
"""Largest distance by which a knocked object may have moved [m]; a farther one is another object."""
NEARLY_AS_NEAR_M = 0.03
"""A match is ambiguous if another one is longer by less than this [m]."""


@dataclass(frozen=True, eq=False)
class Matching:
    """Matches from earlier to current objects.

    Parameters
    ----------
    now
        Current number of each earlier object; −1 if it is no longer visible.
    is_doubtful
        Whether the match of each earlier object is ambiguous.
    """

    now: Int[np.ndarray, " n"]
    is_doubtful: Bool[np.ndarray, " n"]

    def new(self, num_now: int) -> list[int]:
        """Numbers of the current objects without an earlier match."""
        return sorted(set(range(num_now)) - set(self.now.tolist()))


def matched(
    before_m: Float[np.ndarray, "n 3"], now_m: Float[np.ndarray, "m 3"], farthest_m: float = FARTHEST_M
) -> Matching:
    """Match objects so that their total motion is smallest.

    Parameters
    ----------
    before_m, now_m
        Earlier and current positions of objects, in one frame [m].
    farthest_m
        Largest distance of a match [m].

    Returns
    -------
    Matching
        One-to-one matches, none over more than `farthest_m`.
    """
    apart_m = np.linalg.norm(before_m[:, None] - now_m[None], axis=2).reshape(len(before_m), len(now_m))
    # Every object may also be lost, at the cost of the longest match.
    price = np.concatenate([apart_m, np.full((len(before_m), len(before_m)), farthest_m)], axis=1)
    which = linear_sum_assignment(price)[1]
    is_near = np.take_along_axis(price, which[:, None], axis=1)[:, 0] < farthest_m
    now = np.where(is_near & (which < len(now_m)), which, -1)
    return Matching(now, _is_doubtful(apart_m, now))


def _is_doubtful(apart_m: Float[np.ndarray, "n m"], now: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Whether another current object is nearly as close as the match, or, without a match, close to the old place."""
    others_m = np.where(np.arange(apart_m.shape[1]) == now[:, None], np.inf, apart_m).min(axis=1, initial=np.inf)
    own_m = np.array([row[which] if which >= 0 else 0.0 for row, which in zip(apart_m, now, strict=True)])
    return others_m < own_m + NEARLY_AS_NEAR_M
