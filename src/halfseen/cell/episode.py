"""One table from the first look to its end, by K arms."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import expit

from halfseen.arrays import Rows
from halfseen.cell.executor import Crew, Ended
from halfseen.cell.fetching import Attempt
from halfseen.cell.live_cell import Activity, Rest, StoppedError
from halfseen.cell.rewards import Account, Run
from halfseen.cell.space import Touches
from halfseen.cell.table_state import Belief, TeamTable, rows_of, state_of
from halfseen.cell.workcell import Workcell
from halfseen.logs.recording.trajectory_recorder import TrajectoryRecorder
from halfseen.shapes import Bool
from halfseen.world import random
from halfseen.world.actions import TARGETED, VERB_NAMES, WAIT, ActionSpace, Verb
from halfseen.world.policy import Policy
from halfseen.world.random import Key
from halfseen.world.state import TableState

PAUSE_S = 0.5
"""What a look and a decision take on the cell's clock [s]."""
NOTHING_SEEN = "nothing-seen"
"""Cause of a cut: no object is in view, so that there is nothing to decide."""
Row = dict[str, Any]
"""What a log holds of an object in a stage."""


class Moment(NamedTuple):
    """A decision, and what it was made from."""

    stage: int
    """From 1."""
    state: TableState
    """The table as the robot knows it."""
    action: int
    """What is done, as `ActionSpace` has it."""
    words: str
    """The same, for people."""
    key: Key
    """What the policy drew from."""
    arm: int = 0
    """Number of the robot that does it."""
    of_team: str | None = None
    """Which robot does what, where there are several."""


class Chosen(NamedTuple):
    """An action."""

    action: int
    """As `ActionSpace` has it; one beyond it is WAIT."""
    verb: int
    target: int

    @property
    def acted_on(self) -> int | None:
        """Its object; None where it has none."""
        return self.target if self.verb in TARGETED else None

    @property
    def name(self) -> str:
        """Of its verb."""
        return VERB_NAMES[self.verb]


class Told(NamedTuple):
    """A decision in words, as `Moment` has it."""

    words: str
    arm: int = 0
    of_team: str | None = None


class Shift(ABC):
    """Who works at a table.

    Parameters
    ----------
    cell
        The cell, before its first look.
    account
        What books what is earned.
    num_decisions
        How many may be made.
    """

    def __init__(self, cell: Workcell, account: Account, num_decisions: int) -> None:
        self.cell, self.account, self.num_decisions = cell, account, num_decisions

    @abstractmethod
    def look(self, step: int) -> None:
        """Look at the table before a decision, the first of which is number 0."""

    @abstractmethod
    def known(self, step: int) -> tuple[TableState, list[Row]]:
        """Give the state that is decided in, and its objects as a log has them."""

    @property
    @abstractmethod
    def decider(self) -> int | None:
        """Of several robots, the number of the one that decides next; None of one."""

    @abstractmethod
    def covariates(self) -> Row:
        """Give what else a log has of the stage that begins."""

    @abstractmethod
    def begin(self, chosen: Chosen, rows: list[Row]) -> Told:
        """Take up what was chosen, before any time passes."""

    @abstractmethod
    def go_on(self) -> bool:
        """Carry it out until somebody decides again; whether the table is over instead."""


def cleared(
    shift: Shift,
    policy: Policy,
    trajectory: TrajectoryRecorder,
    key: Key,
    *,
    tells_truth: bool,
    on_decision: Callable[[Moment], None],
) -> Run:
    """Let a policy clear a table, and record it.

    Parameters
    ----------
    shift
        Who works at it.
    policy
        What decides.
    trajectory, key, tells_truth, on_decision
        As for `halfseen.cell.episode.play`.

    Returns
    -------
    Run
        What came of it: that of the account, with its end.
    """
    cell, account = shift.cell, shift.account
    begin_s = cell.cell.time_s
    try:
        for step in range(shift.num_decisions):
            shift.look(step)
            if not cell.memory.objects:
                raise StoppedError(NOTHING_SEEN)
            state, rows = shift.known(step)
            if step == 0:
                account.see(chances_of(rows))
            if tells_truth:
                account.truth.add_to(rows, cell)
            drawn_from = random.fold_in(key, step)
            chosen, chance = _chosen(policy, state, drawn_from)
            trajectory.begin_stage(shift.covariates(), rows, chosen.name, chosen.acted_on, chance, shift.decider)
            account.decide(chosen.name)
            on_decision(_moment(step, state, chosen, shift.begin(chosen, rows), drawn_from))
            is_over = shift.go_on() or step + 1 == shift.num_decisions
            paid, elapsed_s = account.pay(is_over=is_over), cell.cell.time_s - begin_s
            trajectory.complete_stage(paid.reward, elapsed_s=elapsed_s, own_rewards=paid.of_robots)
            if is_over:
                break
        trajectory.finish(elapsed_s=cell.cell.time_s - begin_s)
    except StoppedError as stopped:
        account.run.cause = str(stopped)
        trajectory.cut(account.run.cause, elapsed_s=cell.cell.time_s - begin_s)
    account.run.seconds = cell.cell.time_s - begin_s
    return replace(account.run, **account.truth.counts(cell))


