"""K arms that move together in one clock."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from halfseen.cell.kinematics import Way
from halfseen.cell.live_cell import Activity, Grip, LiveCell, Move, Reserve, Rest, StoppedError
from halfseen.cell.model import Robot
from halfseen.cell.space import Reservations, Space

DEADLOCK = "deadlock"
"""Cause of a cut: arms wait for one another, or for one that is idle, and none has a free way home."""
PATIENCE_S = 15.0
_ASK_EVERY = 10
"""Ticks between two looks whether a space is free by now."""


@dataclass(frozen=True)
class Ended:
    """What one arm has done.

    Parameters
    ----------
    arm
        Its number.
    result
        What came of it.
    """

    arm: int
    result: Any


@dataclass
class Tally:
    """How arms got along.

    Attributes
    ----------
    num_waits
        How often an arm had to wait for space.
    waited_s
        For how long, all arms together [s].
    num_deadlocks
        How often arms waited for one another or for an idle one, or one for too long.
    num_gave_way
        How often one went home for that.
    """

    num_waits: int = 0
    waited_s: float = 0.0
    num_deadlocks: int = 0
    num_gave_way: int = 0


@dataclass(eq=False)
class _Worker:
    """What one arm is at."""

    activity: Activity[Any] | None = None
    way: Way = field(default_factory=lambda: np.zeros((0, 0)))
    at: int = 0
    end: Any = None
    ticks: int = 0
    answer: bool | None = None
    wanted: Reserve | None = None
    space: Space | None = None
    blocked_by: tuple[int, ...] = ()
    since_s: float = 0.0
    asked: int = 0
    reserved_s: float = 0.0


class Crew:
    """The arms of a cell.

    Parameters
    ----------
    cell
        The running cell.
    robots
        The arms, number 0 first.
    patience_s
        After which an arm that waits for space counts as stuck [s].

    Attributes
    ----------
    tally
        How they got along so far.
    """

    def __init__(self, cell: LiveCell, robots: Sequence[Robot], patience_s: float = PATIENCE_S) -> None:
        self._cell, self._robots, self._patience_s = cell, robots, patience_s
        self._reservations = Reservations(cell, robots)
        self._workers = [_Worker() for _ in robots]
        self._told: set[int] = set()
        self.tally = Tally()

    def begin(self, arm: int, activity: Activity[Any]) -> None:
        """Let an arm that is idle begin something.

        Parameters
        ----------
        arm
            Its number.
        activity
            What it does.
        """
        assert not self.is_busy(arm), "an arm does one thing at a time"
        self._workers[arm] = _Worker(activity)

    def is_busy(self, arm: int) -> bool:
        """Whether an arm is at something."""
        return self._workers[arm].activity is not None

    def work(self, most_ticks: int | None = None) -> list[Ended]:
        """Let time pass until an arm has done what it was at.

        Parameters
        ----------
        most_ticks
            After which it stops all the same; None for never.

        Returns
        -------
        list of Ended
            Who has, the lowest number first; none where no arm is at anything.

        Raises
        ------
        StoppedError
            Arms wait for one another, or for one that is idle, and none has a free way home; or what watches the cell
            stopped it.
        """
        num_ticks = 0
        while any(worker.activity is not None for worker in self._workers) and num_ticks != most_ticks:
            # Who was told before another arm's end broke a tick off is not told twice in it.
            told = {arm: self._tick(arm) for arm in range(len(self._workers)) if arm not in self._told}
            ended = [done for done in told.values() if done is not None]
            self._told |= {arm for arm, done in told.items() if done is None}
            if ended:
                return ended
            if num_ticks % _ASK_EVERY == 0:
                self._settle()
            self._cell.wait(self._cell.tick_s)
            self._told.clear()
            num_ticks += 1
        return []

    def _tick(self, arm: int) -> Ended | None:
        """Tell an arm's servos what to do in the next tick; whether it has nothing more to do."""
        worker = self._workers[arm]
        while worker.activity is not None:
            if worker.at < len(worker.way):
                self._go_on(arm, worker)
                return None
            if worker.end is not None:
                self._cell.steer(self._robots[arm], worker.end)
                worker.end = None
            if worker.ticks > 0:
                worker.ticks -= 1
                return None
            if worker.wanted is not None and not self._is_granted(arm, worker):
                return None
            try:
                command = next(worker.activity) if worker.answer is None else worker.activity.send(worker.answer)
            except StopIteration as stopped:
                worker.activity = None
                self._reservations.let_go(arm)
                return Ended(arm, stopped.value)
            worker.answer = True
            self._take_up(arm, worker, command)
        return None

    def _go_on(self, arm: int, worker: _Worker) -> None:
        angles = worker.way[worker.at]
        worker.at += 1
        self._cell.steer(self._robots[arm], angles)
        self._reservations.advance(arm, angles)

    def _take_up(self, arm: int, worker: _Worker, command: Move | Grip | Rest | Reserve) -> None:
        robot, tick_s = self._robots[arm], self._cell.tick_s
        match command:
            case Move():
                worker.way = self._cell.commanded_rad(robot, command.way, command.speed)
                worker.at, worker.end = 0, command.way[-1]
            case Grip():
                self._cell.close(robot, command.opening_m)
                worker.ticks = round(command.seconds / tick_s)
            case Rest():
                worker.ticks = round(command.seconds / tick_s)
            case Reserve():
                self._reservations.stand(arm)
                worker.wanted, worker.blocked_by, worker.asked = command, (), 0
                worker.since_s = self._cell.time_s
                worker.space = self._reservations.space(arm, command.way, command.below_m)

    def _is_granted(self, arm: int, worker: _Worker) -> bool:
        """Whether what an arm wanted is decided by now."""
        wanted, space = worker.wanted, worker.space
        assert wanted is not None, "it asked"
        assert space is not None, "and so there is the space that it asked for"
        worker.asked += 1
        if (worker.asked - 1) % _ASK_EVERY:
            return False
        is_first = worker.asked == 1
        worker.blocked_by = self._reservations.in_the_way(arm, space)
        if worker.blocked_by and wanted.is_patient:
            self.tally.num_waits += is_first
            return False
        if not worker.blocked_by:
            self._grant(arm, worker, space, is_free=True)
        else:
            worker.wanted, worker.answer = None, False
        return True

    def _grant(self, arm: int, worker: _Worker, space: Space, *, is_free: bool) -> None:
        assert worker.wanted is not None, "it asked"
        now_s = self._cell.time_s
        self._reservations.reserve(arm, space, worker.wanted.below_m)
        self.tally.waited_s += now_s - worker.since_s
        worker.wanted, worker.answer, worker.blocked_by, worker.reserved_s = None, is_free, (), now_s

    def _settle(self) -> None:
        """Notice a deadlock, and let one arm give way."""
        blocked = self._blocked()
        does_nobody_move = len(blocked) == sum(worker.activity is not None for worker in self._workers)
        for_good = blocked if does_nobody_move else [arm for arm in blocked if self._waits_for_itself(arm)]
        stuck = for_good or [arm for arm in blocked if self._is_impatient(arm)]
        if not stuck:
            return
        if self._one_goes_home(stuck) or self._those_at_home_give_up(stuck):
            self.tally.num_deadlocks += 1
        elif for_good:
            raise StoppedError(DEADLOCK)

    def _blocked(self) -> list[int]:
        """Which arms wait for space that others have now: some may have left it since they asked."""
        blocked = []
        for arm, worker in enumerate(self._workers):
            if worker.wanted is not None and worker.blocked_by:
                assert worker.space is not None, "it asked"
                worker.blocked_by = self._reservations.in_the_way(arm, worker.space)
                blocked += [arm] if worker.blocked_by else []
        return blocked

    def _one_goes_home(self, stuck: list[int]) -> bool:
        """Send home the arm that came last, of those whose way home is free; whether there is one."""
        for arm in sorted(stuck, key=lambda arm: -self._workers[arm].reserved_s):
            worker = self._workers[arm]
            assert worker.wanted is not None, "it is blocked"
            if not len(worker.wanted.back):
                continue
            back = self._reservations.space(arm, worker.wanted.back, worker.wanted.below_m)
            if not self._reservations.in_the_way(arm, back):
                self.tally.num_gave_way += 1
                self._grant(arm, worker, back, is_free=False)
                return True
        return False

    def _those_at_home_give_up(self, stuck: list[int]) -> bool:
        """Refuse what arms wanted that have nothing to go back from; whether there are any."""
        workers = [self._workers[arm] for arm in stuck]
        at_home = [worker for worker in workers if worker.wanted is not None and not len(worker.wanted.back)]
        for worker in at_home:
            self.tally.waited_s += self._cell.time_s - worker.since_s
            worker.wanted, worker.answer, worker.blocked_by = None, False, ()
        return bool(at_home)

    def _is_impatient(self, arm: int) -> bool:
        return self._cell.time_s - self._workers[arm].since_s > self._patience_s

    def _waits_for_itself(self, arm: int) -> bool:
        """Whether those whom an arm waits for wait, directly or not, for it."""
        seen: set[int] = set()
        ahead = list(self._workers[arm].blocked_by)
        while ahead:
            other = ahead.pop()
            if other == arm:
                return True
            if other not in seen:
                seen.add(other)
                ahead += self._workers[other].blocked_by
        return False
