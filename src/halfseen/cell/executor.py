"""K arms that move together in one clock: each asks for the space of a way before it goes, and waits where it is taken.

Where arms wait for one another in a ring, where all that are busy wait (for one another, or for an idle one that does
not go), or where one waits for too long, the one that came last and has a free way home gives way: what it
then reserves is that way, and the others go on. One that is at home already gives up what it wanted. If neither helps,
and nobody moves who could change that, the cell is stopped. With K = 1 there is nobody to wait for.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from halfseen.cell.kinematics import Angles
from halfseen.cell.live_cell import Activity, Command, Grip, LiveCell, Move, Reserve, Rest, StoppedError
from halfseen.cell.model import Robot
from halfseen.cell.space import Reservations, Space

DEADLOCK = "deadlock"
"""Cause of a cut: arms wait for one another, or for one that is idle, and none has a free way home."""
PATIENCE_S = 15.0
_ASK_EVERY = 10  # ticks between two looks whether a space is free by now


class Ended(NamedTuple):
    """The number of an arm, and what its activity returned."""

    arm: int
    result: Any


@dataclass
class Tally:
    """How arms got along.

    How often one had to wait for space, and all together for how long [s]; how often they waited for one another, for
    an idle one, or one for too long, and how often one went home for that.
    """

    num_waits: int = 0
    waited_s: float = 0.0
    num_deadlocks: int = 0
    num_gave_way: int = 0


@dataclass(eq=False)
class _Request:
    """A reservation that is not decided yet."""

    command: Reserve
    space: Space
    since_s: float
    blocked_by: tuple[int, ...] = ()
    num_asked: int = 0


@dataclass(eq=False)
class _Worker:
    """What one arm is doing."""

    activity: Activity[Any] | None = None
    way: Iterator[Angles] = field(default_factory=lambda: iter(()))
    end: Angles | None = None
    ticks: int = 0
    answer: Any = None
    request: _Request | None = None
    reserved_s: float = 0.0

    @property
    def blocked_by(self) -> tuple[int, ...]:
        return () if self.request is None else self.request.blocked_by


class Executor:
    """Carries out the activities of the arms of a cell, number 0 first; `tally` says how they got along so far.

    An arm that waits for space longer than `patience_s` counts as stuck [s].
    """

    def __init__(self, cell: LiveCell, robots: Sequence[Robot], patience_s: float = PATIENCE_S) -> None:
        self._cell, self._robots, self._patience_s = cell, robots, patience_s
        self._reservations = Reservations(cell, robots)
        self._workers = [_Worker() for _ in robots]
        self._steered: set[int] = set()
        self.tally = Tally()

    def begin(self, arm: int, activity: Activity[Any]) -> None:
        """Let an idle arm begin an activity."""
        assert not self.is_busy(arm), "an arm does one thing at a time"
        self._workers[arm] = _Worker(activity)

    def is_busy(self, arm: int) -> bool:
        """Whether an arm has an activity."""
        return self._workers[arm].activity is not None

    def work(self, most_ticks: int | None = None) -> list[Ended]:
        """Let time pass until an arm has ended its activity.

        Parameters
        ----------
        most_ticks
            After which several arms stop all the same; None for never.

        Returns
        -------
        list of Ended
            Who has, the lowest number first; none where no arm is busy.

        Raises
        ------
        StoppedError
            Arms wait for one another, or for one that is idle, and none has a free way home; or a watch stopped the
            cell.
        """
        if len(self._robots) == 1 and (activity := self._workers[0].activity) is not None:
            self._workers[0] = _Worker()
            return [Ended(0, self._cell.carry_out(self._robots[0], activity))]
        num_ticks = 0
        while any(worker.activity is not None for worker in self._workers) and num_ticks != most_ticks:
            # An arm that was steered before the end of another broke a tick off is not steered twice in it.
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

    def _tick(self, arm: int) -> Ended | None:
        """Steer an arm's servos for the next tick; its result if its activity has ended."""
        worker, robot = self._workers[arm], self._robots[arm]
        while worker.activity is not None:
            if (angles := next(worker.way, None)) is not None:
                self._cell.steer(robot, angles)
                self._reservations.advance(arm, angles)
                return None
            if worker.end is not None:
                self._cell.steer(robot, worker.end)
                worker.end = None
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
                return Ended(arm, stopped.value)
            worker.answer = True
            self._take_up(arm, worker, command)
        return None

    def _take_up(self, arm: int, worker: _Worker, command: Command) -> None:
        robot, cell = self._robots[arm], self._cell
        match command:
            case Move():
                worker.way, worker.end = iter(cell.commanded_rad(robot, command)), command.way[-1]
            case Grip():
                cell.close(robot, command.opening_m)
                worker.ticks = round(command.seconds / cell.tick_s)
            case Rest():
                worker.ticks = round(command.seconds / cell.tick_s)
            case Reserve():
                self._reservations.stand(arm)
                space = self._reservations.space(arm, command.way, command.below_m)
                worker.request = _Request(command, space, cell.time_s)

    def _is_decided(self, arm: int, worker: _Worker, request: _Request) -> bool:
        """Whether a request is granted or refused by now; it is looked at every few ticks."""
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
        """Notice a deadlock, and let one arm give way."""
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
        """Requests for space that other arms have now, by arm: some may have left it since it was asked for."""
        blocked = {}
        for arm, worker in enumerate(self._workers):
            if worker.request is not None and worker.request.blocked_by:
                worker.request.blocked_by = self._reservations.in_the_way(arm, worker.request.space)
                if worker.request.blocked_by:
                    blocked[arm] = worker.request
        return blocked

    def _send_one_home(self, stuck: dict[int, _Request]) -> bool:
        """Send home the arm that came last, of those whose way home is free; whether there is one."""
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
        """Refuse the requests of arms that have nothing to go back from; whether there are any."""
        at_home = {arm: request for arm, request in stuck.items() if not len(request.command.back)}
        for arm, request in at_home.items():
            self.tally.waited_s += self._cell.time_s - request.since_s
            self._workers[arm].request, self._workers[arm].answer = None, False
        return bool(at_home)

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
