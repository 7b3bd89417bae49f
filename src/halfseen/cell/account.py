"""What a table earns: rewards and their luck, told when an attempt ends, and booked when its stage is completed.

That is one moment for both, and the log's: a stage that a cut left incomplete has earned nothing, in the log or here,
and has had no luck either. Each of several robots has its own share, too: what it would have been paid had it been
alone. That is the reward of its own attempts, and, where it comes to its own end, that of what is dirty in its reach.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from halfseen.arrays import Rows
from halfseen.cell.attempt import Attempt
from halfseen.cell.luck import luck_of_table, luck_of_washing
from halfseen.cell.truth import Truth
from halfseen.cell.workcell import Workcell
from halfseen.shapes import Bool
from halfseen.world.actions import Verb
from halfseen.world.config import WorldConfig


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
