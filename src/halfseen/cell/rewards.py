"""What a table earns, by the truth: rewards, their luck, and what else came of it.

Rewards and luck are known when an attempt ends, and booked when its stage is completed: a stage that a cut left
incomplete has earned nothing, in the log or here, and has had no luck either. Each of several robots has its own share,
too: what it would have been paid had it been alone, that is the reward of its own attempts and, where it comes to its
own end, that of what is dirty in its reach.

Which cups are dirty is drawn, and that luck is most of what makes rewards differ from table to table. Where P(DIRTY) is
calibrated its mean is 0 whatever decides (each term is the difference of an outcome from its expectation given all that
was seen before), so that a mean without it is the same mean, better known: a control variate [Burch2018]_.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from halfseen.arrays import Points, Rows
from halfseen.cell.fetching import Attempt
from halfseen.cell.workcell import Workcell
from halfseen.scene.table import TABLE_TOP_M
from halfseen.shapes import Bool, Float
from halfseen.world.actions import Verb
from halfseen.world.config import WorldConfig

_TOPPLED_COSINE = 0.5
_ON_TABLE_M = 0.05  # a cup's origin is not lower than this below the top of the table it stands on


class Truth:
    """Which cups are dirty, and where they are: what no decision looks at."""

    def __init__(self, cell: Workcell, is_dirty: Bool[np.ndarray, " N"]) -> None:
        self.is_dirty, self.is_racked = is_dirty, np.zeros(len(is_dirty), dtype=bool)
        self._stood = self._upright(cell) > _TOPPLED_COSINE

    def num_dirty_left(self, cell: Workcell, arm: int | None = None) -> int:
        """Count dirty cups that are not in the rack; of an arm those in its reach, even where they are held or fell."""
        is_left = self.is_dirty & ~self.is_racked
        if arm is not None:
            station = cell.stations[arm]
            apart_m = np.linalg.norm(self._places_m(cell)[:, :2] - station.robot.base_m[:2], axis=1)
            is_left &= apart_m <= station.reach_m
        return int(is_left.sum())

    def newly_racked(self, cell: Workcell, arm: int | None = None) -> list[bool]:
        """Whether each cup that came into the rack (of an arm; None for all) since it was asked last is dirty."""
        stations = cell.stations if arm is None else (cell.stations[arm],)
        now = np.array([any(each.rack.holds(place) for each in stations) for place in self._places_m(cell)], dtype=bool)
        if arm is not None:
            now |= self.is_racked
        new, self.is_racked = now & ~self.is_racked, now
        return self.is_dirty[new].tolist()

    def add_to(self, rows: list[dict[str, Any]], cell: Workcell) -> None:
        """Add the truth to the rows of a log: of each object that of the cup that is nearest to it."""
        places_m = self._places_m(cell)
        for row, known in zip(rows, cell.memory.objects, strict=True):
            row["is_dirty"] = bool(self.is_dirty[np.linalg.norm(places_m - known.middle_m, axis=1).argmin()])

    def is_cleared(self, cell: Workcell) -> bool:
        """Whether no cup is on the table."""
        return not self._on_table(cell).any()

    def counts(self, cell: Workcell) -> dict[str, int]:
        """Count cups, as `Run` has them."""
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
        # A table without cups has places, too: none.
        return np.array([cell.cell.cup(index).position_m for index in range(len(self.is_dirty))]).reshape(-1, 3)

    def _upright(self, cell: Workcell) -> Float[np.ndarray, " N"]:
        return np.array([cell.cell.cup(index).rotation[2, 2] for index in range(len(self.is_dirty))])


def luck_of_table(num_dirty: int, num_cups: int, chances: Rows, config: WorldConfig) -> float:
    """Reward of a table that has more or fewer dirty cups than its first look leads to expect, if all were left.

    Parameters
    ----------
    chances
        P(DIRTY) of the objects of the first look; cups beyond their number are as likely dirty as any.
    """
    unseen = max(num_cups - len(chances), 0)
    expected = float(chances.sum()) + unseen * float(config.dirty_share)
    return float(config.reward_dirty_left) * (num_dirty - expected)


def luck_of_washing(washed: list[bool], chance: float, config: WorldConfig) -> float:
    """Reward of cups that came into the rack beyond what their P(DIRTY) led to expect.

    Parameters
    ----------
    washed
        Of each cup that came into the rack, whether it is dirty.
    """
    if_dirty = float(config.reward_wash_dirty) - float(config.reward_dirty_left) - float(config.reward_wash_clean)
    return if_dirty * sum(float(is_dirty) - chance for is_dirty in washed)


@dataclass
class Run:
    """What came of one table, by the truth.

    Attributes
    ----------
    reward
        Sum of the rewards of the stages that were completed, as the log has them [-].
    luck
        Part of it that was the luck of which cups were dirty: of the table as it looked at first, and of what was
        washed in those same stages [-].
    seconds
        On the cell's clock [s].
    verbs, failures
        How often each verb was tried; and why attempts did not hold.
    num_cups, num_racked, num_toppled, num_fallen
        Cups; those in the rack; those left on the table that stood and lie now; those that are neither on the table
        nor in the rack.
    num_dirty, num_washed
        Dirty cups, and those of them in the rack.
    cause
        What cut it; None where it came to its own end.
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
        """Whether anything was decided; else it was cut before, and no log holds it."""
        return bool(self.verbs)


@dataclass
class TeamRun(Run):
    """What came of one table that several arms cleared.

    Attributes
    ----------
    num_collisions
        How often arms, or what they held, touched.
    num_waits, num_deadlocks, num_gave_way, waited_s
        How they got along, as `halfseen.cell.executor.Tally` has it.
    busy_s
        For how long each arm was at WASH or LIFT [s].
    """

    num_collisions: int = 0
    num_waits: int = 0
    num_deadlocks: int = 0
    num_gave_way: int = 0
    waited_s: float = 0.0
    busy_s: list[float] = field(default_factory=list)


class EpisodeStatistics:
    """Books what a table earns, from before anything happened on; `truth` is which cups are dirty, and where."""

    def __init__(self, run: Run, cell: Workcell, is_dirty: Bool[np.ndarray, " N"], config: WorldConfig) -> None:
        self.run, self.truth = run, Truth(cell, is_dirty)
        self._cell, self._config = cell, config
        self._reward = self._luck = 0.0
        self._own = [0.0 for _ in cell.stations]
        self._at_work = set(range(len(cell.stations)))

    def see(self, chances: Rows) -> None:
        """Book the luck of the table, given P(DIRTY) of the objects of its first look."""
        is_dirty = self.truth.is_dirty
        self.run.luck += luck_of_table(int(is_dirty.sum()), len(is_dirty), chances, self._config)

    def count_verb(self, verb: str) -> None:
        """Count a decision."""
        self.run.verbs[verb] = self.run.verbs.get(verb, 0) + 1

    def end(self, attempt: Attempt, verb: int, chance: float, seconds: float, arm: int = 0) -> None:
        """Book an attempt that has ended.

        Parameters
        ----------
        seconds
            What it took [s].
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
        """Book that a robot has come to its own end: what is left dirty in its reach is its share; once is enough."""
        if arm in self._at_work:
            self._at_work.remove(arm)
            self._own[arm] += float(self._config.reward_dirty_left) * self.truth.num_dirty_left(self._cell, arm)

    def pay(self, *, is_over: bool) -> tuple[float, list[float]]:
        """Complete a stage, of the last of all with what is left dirty: what was earned since the last [-].

        Beside it what each of several robots would have been paid had it been alone [-]; nothing for one.
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