def _moment(step: int, table: TableState, chosen: Chosen, told: Told, key: Key) -> Moment:
    return Moment(step + 1, table, chosen.action, told.words, key, told.arm, told.of_team)


def _chosen(policy: Policy, state: TableState, key: Key) -> tuple[Chosen, float | None]:
    """Decide; how likely that was, too, where the policy can say it: a planner cannot."""
    decision, actions = policy.decide(state, key), ActionSpace(state.num_objects)
    action = int(decision.action)
    chance = None if np.isnan(decision.probability) else float(decision.probability)
    return Chosen(action, int(actions.verb(action)), int(actions.target(action))), chance


def chances_of(rows: list[Row]) -> Rows:
    """P(DIRTY) of the objects of a stage.

    Parameters
    ----------
    rows
        As a log has them.
    """
    return expit(np.array([row["log_odds"] for row in rows], dtype=float))


def play(
    cell: Workcell,
    is_dirty: Bool[np.ndarray, " N"],
    policy: Policy,
    belief: Belief,
    trajectory: TrajectoryRecorder,
    key: Key,
    *,
    tells_truth: bool = False,
    on_decision: Callable[[Moment], None] = lambda _: None,
) -> Run:
    """Let a policy clear a table, and record it.

    Parameters
    ----------
    cell
        The cell, before its first look.
    is_dirty
        The truth of each cup.
    policy
        What decides.
    belief
        What the robot believes of the world; its rewards are those that are earned.
    trajectory
        What is recorded; it is ended, finished or cut.
    key
        What the policy draws from.
    tells_truth
        Record which objects are dirty, as whoever calibrates a cell knows.
    on_decision
        Called with each decision, before it is carried out.

    Returns
    -------
    Run
        What came of it.
    """
    account = Account(Run(), cell, is_dirty, belief.config)
    shift = _OneRobot(cell, account, belief)
    return cleared(shift, policy, trajectory, key, tells_truth=tells_truth, on_decision=on_decision)


class _OneRobot(Shift):
    """A robot that has the table for itself."""

    def __init__(self, cell: Workcell, account: Account, belief: Belief) -> None:
        super().__init__(cell, account, belief.config.horizon)
        self._belief = belief
        self._verb, self._target, self._chance = Verb.FINISH, 0, 0.0

    def look(self, step: int) -> None:
        self.cell.cell.wait(PAUSE_S)
        self.cell.look()

    def known(self, step: int) -> tuple[TableState, list[Row]]:
        memory = self.cell.memory
        return state_of(memory, self._belief, self.num_decisions - step), rows_of(memory, self._belief)

    @property
    def decider(self) -> None:
        return None

    def covariates(self) -> Row:
        return {}

    def begin(self, chosen: Chosen, rows: list[Row]) -> Told:
        self._verb, self._target = Verb(chosen.verb), chosen.target
        if self._verb is Verb.FINISH:
            return Told("FINISH: nothing is worth another step")
        self._chance, hidden = float(chances_of(rows)[self._target]), rows[self._target]["occlusion"]
        what = f"{self._verb.name} object {self._target}"
        return Told(f"{what}: dirty with probability {self._chance:.2f}, {hidden:.0%} hidden")

    def go_on(self) -> bool:
        cell, begin_s = self.cell, self.cell.cell.time_s
        if self._verb is Verb.FINISH:
            cell.cell.wait(float(self._belief.config.transport_s))
            return True
        attempt = cell.wash(self._target) if self._verb is Verb.WASH else cell.lift(self._target)
        self.account.end(attempt, self._verb, self._chance, cell.cell.time_s - begin_s)
        return self.account.truth.is_cleared(cell)


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
