"""One table that several arms clear, from the first look to its end, decided by a policy of a team."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import NamedTuple

import numpy as np

from halfseen.cell.account import Account, Run
from halfseen.cell.attempt import Attempt
from halfseen.cell.clearing import PAUSE_S, Chosen, Moment, Row, Shift, Told, chances_of, cleared
from halfseen.cell.commands import Activity, Rest
from halfseen.cell.several.crew import Crew, Ended
from halfseen.cell.several.team_table import TeamTable
from halfseen.cell.several.touches import Touches
from halfseen.cell.table_state import Belief, rows_of
from halfseen.cell.workcell import Workcell
from halfseen.logs.trajectory_recorder import TrajectoryRecorder
from halfseen.shapes import Bool
from halfseen.world.actions import WAIT, Verb
from halfseen.world.policy import Policy
from halfseen.world.random import Key
from halfseen.world.state import TableState


@dataclass
class TeamRun(Run):
    """What came of one table that several arms cleared.

    Attributes
    ----------
    num_collisions
        How often arms, or what they held, touched.
    num_waits, num_deadlocks, num_gave_way, waited_s
        How they got along, as `halfseen.cell.several.crew.Tally` has it.
    busy_s
        For how long each arm was at WASH or LIFT [s].
    """

    num_collisions: int = 0
    num_waits: int = 0
    num_deadlocks: int = 0
    num_gave_way: int = 0
    waited_s: float = 0.0
    busy_s: list[float] = field(default_factory=list)


def play_team(
    cell: Workcell,
    is_dirty: Bool[np.ndarray, " N"],
    policy: Policy,
    belief: Belief,
    trajectory: TrajectoryRecorder,
    key: Key,
    *,
    tells_truth: bool = False,
    on_decision: Callable[[Moment], None] = lambda _: None,
) -> TeamRun:
    """Let a policy clear a table with all arms of a cell, and record it.

    The camera looks before every decision, and leaves out what an arm cuts.

    Parameters
    ----------
    cell, is_dirty, belief, trajectory, key, tells_truth, on_decision
        As for `halfseen.cell.episode.play`; the horizon of the belief's world is counted in decisions of each arm.
    policy
        What decides.

    Returns
    -------
    TeamRun
        What came of it.
    """
    shift = _Arms(cell, Account(TeamRun(), cell, is_dirty, belief.config), belief)
    told = cleared(shift, policy, trajectory, key, tells_truth=tells_truth, on_decision=on_decision)
    assert isinstance(told, TeamRun), "it is the run of the account"
    seen = {"num_collisions": shift.touches.num_collisions, "busy_s": shift.busy_s}
    return replace(told, **seen, **asdict(shift.crew.tally))


class _Done(NamedTuple):
    """An attempt that an arm has ended, and what it took [s]."""

    attempt: Attempt
    seconds: float


class _Arms(Shift):
    """The arms at a table: each decides when it is free."""

    def __init__(self, cell: Workcell, account: Account, belief: Belief) -> None:
        robots = [station.robot for station in cell.stations]
        super().__init__(cell, account, belief.config.horizon * len(robots))
        self.crew, self.touches = Crew(cell.cell, robots), Touches(cell.cell, robots)
        self.table = TeamTable(cell, belief)
        # A state has room for the attempts of all arms.
        self.table.belief = belief._replace(config=replace(belief.config, horizon=self.num_decisions))
        self.busy_s = [0.0 for _ in robots]
        self._config = belief.config
        cell.cell.watches.append(self.touches)

    @property
    def decider(self) -> int:
        return next(arm for arm, one in enumerate(self.table.doing) if one.is_free)

    def look(self, step: int) -> None:
        # Later looks take their time at the end of what came before (`_activity`): the other arms go on meanwhile.
        if step == 0:
            self.cell.cell.wait(PAUSE_S)
        self.cell.look()

    def known(self, step: int) -> tuple[TableState, list[Row]]:
        rows = rows_of(self.cell.memory, self.table.belief)
        self.table.add_to(rows)
        return self.table.state(self.decider, self.num_decisions - step), rows

    def covariates(self) -> Row:
        return self.table.columns()

    def begin(self, chosen: Chosen, rows: list[Row]) -> Told:
        arm = self.decider
        one = self.table.doing[arm]
        one.verb, one.target, one.begun_s = chosen.verb, chosen.acted_on or 0, self.cell.cell.time_s
        one.decisions_to_go -= 1
        if chosen.acted_on is not None:
            one.chance = float(chances_of(rows)[chosen.acted_on])
        if chosen.verb != WAIT:
            self.crew.begin(arm, self._activity(chosen.verb, chosen.target, arm))
        return Told(self.table.in_words(), arm, f"{self.table.name(arm)}: {one.words}")

    def _activity(self, verb: int, target: int, arm: int) -> Activity[_Done | None]:
        if verb == Verb.FINISH:
            yield Rest(float(self._config.transport_s))
            return None
        begin_s, work = self.cell.cell.time_s, self.cell.washing if verb == Verb.WASH else self.cell.lifting
        attempt = yield from work(target, arm)
        seconds = self.cell.cell.time_s - begin_s
        yield Rest(PAUSE_S)
        return _Done(attempt, seconds)

    def go_on(self) -> bool:
        # Where another arm is free, too, no time passes: a log takes an arm to be at its object until it decides again.
        while not self.account.truth.is_cleared(self.cell):
            if any(one.is_free for one in self.table.doing):
                return False
            if not self._work():
                return True
        # It is over when the last arm is home.
        while self._work():
            pass
        return True

    def _work(self, most_ticks: int | None = None) -> bool:
        """Let time pass until an arm has done what it was at; whether one has."""
        ended = self.crew.work(most_ticks)
        for done in ended:
            self._end(done)
        return bool(ended)

    def _end(self, ended: Ended) -> None:
        one, done = self.table.doing[ended.arm], ended.result
        if one.verb == Verb.FINISH:
            one.is_parked = True
        else:
            assert one.verb is not None, "it was at something"
            self.busy_s[ended.arm] += self.cell.cell.time_s - one.begun_s
            self.table.learn(ended.arm, one.target, done.attempt)
            self.account.end(done.attempt, one.verb, one.chance, done.seconds, ended.arm)
        one.verb = None
        for other in self.table.doing:
            if other.verb == WAIT:
                other.verb = None
        for arm, each in enumerate(self.table.doing):
            if each.is_done:
                self.account.leave(arm)
