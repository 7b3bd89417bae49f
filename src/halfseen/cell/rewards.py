"""Rewards of a table computed from the ground truth, their luck, and other results.

Rewards and luck are known when an attempt ends, and booked when its stage is completed. A stage left incomplete by a
cut has neither reward nor luck, in the log and here. Each of several robots also has its own share: the reward that it
would have been paid alone. That is the reward of its own attempts and, if it reaches its own end, that of the dirty
cups left within its reach.

Which cups are dirty is random, and this luck causes most of the variance of rewards between tables. If P(DIRTY) is
calibrated, the mean of the luck is 0 under any policy: each term is an outcome minus its expectation given all earlier
observations. Subtracting it keeps the mean reward and lowers its variance: it is a control variate [Burch2018]_.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from halfseen.arrays import Points, Rows
from halfseen.cell.fetching import ObservedAttempt
from halfseen.cell.workcell import Workcell
from halfseen.scene.table import TABLE_TOP_M
from halfseen.shapes import Bool, Float
from halfseen.world.actions import Verb
from halfseen.world.config import WorldConfig

_TOPPLED_COSINE = 0.5
_ON_TABLE_M = 0.05  # a cup on the table has its origin at most this far below the table's top


class CupsTruth:
    """Ground truth of the cups: dirtiness and poses, which no decision uses."""

    def __init__(self, cell: Workcell, is_dirty: Bool[np.ndarray, " N"]) -> None:
        self.is_dirty, self.is_racked = is_dirty, np.zeros(len(is_dirty), dtype=bool)
        self._stood = self._upright(cell) > _TOPPLED_COSINE

    def num_dirty_left(self, cell: Workcell, arm: int | None = None) -> int:
        """Count dirty cups that are not in a rack; for an arm, those within its reach, even if held or fallen."""
        is_left = self.is_dirty & ~self.is_racked
        if arm is not None:
            station = cell.stations[arm]
            apart_m = np.linalg.norm(self._places_m(cell)[:, :2] - station.robot.base_m[:2], axis=1)
            is_left &= apart_m <= station.reach_m
        return int(is_left.sum())

    def newly_racked(self, cell: Workcell, arm: int | None = None) -> list[bool]:
        """Whether each cup that entered the rack (of one arm, or any if None) since the last call is dirty."""
        stations = cell.stations if arm is None else (cell.stations[arm],)
        now = np.array([any(each.rack.holds(place) for each in stations) for place in self._places_m(cell)], dtype=bool)
        if arm is not None:
            now |= self.is_racked
        new, self.is_racked = now & ~self.is_racked, now
        return self.is_dirty[new].tolist()

    def add_to(self, rows: list[dict[str, Any]], cell: Workcell) -> None:
        """Add the truth to the rows of a log: each object gets the dirtiness of its nearest cup."""
        places_m = self._places_m(cell)
        for row, known in zip(rows, cell.memory.objects, strict=True):
            row["is_dirty"] = bool(self.is_dirty[np.linalg.norm(places_m - known.middle_m, axis=1).argmin()])

    def is_cleared(self, cell: Workcell) -> bool:
        """Whether no cup is on the table."""
        return not self._on_table(cell).any()

    def counts(self, cell: Workcell) -> dict[str, int]:
        """Count cups for the fields of `Run`."""
        self.newly_racked(cell)
        on_table = self._on_table(cell)
        marked = {
            "num_racked": self.is_racked,
            "num_toppled": on_table & self._stood & (self._upright(cell) < _TOPPLED_COSINE),
            "num_fallen": ~on_table & ~self.is_racked,
            "num_dirty": self.is_dirty,
            "num_washed": self.is_dirty & self.is_racked,
        }
        return {"num_cups": len(self.is_dirty), **{name: int(mask.sum()) for name, mask in marked.items()}}

    def _on_table(self, cell: Workcell) -> Bool[np.ndarray, " N"]:
        return (self._places_m(cell)[:, 2] > TABLE_TOP_M - _ON_TABLE_M) & ~self.is_racked

    def _places_m(self, cell: Workcell) -> Points:
        # The shape stays (0, 3) for a table without cups.
        return np.array([cell.cell.cup(index).position_m for index in range(len(self.is_dirty))]).reshape(-1, 3)

    def _upright(self, cell: Workcell) -> Float[np.ndarray, " N"]:
        return np.array([cell.cell.cup(index).rotation[2, 2] for index in range(len(self.is_dirty))])


def luck_of_table(num_dirty: int, num_cups: int, chances: Rows, config: WorldConfig) -> float:
    """Luck of a table: reward of leaving all its dirty cups, minus the expectation after the first look.

    Parameters
    ----------
    chances
        P(DIRTY) of the objects in the first look; further cups have the prior probability.
    """
    unseen = max(num_cups - len(chances), 0)
    expected = float(chances.sum()) + unseen * float(config.dirty_share)
    return float(config.reward_dirty_left) * (num_dirty - expected)


def luck_of_washing(washed: list[bool], chance: float, config: WorldConfig) -> float:
    """Luck of washing: reward of cups that entered the rack, minus its expectation under their P(DIRTY).

    Parameters
    ----------
    washed
        Whether each cup that entered the rack is dirty.
    """
    if_dirty = float(config.reward_wash_dirty) - float(config.reward_dirty_left) - float(config.reward_wash_clean)
    return if_dirty * sum(float(is_dirty) - chance for is_dirty in washed)


@dataclass
class Run:
    """Result of one table, by the ground truth.

    Attributes
    ----------
    reward
        Sum of the rewards of completed stages, as in the log [-].
    luck
        Part of the reward due to which cups were dirty: of the table at the first look, and of the cups washed in the
        completed stages [-].
    seconds
        Duration on the cell's clock [s].
    verbs, failures
        Count of each verb; count of each reason for failed attempts.
    num_cups, num_racked, num_toppled, num_fallen
        Number of cups: all; in a rack; on the table and toppled; neither on the table nor in a rack.
    num_dirty, num_washed
        Number of dirty cups, and of those in a rack.
    cause
        Cause of the cut; None if the trajectory finished.
    """

    reward: float = 0.0
    luck: float = 0.0
    seconds: float = 0.0
    verbs: dict[str, int] = field(default_factory=dict)
    failures: dict[str, int] = field(default_factory=dict)
    num_cups: int = 0
    num_racked: int = 0
    num_toppled: int = 0
    num_fallen: int = 0
    num_dirty: int = 0
    num_washed: int = 0
    cause: str | None = None

    @property
    def is_seen(self) -> bool:
        """Whether any decision was made; otherwise the table was cut before, and is in no log."""
        return bool(self.verbs)


@dataclass
class TeamRun(Run):
    """Result of one table cleared by several arms.

    Attributes
    ----------
    num_collisions
        Number of collisions between arms or their held objects.
    num_waits, num_deadlocks, num_gave_way, waited_s
        Conflicts between arms, as in `halfseen.cell.executor.Tally`.
    busy_s
        Time that each arm spent on WASH or LIFT [s].
    """

    num_collisions: int = 0
    num_waits: int = 0
    num_deadlocks: int = 0
    num_gave_way: int = 0
    waited_s: float = 0.0
    busy_s: list[float] = field(default_factory=list)


class EpisodeStatistics:
    """Accumulates the rewards of a table from the start of the episode; `truth` is the ground truth of its cups."""

    def __init__(self, run: Run, cell: Workcell, is_dirty: Bool[np.ndarray, " N"], config: WorldConfig) -> None:
        self.run, self.truth = run, CupsTruth(cell, is_dirty)
        self._cell, self._config = cell, config
        self._reward = self._luck = 0.0
        self._own = [0.0 for _ in cell.stations]
        self._at_work = set(range(len(cell.stations)))

    def see(self, chances: Rows) -> None:
        """Book the luck of the table, given P(DIRTY) of the objects in its first look."""
        is_dirty = self.truth.is_dirty
        self.run.luck += luck_of_table(int(is_dirty.sum()), len(is_dirty), chances, self._config)

    def count_verb(self, verb: str) -> None:
        """Count a decision."""
        self.run.verbs[verb] = self.run.verbs.get(verb, 0) + 1

    def end(self, attempt: ObservedAttempt, verb: int, chance: float, seconds: float, arm: int = 0) -> None:
        """Book an attempt that has ended.

        Parameters
        ----------
        seconds
            Duration of the attempt [s].
        """
        if not attempt.is_held:
            reason = attempt.reason.split(":")[0].split(";")[0]
            self.run.failures[reason] = self.run.failures.get(reason, 0) + 1
        reward = float(self._config.reward_lift_per_s) * seconds if verb == Verb.LIFT else self._washed(chance, arm)
        self._reward += reward
        self._own[arm] += reward

    def _washed(self, chance: float, arm: int) -> float:
        config = self._config
        washed = self.truth.newly_racked(self._cell, arm if len(self._own) > 1 else None)
        self._luck += luck_of_washing(washed, chance, config)
        earned = [float(config.reward_wash_dirty if dirty else config.reward_wash_clean) for dirty in washed]
        return sum(earned) if earned else float(config.reward_wash_failed)

    def leave(self, arm: int) -> None:
        """Book a robot's own end, once: its share includes the dirty cups left within its reach."""
        if arm in self._at_work:
            self._at_work.remove(arm)
            self._own[arm] += float(self._config.reward_dirty_left) * self.truth.num_dirty_left(self._cell, arm)

    def pay(self, *, is_over: bool) -> tuple[float, list[float]]:
        """Complete a stage and return the reward since the previous one; the last includes dirty cups left [-].

        Also return the reward that each of several robots would have been paid alone [-]; empty for one robot.
        """
        if is_over:
            self._reward += float(self._config.reward_dirty_left) * self.truth.num_dirty_left(self._cell)
            for arm in tuple(self._at_work):
                self.leave(arm)
        self.run.reward += self._reward
        self.run.luck += self._luck
        paid = self._reward, self._own if len(self._own) > 1 else []
        self._reward, self._luck, self._own = 0.0, 0.0, [0.0 for _ in self._own]
        return paid
