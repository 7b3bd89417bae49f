"""Execution of K arms on one clock: each reserves the space of its path before it moves, and waits if it is taken.

A deadlock is a cycle of waiting arms, or all busy arms waiting (for one another, or for an idle arm that stays). An arm
that waits too long also counts as stuck. Of the stuck arms, the one that reserved last and has a free way home gives
way: it reserves that way, and the others continue. A stuck arm that is already home drops its request. If neither
helps and no moving arm could resolve the deadlock, the cell is stopped. With K = 1 no arm ever waits.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from halfseen.cell.kinematics import Angles
from halfseen.cell.live_cell import Activity, Command, Grip, LiveCell, Move, Reserve, Rest, StoppedError
from halfseen.cell.model import MountedArm
from halfseen.cell.space import Reservations, Space

DEADLOCK = "deadlock"
"""Cause of a cut: arms wait for one another, or for an idle one, and none has a free way home."""
PATIENCE_S = 15.0
_ASK_EVERY = 10  # ticks between two checks whether a space is free


class ActivityEnd(NamedTuple):
    """The number of an arm and the result of its activity."""

    arm: int
    result: Any


@dataclass
class ConflictCounts:
    """Counts of conflicts between arms.

    How often an arm waited for space, the total waiting time [s], the number of deadlocks (including arms that waited
    too long), and how often an arm went home to resolve one.
    """

    num_waits: int = 0
    waited_s: float = 0.0
    num_deadlocks: int = 0
    num_gave_way: int = 0


@dataclass(eq=False)
class _Request:
    """A pending reservation."""

    command: Reserve
    space: Space
    since_s: float
    blocked_by: tuple[int, ...] = ()
    num_asked: int = 0


@dataclass(eq=False)
class _Worker:
    """Progress of one arm's activity."""

    activity: Activity[Any] | None = None
    way: Iterator[Angles] = field(default_factory=lambda: iter(()))
    ticks: int = 0
    answer: Any = None
    request: _Request | None = None
    reserved_s: float = 0.0

    @property
    def blocked_by(self) -> tuple[int, ...]:
        return () if self.request is None else self.request.blocked_by


