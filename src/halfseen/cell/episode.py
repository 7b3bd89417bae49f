"""One table from the first look to the end, with K arms: look, decide, record, execute, and account for rewards.

Each arm decides when it is free, while the others continue. With K = 1 no arm ever waits.
"""

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.special import expit

from halfseen.cell.executor import ActivityEnd, Executor
from halfseen.cell.fetching import ObservedAttempt
from halfseen.cell.live_cell import Activity, Rest, StoppedError
from halfseen.cell.rewards import EpisodeStatistics, Run, TeamRun
from halfseen.cell.space import Touches
from halfseen.cell.table_state import ArmStatus, Belief, CellState
from halfseen.cell.workcell import Workcell
from halfseen.logs.recorder import TrajectoryRecorder
from halfseen.shapes import Bool
from halfseen.world import random
from halfseen.world.actions import TARGETED, VERB_NAMES, WAIT, ActionSpace, Verb
from halfseen.world.policy import Policy, PolicyDraw
from halfseen.world.random import Key
from halfseen.world.state import TableState

PAUSE_S = 0.5  # duration of a look and a decision on the cell's clock [s]
NOTHING_SEEN = "nothing-seen"  # cause of a cut: no object is in view, so there is nothing to decide


class Moment(NamedTuple):
    """A decision and the state in which it was made.

    `stage` counts from 1. `action` is an index of `ActionSpace` (one past its end is WAIT), and `words` describes it.
    `arm` is the number of the robot that acts. With several robots, `of_team` states the robot and its action.
    """

    stage: int
    state: TableState
    action: int
    words: str
    key: Key
    arm: int = 0
    of_team: str | None = None


class Follower(Protocol):
    """An observer of a table."""

    def decided(self, moment: Moment) -> None:
        """Receive a decision before it is executed."""
        ...

    def ended(self, run: Run) -> None:
        """Receive the result of the table."""
        ...


Follow = Callable[[int, Workcell], Follower]
"""Makes the observer of a table from its number and its cell, before the episode starts."""


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
    """Clear a table with a policy and all arms of a cell, and record the trajectory.

    The camera looks before every decision and excludes objects that an arm partly hides.

    Parameters
    ----------
    cell
        The cell, before its first look.
    is_dirty
        Ground truth of each cup.
    policy
        Makes each decision, for the arm that is free.
    belief
        The robot's model of the world. Its rewards are the ones paid; its horizon applies to each arm.
    trajectory
        Recorder of the trajectory; it is ended here, as finished or cut.
    key
        Random key of the policy.
    tells_truth
        Whether to record which objects are dirty, as calibration needs.
    on_decision
        Called with each decision before it is executed.

    Returns
    -------
    Run
        Result of the table; a `TeamRun` for several arms.
    """
    begin_s, episode = cell.cell.time_s, _Episode(cell, is_dirty, belief, trajectory)
    statistics = episode.statistics
    try:
        for step in range(episode.num_decisions):
            state, rows = episode.look(step)
            if tells_truth:
                statistics.truth.add_to(rows, cell)
            drawn_from = random.fold_in(key, step)
            decision = policy.decide(state, drawn_from)
            on_decision(episode.begin(decision, step, state, rows, drawn_from))
            is_over = episode.go_on() or step + 1 == episode.num_decisions
            reward, of_robots = statistics.pay(is_over=is_over)
            trajectory.complete_stage(reward, elapsed_s=cell.cell.time_s - begin_s, own_rewards=of_robots)
            if is_over:
                break
        trajectory.finish(elapsed_s=cell.cell.time_s - begin_s)
    except StoppedError as stopped:
        statistics.run.cause = str(stopped)
        trajectory.cut(str(stopped), elapsed_s=cell.cell.time_s - begin_s)
    return episode.run(cell.cell.time_s - begin_s)


