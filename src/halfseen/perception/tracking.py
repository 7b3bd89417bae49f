"""Which object of this look is which of the one before: the nearest consistent match, and where it is doubtful."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from halfseen.shapes import Bool, Float, Int

FARTHEST_M = 0.25
"""An object that was knocked is found again within this distance [m]; beyond it is another one."""
NEARLY_AS_NEAR_M = 0.03
"""Where another match is longer by less than this, which is which is doubtful [m]."""


@dataclass(frozen=True, eq=False)
class Matching:
    """Objects before, and which they are now.

    Parameters
    ----------
    now
        For each object before: its number now; −1 where it is not seen any more.
    is_doubtful
        For each object before: whether it may as well be another one.
    """

    now: Int[np.ndarray, " n"]
    is_doubtful: Bool[np.ndarray, " n"]

    def new(self, num_now: int) -> list[int]:
        """Numbers of the objects now that were not there before."""
        return sorted(set(range(num_now)) - set(self.now.tolist()))


def matched(
    before_m: Float[np.ndarray, "n 3"], now_m: Float[np.ndarray, "m 3"], farthest_m: float = FARTHEST_M
) -> Matching:
    """Match objects so that together they moved least.

    Parameters
    ----------
    before_m, now_m
        Where the objects were, and where objects are now, in one frame [m].
    farthest_m
        Longest way of a match [m].

    Returns
    -------
    Matching
        No object now is given to two; none is matched over more than `farthest_m`.
    """
    apart_m = np.linalg.norm(before_m[:, None] - now_m[None], axis=2).reshape(len(before_m), len(now_m))
    # Every object may also be lost, at the price of the longest match.
    price = np.concatenate([apart_m, np.full((len(before_m), len(before_m)), farthest_m)], axis=1)
    which = linear_sum_assignment(price)[1]
    is_near = np.take_along_axis(price, which[:, None], axis=1)[:, 0] < farthest_m
    now = np.where(is_near & (which < len(now_m)), which, -1)
    return Matching(now, _is_doubtful(apart_m, now))


def _is_doubtful(apart_m: Float[np.ndarray, "n m"], now: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Whether some other object now is nearly as near as the match; or stands where it stood, if there is none."""
    others_m = np.where(np.arange(apart_m.shape[1]) == now[:, None], np.inf, apart_m).min(axis=1, initial=np.inf)
    own_m = np.array([row[which] if which >= 0 else 0.0 for row, which in zip(apart_m, now, strict=True)])
    return others_m < own_m + NEARLY_AS_NEAR_M