class Executor:
    """Executes the activities of the arms of a cell, number 0 first; `tally` counts their conflicts.

    An arm that waits for space longer than `patience_s` [s] counts as stuck.
    """

    def __init__(self, cell: LiveCell, robots: Sequence[MountedArm], patience_s: float = PATIENCE_S) -> None:
        self._cell, self._robots, self._patience_s = cell, robots, patience_s
        self._reservations = Reservations(cell, robots)
        self._workers = [_Worker() for _ in robots]
        self._steered: set[int] = set()
        self.tally = ConflictCounts()

    def begin(self, arm: int, activity: Activity[Any]) -> None:
        """Start an activity of an idle arm."""
        assert not self.is_busy(arm), "an arm runs one activity at a time"
        self._workers[arm] = _Worker(activity)

    def is_busy(self, arm: int) -> bool:
        """Whether an arm has an activity."""
        return self._workers[arm].activity is not None

    def work(self, most_ticks: int | None = None) -> list[ActivityEnd]:
        """Run until an arm has ended its activity.

        Parameters
        ----------
        most_ticks
            Number of ticks after which several arms return in any case; None for no limit.

        Returns
        -------
        list of Ended
            Arms that have ended, lowest number first; empty if no arm is busy.

        Raises
        ------
        StoppedError
            Arms wait for one another, or for an idle one, and none has a free way home; or a watch stopped the cell.
        """
        if len(self._robots) == 1 and (activity := self._workers[0].activity) is not None:
            self._workers[0] = _Worker()
            return [ActivityEnd(0, self._cell.carry_out(self._robots[0], activity))]
        num_ticks = 0
        while any(worker.activity is not None for worker in self._workers) and num_ticks != most_ticks:
            # If another arm's end interrupted this tick, arms already steered in it are not steered again.
            ticked = {arm: self._tick(arm) for arm in range(len(self._workers)) if arm not in self._steered}
            self._steered |= {arm for arm, ended in ticked.items() if ended is None}
            if ended := [each for each in ticked.values() if each is not None]:
                return ended
            if num_ticks % _ASK_EVERY == 0:
                self._resolve_deadlocks()
            self._cell.wait(self._cell.tick_s)
            self._steered.clear()
            num_ticks += 1
        return []

    def _tick(self, arm: int) -> ActivityEnd | None:
        """Command an arm's servos for the next tick; return its result if its activity has ended."""
        worker = self._workers[arm]
        while worker.activity is not None:
            if (angles := next(worker.way, None)) is not None:
                self._reservations.advance(arm, angles)
                return None
            if worker.ticks > 0:
                worker.ticks -= 1
                return None
            if worker.request is not None and not self._is_decided(arm, worker, worker.request):
                return None
            try:
                command = worker.activity.send(worker.answer)
            except StopIteration as stopped:
                worker.activity = None
                self._reservations.let_go(arm)
                return ActivityEnd(arm, stopped.value)
            worker.answer = True
            self._take_up(arm, worker, command)
        return None

    def _take_up(self, arm: int, worker: _Worker, command: Command) -> None:
        robot, cell = self._robots[arm], self._cell
        match command:
            case Move():
                worker.way = cell.moved(robot, command)
            case Grip() | Rest():
                if isinstance(command, Grip):
                    cell.close(robot, command.opening_m)
                worker.ticks = round(command.seconds / cell.tick_s)
            case Reserve():
                self._reservations.stand(arm)
                space = self._reservations.space(arm, command.way, command.below_m)
                worker.request = _Request(command, space, cell.time_s)

    def _is_decided(self, arm: int, worker: _Worker, request: _Request) -> bool:
        """Whether a request is now granted or refused; it is checked every few ticks."""
        request.num_asked += 1
        if (request.num_asked - 1) % _ASK_EVERY:
            return False
        request.blocked_by = self._reservations.in_the_way(arm, request.space)
        if not request.blocked_by:
            self._grant(arm, worker, request, request.space, answer=True)
        elif request.command.is_patient:
            self.tally.num_waits += request.num_asked == 1
            return False
        else:
            worker.request, worker.answer = None, False
        return True

    def _grant(self, arm: int, worker: _Worker, request: _Request, space: Space, *, answer: bool) -> None:
        self._reservations.reserve(arm, space, request.command.below_m)
        self.tally.waited_s += self._cell.time_s - request.since_s
        worker.request, worker.answer, worker.reserved_s = None, answer, self._cell.time_s

    def _resolve_deadlocks(self) -> None:
        """Detect a deadlock and let one arm give way."""
        blocked = self._blocked()
        does_nobody_move = len(blocked) == sum(worker.activity is not None for worker in self._workers)
        for_good = (
            blocked if does_nobody_move else {k: each for k, each in blocked.items() if self._waits_for_itself(k)}
        )
        now_s = self._cell.time_s
        stuck = for_good or {k: each for k, each in blocked.items() if now_s - each.since_s > self._patience_s}
        if not stuck:
            return
        if self._send_one_home(stuck) or self._refuse_those_at_home(stuck):
            self.tally.num_deadlocks += 1
        elif for_good:
            raise StoppedError(DEADLOCK)

    def _blocked(self) -> dict[int, _Request]:
        """Requests that other arms still block, by arm; blockers may have left since the last check."""
        blocked = {}
        for arm, worker in enumerate(self._workers):
            if worker.request is not None and worker.request.blocked_by:
                worker.request.blocked_by = self._reservations.in_the_way(arm, worker.request.space)
                if worker.request.blocked_by:
                    blocked[arm] = worker.request
        return blocked

    def _send_one_home(self, stuck: dict[int, _Request]) -> bool:
        """Send home the arm that reserved last among those with a free way home; return whether there is one."""
        for arm in sorted(stuck, key=lambda arm: -self._workers[arm].reserved_s):
            request = stuck[arm]
            if not len(request.command.back):
                continue
            back = self._reservations.space(arm, request.command.back, request.command.below_m)
            if not self._reservations.in_the_way(arm, back):
                self.tally.num_gave_way += 1
                self._grant(arm, self._workers[arm], request, back, answer=False)
                return True
        return False

    def _refuse_those_at_home(self, stuck: dict[int, _Request]) -> bool:
        """Refuse the requests of stuck arms that are at home; return whether there are any."""
        at_home = {arm: request for arm, request in stuck.items() if not len(request.command.back)}
        for arm, request in at_home.items():
            self.tally.waited_s += self._cell.time_s - request.since_s
            self._workers[arm].request, self._workers[arm].answer = None, False
        return bool(at_home)

    def _waits_for_itself(self, arm: int) -> bool:
        """Whether an arm waits, directly or indirectly, for itself."""
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
