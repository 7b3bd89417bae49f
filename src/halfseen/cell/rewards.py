"""What a table earns, by the truth: rewards, their luck, and episode statistics."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

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
    """Which cups are dirty, and where they are: what no decision looks at.

    Parameters
    ----------
    cell
        Before anything happened.
    is_dirty
        Of each cup.
    """

    def __init__(self, cell: Workcell, is_dirty: Bool[np.ndarray, " N"]) -> None:
        self.is_dirty, self.is_racked = is_dirty, np.zeros(len(is_dirty), dtype=bool)
        self._stood = self._upright(cell) > _TOPPLED_COSINE

    @property
    def num_dirty_left(self) -> int:
        """Dirty cups that are not in the rack."""
        return int(self._is_left.sum())

    def num_dirty_left_to(self, cell: Workcell, arm: int) -> int:
        """Count those of them that are within the reach of an arm, whoever holds them and even where they fell."""
        station = cell.stations[arm]
        apart_m = np.linalg.norm(self._places_m(cell)[:, :2] - station.robot.base_m[:2], axis=1)
        return int((self._is_left & (apart_m <= station.reach_m)).sum())

    @property
    def _is_left(self) -> Bool[np.ndarray, " N"]:
        return self.is_dirty & ~self.is_racked

    def newly_racked(self, cell: Workcell, arm: int | None = None) -> list[bool]:
        """Of the cups that came into the rack since it was asked last, whether each is dirty.

        Parameters
        ----------
        cell
            The cell.
        arm
            Whose rack is looked at; None for all.
        """
        stations = cell.stations if arm is None else (cell.stations[arm],)
        places_m = self._places_m(cell)
        now = np.array([any(each.rack.holds(place) for each in stations) for place in places_m], dtype=bool)
        if arm is not None:
            now |= self.is_racked
        new = now & ~self.is_racked
        self.is_racked = now
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
    num_dirty, num_cups
        Of the table, by the truth.
    chances
        P(DIRTY) of the objects of the first look; cups beyond their number are as likely dirty as any.
    config
        The world that is believed in.
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
    chance
        P(DIRTY) of the object that was meant.
    config
        The world that is believed in.
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
        Part of it that was the luck of which cups were dirty (`luck`): of the table as it looked at first, and of what
        was washed in those same stages [-].
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


class Paid(NamedTuple):
    """What a stage earned."""

    reward: float
    """In all [-]."""
    of_robots: list[float]
    """What each of several robots would have been paid had it been alone [-]; empty for one."""


class Account:
    """Books what a table earns.

    Parameters
    ----------
    run
        Where it is booked.
    cell
        The cell, before anything happened.
    is_dirty
        The truth of each cup.
    config
        Whose rewards are earned.

    Attributes
    ----------
    truth
        Which cups are dirty, and where they are.
    """

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

    def decide(self, verb: str) -> None:
        """Count a decision."""
        _count(self.run.verbs, verb)

    def end(self, attempt: Attempt, verb: int, chance: float, seconds: float, arm: int = 0) -> None:
        """Tell what an attempt earned that has ended.

        Parameters
        ----------
        attempt
            How it went.
        verb
            WASH or LIFT.
        chance
            P(DIRTY) of its object when it was decided.
        seconds
            What it took [s].
        arm
            Whose it was.
        """
        if not attempt.is_held:
            _count(self.run.failures, attempt.reason.split(":")[0].split(";")[0])
        reward = self._reward_of_lift(seconds) if verb == Verb.LIFT else self._reward_of_wash(chance, arm)
        self._reward += reward
        self._own[arm] += reward

    def _reward_of_lift(self, seconds: float) -> float:
        return float(self._config.reward_lift_per_s) * seconds

    def _reward_of_wash(self, chance: float, arm: int) -> float:
        config = self._config
        washed = self.truth.newly_racked(self._cell, arm if len(self._cell.stations) > 1 else None)
        self._luck += luck_of_washing(washed, chance, config)
        earned = [float(config.reward_wash_dirty if dirty else config.reward_wash_clean) for dirty in washed]
        return sum(earned) if earned else float(config.reward_wash_failed)

    def leave(self, arm: int) -> None:
        """Tell that a robot has come to its own end: what is left dirty in its reach is its share; once is enough."""
        if arm in self._at_work:
            self._at_work.remove(arm)
            left = self.truth.num_dirty_left_to(self._cell, arm)
            self._own[arm] += float(self._config.reward_dirty_left) * left

    def pay(self, *, is_over: bool) -> Paid:
        """Book what was earned since it was asked last, as a stage is completed.

        Parameters
        ----------
        is_over
            Whether that is the last: then what is left dirty is paid for.
        """
        if is_over:
            self._reward += float(self._config.reward_dirty_left) * self.truth.num_dirty_left
            for arm in tuple(self._at_work):
                self.leave(arm)
        self.run.reward += self._reward
        self.run.luck += self._luck
        paid = Paid(self._reward, self._own if len(self._own) > 1 else [])
        self._reward, self._luck, self._own = 0.0, 0.0, [0.0 for _ in self._own]
        return paid


def _count(counts: dict[str, int], name: str) -> None:
    counts[name] = counts.get(name, 0) + 1
