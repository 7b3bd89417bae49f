"""Clocks of trajectories and their stages, and times on them that are equal up to rounding.

Adding up ticks, or subtracting a clock's origin, leaves rounding errors. Completions come before cuts at equal times,
so a tie broken by rounding biases Ĝ. Rounding can be recognised: between it and the real differences there is a gap
that is too large for chance.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import Rows
from halfseen.shapes import Bool, Float, Int

LARGEST_ROUNDING = 1e-5
"""As a share of the range of the lower 90 % of times; larger differences are not rounding."""
CHANCE = 1e-9
"""Probability of mistaking differences between continuous times for rounding."""
SMALLEST_RATIO = 20.0
"""Of the smallest real difference to the largest rounding."""
ROOM = 10.0
"""The tolerance as a multiple of the largest rounding."""
ULPS = 64.0
"""Tolerance in units in the last place of the latest time, valid for every log."""
FEWEST_ROWS, SHARED, TICK_RATIO = 20, 0.5, 1e3
"""If half of at least 20 times are shared exactly, the clock ticks, and no two ticks are closer than a thousandth of
the gaps between others."""


def clock_tolerance_s(time: Rows) -> float:
    """Tolerance within which times count as equal [s].

    Sort the differences d_1 ≤ d_2 ≤ … between neighbouring distinct times. Without rounding, d_{k+1} ≥ r d_k would have
    probability r^−k. So the largest d_k with r^−k ≤ 1e-9 and r ≥ 20 is taken to be rounding, if it is at most 1e-5 of
    the range of the lower 90 % of times, and the tolerance is up to ten times as much. If the clock ticks, r ≥ 1000 is
    enough. If there is no such d_k, the tolerance is 64 units in the last place.
    """
    distinct, counts = np.unique(time, return_counts=True)
    differences = np.diff(distinct)
    gaps = np.sort(differences)
    largest_s = LARGEST_ROUNDING * float(np.quantile(time, 0.9) - distinct[0])
    small = gaps[:-1][gaps[:-1] <= largest_s]
    ratio = gaps[1 : len(small) + 1] / small
    is_clear = (np.arange(1, len(small) + 1) * np.log(ratio) >= -np.log(CHANCE)) & (ratio >= SMALLEST_RATIO)
    if len(time) >= FEWEST_ROWS and counts[counts > 1].sum() >= SHARED * len(time):
        is_clear |= ratio >= TICK_RATIO
    for k in np.flatnonzero(is_clear)[::-1].tolist():
        tolerance_s = float(small[k] * min(ROOM, np.sqrt(ratio[k])))
        begins = np.flatnonzero(np.append(True, differences > small[k]))
        widths_s = distinct[np.append(begins[1:], len(distinct)) - 1] - distinct[begins]
        if widths_s.max() <= tolerance_s:
            return tolerance_s
    return ULPS * float(np.finfo(np.float64).eps * np.abs(distinct).max())


def tied(time: Rows) -> tuple[Rows, float]:
    """Replace times that count as equal by the earliest of them; also return the tolerance [s]."""
    tolerance_s = clock_tolerance_s(time)
    distinct, place = np.unique(time, return_inverse=True)
    is_first = np.append(True, np.diff(distinct) > tolerance_s)
    return distinct[is_first][np.cumsum(is_first) - 1][place], tolerance_s


def tied_clocks(end_s: Rows, elapsed_s: Float[np.ndarray, "n T"]) -> tuple[Rows, Float[np.ndarray, "n T"]]:
    """Make ends [s] and clocks of stages [s] equal if they count as equal; a clock may be NaN."""
    is_known = ~np.isnan(elapsed_s)
    both, _ = tied(np.concatenate([end_s, elapsed_s[is_known]]))
    clock = np.full(elapsed_s.shape, np.nan)
    clock[is_known] = both[len(end_s) :]
    return both[: len(end_s)], clock


SMALLEST_AGE_S = 1e-9
"""Duration of a stage that was cut as it began [s]; also the resolution of ages."""


class StageClocks(NamedTuple):
    """Trajectories, one per row, and their stages, padded to T; 0, False or NaN where there is no stage."""

    trajectory_ids: np.ndarray
    elapsed_s: Float[np.ndarray, "n T"]
    """U_t, on the total-time scale [s]; NaN if not completed."""
    end_s: Float[np.ndarray, " n"]
    is_finished: Bool[np.ndarray, " n"]
    """False if the trajectory was right-censored."""
    is_begun: Bool[np.ndarray, "n T"]
    covariates: Float[np.ndarray, "n T P"]
    """Covariates of cuts; 0 where there is no such stage."""
    covariate_names: tuple[str, ...]

    @classmethod
    def of_ends(cls, end_s: Float[np.ndarray, " n"], is_finished: Bool[np.ndarray, " n"]) -> "StageClocks":
        """Trajectories with known ends only; the unknown fields take no memory."""
        shape = (len(end_s), 1)
        return cls(
            trajectory_ids=np.broadcast_to(np.array(None), len(end_s)),
            elapsed_s=np.broadcast_to(np.nan, shape),
            end_s=end_s,
            is_finished=is_finished,
            is_begun=np.broadcast_to(True, shape),
            covariates=np.broadcast_to(0.0, (*shape, 0)),
            covariate_names=(),
        )

    @property
    def num_trajectories(self) -> int:
        """Number n of trajectories."""
        return len(self.end_s)

    @property
    def num_stages(self) -> int:
        """Maximum number T of stages of a trajectory."""
        return self.elapsed_s.shape[1]

    @property
    def is_completed(self) -> Bool[np.ndarray, "n T"]:
        """δ_t: whether each stage was completed."""
        return ~np.isnan(self.elapsed_s)

    @property
    def is_last(self) -> Bool[np.ndarray, "n T"]:
        """Completed stages with which a trajectory finished."""
        last = self.is_begun.sum(axis=1) - 1
        return (np.arange(self.num_stages) == last[:, None]) & self.is_finished[:, None]

    @property
    def begun_at_s(self) -> Float[np.ndarray, "n T"]:
        """U_{t−1} of each stage that began [s]; 0 elsewhere."""
        before = np.concatenate([np.zeros((self.num_trajectories, 1)), self.elapsed_s[:, :-1]], axis=1)
        return np.where(self.is_begun, before, 0.0)

    @property
    def watched_s(self) -> Float[np.ndarray, "n T"]:
        """Time from the start of each stage to its completion or cut, i.e. its gap time [s]; 0 elsewhere.

        Times that are equal up to rounding are made equal.
        """
        watched_s, is_begun = np.zeros(self.is_begun.shape), self.is_begun
        until = np.where(self.is_completed, self.elapsed_s, self.end_s[:, None])
        age = np.round((until - self.begun_at_s)[is_begun] / SMALLEST_AGE_S) * SMALLEST_AGE_S
        if len(age):
            watched_s[is_begun] = np.maximum(tied(age)[0], SMALLEST_AGE_S)
        return watched_s

    def take(self, rows: Int[np.ndarray, " k"] | slice) -> "StageClocks":
        """Select trajectories, with repetition and in this order; a slice is a view."""
        kept: Any = {name: leaf[rows] for name, leaf in self._asdict().items() if name != "covariate_names"}
        return self._replace(**kept)

    def begun(self) -> "StageClocks":
        """Keep of each trajectory only its end and the covariates of its first stage."""
        first = {name: getattr(self, name)[:, :1] for name in ("elapsed_s", "is_begun", "covariates")}
        return self._replace(**first)


def stacked(parts: Sequence[StageClocks]) -> StageClocks:
    """Concatenate parts of a log with the same covariates."""
    leaves: Any = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in StageClocks._fields
        if name != "covariate_names"
    }
    return parts[0]._replace(**leaves)