class _Episode:
    """The arms at a table; each decides when it is free."""

    def __init__(
        self, cell: Workcell, is_dirty: Bool[np.ndarray, " N"], belief: Belief, trajectory: TrajectoryRecorder
    ) -> None:
        robots = [station.robot for station in cell.stations]
        self.cell, self.is_team, self._config, self._trajectory = cell, len(robots) > 1, belief.config, trajectory
        self.num_decisions = belief.config.horizon * len(robots)
        self.state, self._executor = CellState(cell, belief), Executor(cell.cell, robots)
        run = TeamRun(busy_s=[0.0] * len(robots)) if self.is_team else Run()
        self.statistics = EpisodeStatistics(run, cell, is_dirty, belief.config)
        self._touches = Touches(cell.cell, robots)
        if self.is_team:
            cell.cell.watches.append(self._touches)

    @property
    def decider(self) -> int:
        """The arm that decides."""
        return next(number for number, arm in enumerate(self.state.arms) if arm.is_free)

    def look(self, step: int) -> tuple[TableState, list[dict[str, Any]]]:
        """Look at the table before a decision; return the state and the objects' log rows."""
        # With several arms, later looks take their time at the end of the previous activity, while other arms move.
        if step == 0 or not self.is_team:
            self.cell.cell.wait(PAUSE_S)
        self.cell.look()
        if not self.cell.memory.objects:
            raise StoppedError(NOTHING_SEEN)
        rows = self.state.rows()
        if step == 0:
            self.statistics.see(expit([row["log_odds"] for row in rows]))
        return self.state.state(self.decider, self.num_decisions - step), rows

    def begin(self, decision: PolicyDraw, step: int, state: TableState, rows: list[dict[str, Any]], key: Key) -> Moment:
        """Record a decision and start its arm on it, before any time passes."""
        number, actions = self.decider, ActionSpace(state.num_objects)
        action, probability = int(decision.action), float(decision.probability)
        verb, target = int(actions.verb(action)), int(actions.target(action))
        self._trajectory.begin_stage(
            self.state.columns(),
            rows,
            VERB_NAMES[verb],
            target if verb in TARGETED else None,
            None if np.isnan(probability) else probability,  # planners give no probability
            number if self.is_team else None,
        )
        arm = self.state.arms[number]
        arm.verb, arm.target, arm.begun_s = verb, target if verb in TARGETED else 0, self.cell.cell.time_s
        arm.decisions_to_go -= 1
        self.statistics.count_verb(VERB_NAMES[verb])
        if verb in TARGETED:
            arm.chance = float(expit(rows[target]["log_odds"]))
        if verb != WAIT:
            self._executor.begin(number, self._activity(number, verb, target))
        of_team = f"{self.cell.stations[number].robot.name}: {arm.words}" if self.is_team else None
        return Moment(step + 1, state, action, self._in_words(arm, verb, rows), key, number, of_team)

    def _in_words(self, arm: ArmStatus, verb: int, rows: list[dict[str, Any]]) -> str:
        """Description of the decision; with several arms, of what all are doing."""
        if self.is_team:
            return self.state.in_words()
        if verb == Verb.FINISH:
            return "FINISH: nothing is worth another step"
        hidden = rows[arm.target]["occlusion"]
        return f"{VERB_NAMES[verb]} object {arm.target}: dirty with probability {arm.chance:.2f}, {hidden:.0%} hidden"

    def _activity(self, number: int, verb: int, target: int) -> Activity[tuple[ObservedAttempt, float] | None]:
        """Execute a verb; return the attempt and its duration [s]."""
        if verb == Verb.FINISH:
            yield Rest(float(self._config.transport_s))
            return None
        begin_s, work = self.cell.cell.time_s, self.cell.washing if verb == Verb.WASH else self.cell.lifting
        attempt = yield from work(target, number)
        seconds = self.cell.cell.time_s - begin_s
        if self.is_team:
            yield Rest(PAUSE_S)
        return attempt, seconds

    def go_on(self) -> bool:
        """Run until an arm is free to decide; return whether the table is over instead."""
        # If another arm is free too, no time passes: a log places an arm at its object until it decides again.
        while not self.statistics.truth.is_cleared(self.cell):
            if any(arm.is_free for arm in self.state.arms):
                return False
            if not self._work():
                return True
        # The table is over when the last arm is home.
        while self._work():
            pass
        return True

    def _work(self) -> bool:
        """Run until an arm has ended its activity; return whether one has."""
        ended = self._executor.work()
        for each in ended:
            self._end(each)
        return bool(ended)

    def _end(self, ended: ActivityEnd) -> None:
        arm = self.state.arms[ended.arm]
        if ended.result is None:
            arm.is_parked = True
        else:
            attempt, seconds = ended.result
            if isinstance(self.statistics.run, TeamRun):
                self.statistics.run.busy_s[ended.arm] += self.cell.cell.time_s - arm.begun_s
            self.state.learn(ended.arm, arm.target, attempt)
            assert arm.verb is not None, "it was busy"
            self.statistics.end(attempt, arm.verb, arm.chance, seconds, ended.arm)
        for other in self.state.arms:
            if other is arm or other.verb == WAIT:
                other.verb = None
        for number, each in enumerate(self.state.arms):
            if each.is_done:
                self.statistics.leave(number)

    def run(self, seconds: float) -> Run:
        """Result of the table."""
        run = replace(self.statistics.run, seconds=seconds, **self.statistics.truth.counts(self.cell))
        if not isinstance(run, TeamRun):
            return run
        return replace(run, num_collisions=self._touches.num_collisions, **asdict(self._executor.tally))
