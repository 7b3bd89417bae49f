"""One table that several arms clear, from the first look to its end, decided by a policy of a team."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool
from scipy.special import expit

from halfseen.cell.commands import Activity, Rest
from halfseen.cell.episode import NOTHING_SEEN, PAUSE_S, Moment, Run, Truth
from halfseen.cell.luck import luck_of_table, luck_of_washing
from halfseen.cell.several.crew import Crew, Ended
from halfseen.cell.several.team_table import TeamTable
from halfseen.cell.several.touches import Touches
from halfseen.cell.stops import StoppedError
from halfseen.cell.table_state import Belief, rows_of
from halfseen.cell.workcell import Attempt, Workcell
from halfseen.logs.recorder import PathRecorder
from halfseen.team.actions import WAIT
from halfseen.team.policy import TeamPolicy
from halfseen.team.recording import TEAM_VERBS
from halfseen.team.state import TeamState
from halfseen.world.action_space import TARGETED, ActionSpace, Verb


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
    policy: TeamPolicy,
    belief: Belief,
    path: PathRecorder,
    key: Array,
    *,
    tells_truth: bool = False,
    on_decision: Callable[[Moment], None] = lambda _: None,
) -> TeamRun:
    """Let a policy clear a table with all arms of a cell, and record it.

    The camera looks before every decision, and leaves out what an arm cuts.

    Parameters
    ----------
    cell, is_dirty, belief, path, key, tells_truth, on_decision
        As for `halfseen.cell.episode.play`; the horizon of the belief's world is counted in decisions of each arm.
    policy
        What decides.

    Returns
    -------
    TeamRun
        What came of it.
    """
    shift = _Shift(cell, Truth(cell, is_dirty), belief)
    begin_s = cell.cell.time_s
    try:
        cell.cell.wait(PAUSE_S)
        for step in range(len(cell.stations) * belief.config.horizon):
            state, rows = shift.looked(step)
            if tells_truth:
                shift.truth.add_to(rows, cell)
            if step:
                path.complete_stage(shift.paid(), elapsed_s=cell.cell.time_s - begin_s)
            drawn_from = jax.random.fold_in(key, step)
            decision = _decide(policy, state, drawn_from)
            shift.begin(path, step, state, rows, decision, drawn_from, on_decision)
            if shift.is_over_at_next_decision():
                break
        reward = shift.paid() + float(belief.config.reward_dirty_left) * shift.truth.num_dirty_left
        shift.run.reward += float(belief.config.reward_dirty_left) * shift.truth.num_dirty_left
        path.complete_stage(reward, elapsed_s=cell.cell.time_s - begin_s)
        path.finish(elapsed_s=cell.cell.time_s - begin_s)
    except StoppedError as stopped:
        shift.run.cause = str(stopped)
        path.cut(shift.run.cause, elapsed_s=cell.cell.time_s - begin_s)
    return shift.ended(cell.cell.time_s - begin_s)


@jax.jit
def _decide(policy: TeamPolicy, state: TeamState, key: Array):
    return policy.decide(state, key)


class _Shift:
    """The arms at one table: who decides, and what came of what they did."""

    def __init__(self, cell: Workcell, truth: Truth, belief: Belief) -> None:
        robots = [station.robot for station in cell.stations]
        horizon = belief.config.horizon * len(robots)
        self.cell, self.truth, self.belief = cell, truth, belief
        self.crew, self.touches = Crew(cell.cell, robots), Touches(cell.cell, robots)
        self.table = TeamTable(cell, belief)
        # A state has room for the attempts of all arms.
        self.table.belief = belief._replace(config=replace(belief.config, horizon=horizon))
        self.run = TeamRun(busy_s=[0.0 for _ in robots])
        self._earned, self._num_left = 0.0, horizon
        cell.cell.watches.append(self.touches)

    @property
    def decider(self) -> int:
        return next(arm for arm, one in enumerate(self.table.doing) if one.is_free)

    def looked(self, step: int) -> tuple[TeamState, list[dict[str, Any]]]:
        self.cell.look()
        if not self.cell.memory.objects:
            raise StoppedError(NOTHING_SEEN)
        rows = rows_of(self.cell.memory, self.table.belief)
        self.table.add_to(rows)
        if step == 0:
            chances = expit(np.array([row["log_odds"] for row in rows], dtype=float))
            is_dirty = self.truth.is_dirty
            self.run.luck = luck_of_table(int(is_dirty.sum()), len(is_dirty), chances, self.belief.config)
        return self.table.state(self.decider, self._num_left), rows

    def paid(self) -> float:
        """What was earned since it was asked last."""
        earned, self._earned = self._earned, 0.0
        self.run.reward += earned
        return earned

    def begin(
        self,
        path: PathRecorder,
        step: int,
        state: TeamState,
        rows: list[dict[str, Any]],
        decision: Any,
        key: Array,
        on_decision: Callable[[Moment], None],
    ) -> None:
        """Write down what was seen and is done, and let the arm that decides begin it."""
        actions, action, arm = ActionSpace(state.table.num_objects), int(decision.action), self.decider
        verb, target = int(actions.verb(action)), int(actions.target(action))
        chance = None if jnp.isnan(decision.probability) else float(decision.probability)
        acted_on = target if verb in TARGETED else None
        path.begin_stage(
            covariates=self.table.columns(arm),
            objects=rows,
            action=TEAM_VERBS[verb],
            object=acted_on,
            probability=chance,
        )
        one = self.table.doing[arm]
        one.verb, one.target, one.begun_s = verb, target if verb in TARGETED else 0, self.cell.cell.time_s
        one.decisions_to_go, self._num_left = one.decisions_to_go - 1, self._num_left - 1
        if acted_on is not None:
            one.chance = float(expit(rows[target]["log_odds"]))
        self.run.verbs[TEAM_VERBS[verb]] = self.run.verbs.get(TEAM_VERBS[verb], 0) + 1
        name = f"{self.table.name(arm)}: {one.words}"
        on_decision(Moment(step + 1, state.table, action, self.table.in_words(), key, arm, name))
        if verb != WAIT:
            self.crew.begin(arm, self._activity(verb, target, arm))

    def _activity(self, verb: int, target: int, arm: int) -> Activity[Attempt | None]:
        if verb == Verb.FINISH:
            yield Rest(float(self.belief.config.transport_s))
            return None
        work = self.cell.washing if verb == Verb.WASH else self.cell.lifting
        attempt = yield from work(target, arm)
        # A look and a decision take their time; the other arms go on meanwhile.
        yield Rest(PAUSE_S)
        return attempt

    def is_over_at_next_decision(self) -> bool:
        """Let time pass until an arm decides; whether the table is over before."""
        # A stage has a length, even where another arm is free at once.
        self._work(1)
        while not self.truth.is_cleared(self.cell):
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

    def _end(self, done: Ended) -> None:
        one, attempt, config = self.table.doing[done.arm], done.result, self.belief.config
        seconds = self.cell.cell.time_s - one.begun_s
        if one.verb == Verb.FINISH:
            one.is_parked = True
        else:
            self.run.busy_s[done.arm] += seconds
            if not attempt.is_held:
                name = attempt.reason.split(":")[0].split(";")[0]
                self.run.failures[name] = self.run.failures.get(name, 0) + 1
            if attempt.is_too_far:
                self.table.count_too_far(done.arm, one.target)
            washed = self.truth.newly_racked(self.cell, done.arm)
            self.run.luck += luck_of_washing(washed, one.chance, config)
            earned = [float(config.reward_wash_dirty if dirty else config.reward_wash_clean) for dirty in washed]
            self._earned += sum(earned)
            if one.verb == Verb.LIFT:
                self._earned += float(config.reward_lift_per_s) * seconds
            elif not washed:
                self._earned += float(config.reward_wash_failed)
        one.verb = None
        for other in self.table.doing:
            if other.verb == WAIT:
                other.verb = None

    def ended(self, seconds: float) -> TeamRun:
        """What came of it, by the truth."""
        tally = self.crew.tally
        return replace(
            self.run,
            seconds=seconds,
            num_collisions=self.touches.num_collisions,
            num_waits=tally.num_waits,
            num_deadlocks=tally.num_deadlocks,
            num_gave_way=tally.num_gave_way,
            waited_s=tally.waited_s,
            **self.truth.counts(self.cell),
        )
