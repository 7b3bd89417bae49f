"""Clocks of trajectories and their stages, and times on them that are equal up to rounding.

Ticks that were added up, or a clock's origin that was subtracted, leave rounding. Completions come before cuts at equal
times, so a tie that rounding breaks biases Ĝ. What rounding leaves stands out: between it and the differences that are
real there is a gap that chance does not make.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import Rows
from halfseen.shapes import Bool, Float, Int

LARGEST_ROUNDING = 1e-5
"""Of the span of nine in ten times; larger differences are no rounding."""
CHANCE = 1e-9
"""Of taking differences between times that fall anywhere for rounding."""
SMALLEST_RATIO = 20.0
"""Between the smallest difference that is real and the largest that is rounding."""
ROOM = 10.0
"""Times may differ by this many of the largest roundings seen."""
ULPS = 64.0
"""Units in the last place of the latest time that are rounding in any log."""
FEWEST_ROWS, SHARED, TICK_RATIO = 20, 0.5, 1e3
"""Where half of at least 20 times are shared to the last digit, the clock ticks, and no two ticks are closer than a
thousandth of what separates others."""


def clock_tolerance_s(time: Rows) -> float:
    """How far apart times may be that are meant to be equal [s].

    Sort the differences d_1 ≤ d_2 ≤ … between neighbouring distinct times. Were there no rounding, d_{k+1} ≥ r d_k
    would have probability r^−k. So the largest d_k with r^−k ≤ 1e-9 and r ≥ 20 is rounding, if it is at most 1e-5 of
    the span of nine in ten times, and times may differ by up to ten times as much. Where the clock is seen to tick,
    r ≥ 1000 is enough. Where there is no such d_k, they may differ by 64 units in the last place.
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
    """Give times that are meant to be equal the earliest of them, and the tolerance [s]; 0 where there are none."""
    tolerance_s = clock_tolerance_s(time)
    distinct, place = np.unique(time, return_inverse=True)
    is_first = np.append(True, np.diff(distinct) > tolerance_s)
    return distinct[is_first][np.cumsum(is_first) - 1][place], 0.0 if is_first.all() else tolerance_s


def tied_clocks(end_s: Rows, elapsed_s: Float[np.ndarray, "n T"]) -> tuple[Rows, Float[np.ndarray, "n T"]]:
    """Make ends [s] and clocks of stages [s] equal that are meant to be; a clock may be NaN."""
    is_known = ~np.isnan(elapsed_s)
    both, _ = tied(np.concatenate([end_s, elapsed_s[is_known]]))
    clock = np.full(elapsed_s.shape, np.nan)
    clock[is_known] = both[len(end_s) :]
    return both[: len(end_s)], clock


SMALLEST_AGE_S = 1e-9
"""A stage that was cut as it began was watched this long [s]; ages are counted in it, too."""


class StageClocks(NamedTuple):
    """Trajectories, one a row, and their stages, padded to T; where there is no stage stands 0, False or NaN."""

    trajectory_ids: np.ndarray
    elapsed_s: Float[np.ndarray, "n T"]
    """U_t, on the total-time scale [s]; NaN where not completed."""
    end_s: Float[np.ndarray, " n"]
    is_finished: Bool[np.ndarray, " n"]
    """False where the trajectory was right-censored."""
    is_begun: Bool[np.ndarray, "n T"]
    covariates: Float[np.ndarray, "n T P"]
    """What cuts may depend on; 0 where there is no such stage."""
    covariate_names: tuple[str, ...]

    @classmethod
    def of_ends(cls, end_s: Float[np.ndarray, " n"], is_finished: Bool[np.ndarray, " n"]) -> "StageClocks":
        """Trajectories of which nothing is known but their ends; what is not known takes no memory."""
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
        """Number T of stages that a trajectory may have."""
        return self.elapsed_s.shape[1]

    @property
    def is_completed(self) -> Bool[np.ndarray, "n T"]:
        """δ_t."""
        return ~np.isnan(self.elapsed_s)

    @property
    def is_last(self) -> Bool[np.ndarray, "n T"]:
        """Completed stages after which a trajectory had come to its own end."""
        last = self.is_begun.sum(axis=1) - 1
        return (np.arange(self.num_stages) == last[:, None]) & self.is_finished[:, None]

    @property
    def begun_at_s(self) -> Float[np.ndarray, "n T"]:
        """U_{t−1} of each begun stage [s]; 0 elsewhere."""
        before = np.concatenate([np.zeros((self.num_trajectories, 1)), self.elapsed_s[:, :-1]], axis=1)
        return np.where(self.is_begun, before, 0.0)

    @property
    def watched_s(self) -> Float[np.ndarray, "n T"]:
        """How long each begun stage was watched, to its completion or its cut: its gap time [s]; 0 elsewhere.

        Times that are equal up to rounding are made equal.
        """
        watched_s, is_begun = np.zeros(self.is_begun.shape), self.is_begun
        until = np.where(self.is_completed, self.elapsed_s, self.end_s[:, None])
        age = np.round((until - self.begun_at_s)[is_begun] / SMALLEST_AGE_S) * SMALLEST_AGE_S
        if len(age):
            watched_s[is_begun] = np.maximum(tied(age)[0], SMALLEST_AGE_S)
        return watched_s

    def take(self, rows: Int[np.ndarray, " k"] | slice) -> "StageClocks":
        """Keep these trajectories, which may repeat, in this order; a slice of them copies nothing."""
        kept: Any = {name: leaf[rows] for name, leaf in self._asdict().items() if name != "covariate_names"}
        return self._replace(**kept)

    def begun(self) -> "StageClocks":
        """Keep of each trajectory its end and what it was like as it began: its first stage."""
        first = {name: getattr(self, name)[:, :1] for name in ("elapsed_s", "is_begun", "covariates")}
        return self._replace(**first)


def stacked(parts: Sequence[StageClocks]) -> StageClocks:
    """Put parts of a log together, of the same covariates."""
    leaves: Any = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in StageClocks._fields
        if name != "covariate_names"
    }
    return parts[0]._replace(**leaves)
