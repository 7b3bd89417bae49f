"""A look one step ahead for the robot that decides, with WAIT among its actions and the seconds paid.

As in `one_step`, what lies beyond the step is valued by V_0: each object is left or tried once, whichever is worth
more, by the fastest robot that reaches it and has a decision left; a try costs the price of its seconds, too. Where
robots have laws of grasping of their own, it is tried by the one of them to which that is worth the most. What another
robot is washing counts for nobody, as it is tried already. FINISH leaves to the others what they reach. WAIT gains the
labels of the next look for the seconds in which this robot is idle.

While n robots go on, a second of one is taken to add 1/n of it to the table's clock. With one robot and no price it is
`one_step.one_step_q`, but for what is common to all actions.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.arrays import Array, at, expit, library_of, record, softmax
from halfseen.planners.belief import (
    Belief,
    belief_of,
    expected_attempt_s,
    failure_log_probability,
    grip_offsets,
    known_grasping,
)
from halfseen.planners.heuristics import wash_worth
from halfseen.planners.one_step import (
    Label,
    Tries,
    label_in_each,
    label_of_tries,
    left_or_tried,
    occlusions_of_each,
    once_more,
    one_step_q,
    probabilities_of_tries,
    summed_tries,
    tries_after_label,
)
from halfseen.world.actions import ActionSpace, Verb, of_robot, possible_actions
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import GraspingByRobot
from halfseen.world.others import Others, is_decider, others_of
from halfseen.world.policy import Decision, surely
from halfseen.world.random import Key
from halfseen.world.state import Robots, TableState, Workspace

LEAST_LEFT = 0.3
"""What is at least expected to be left of an attempt that goes on, as a share of its expected time."""

_ZERO, _ONE, _NEVER = np.float32(0.0), np.float32(1.0), np.float32(-np.inf)


@record
class MyopicPolicy:
    """The best action by a look one step ahead.

    Parameters
    ----------
    config
        The world that it believes in, with the price of time.
    """

    config: WorldConfig

    @property
    def num_robots(self) -> int | None:
        """K; any where one works alone."""
        return self.config.num_robots if self.config.num_robots > 1 else None

    def q_values(self, state: TableState) -> Float[Array, "*B A"]:
        """Worth of each action, WAIT last, above leaving all as it is; −∞ where it is impossible."""
        if state.robots is None:
            q = one_step_q(self.config, belief_of(self.config, state))
            return q - q[..., :1]
        xp, others, table = library_of(state.is_on_table), others_of(state), _table_of(self.config, state)
        everyone = others.goes_on | is_decider(state)
        with_me, without_me = (_crew(self.config, state, table, who) for who in (everyone, others.goes_on))
        wash, lift = _attempts(self.config, table, with_me, state.decider)
        idle_s = _wait_s(self.config, state.robots, others, table)
        wait = _value_now(table, with_me) + with_me.reward_per_s * idle_s
        # Whoever is last to leave ends the path, and nothing is looked at any more.
        finish = _value_now(table, without_me) * xp.any(others.goes_on, axis=-1)
        values = ActionSpace(state.num_objects).join(finish, {Verb.WASH: wash, Verb.LIFT: lift})
        values = xp.concatenate([values, wait[..., None]], axis=-1)
        return xp.where(possible_actions(state), values, _NEVER)

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose; nothing is drawn."""
        q = self.q_values(state)
        return surely(library_of(q).argmax(q, axis=-1))


class _Table(NamedTuple):
    """What is known of a table, under each law of grasping that there is: one where all robots have the same."""

    worlds: tuple[WorldConfig, ...]
    belief: Belief
    is_dirty: Float[Array, "*B N"]
    weights: Float[Array, "*B N G"]
    label: Label
    """Before each of the tries of `one_step.probabilities_of_tries`."""
    held: tuple[Float[Array, "*B N G"], ...]
    """P(a try succeeds) now at each node of the grip offset."""
    probability: tuple[Float[Array, "*B V N"], ...]
    """P(a try succeeds), each object hidden in the ways of `one_step.occlusions_of_each` but that in the hand."""
    occluded: Float[Array, "*B N"]
    attempt_s: tuple[Float[Array, "*B N"], ...]
    """Expected, of a robot of speed 1 [s]."""
    is_washed: Bool[Array, "*B N"]
    """What another robot is washing."""


class _Crew(NamedTuple):
    """Robots that go on, at a table."""

    reward_per_s: Float[Array, "*B"]
    """Price of a second of one of them [1/s]."""
    reach: tuple[Bool[Array, "*B N"], ...]
    """What is reached by one of them that has a decision left, under each law."""
    effort: tuple[Float[Array, "*B N"], ...]
    """Price of the seconds of a try by the fastest of these."""
    is_wanted: Bool[Array, "*B N"]
    """What is left for one of them to try."""
    num_decisions: Int[Array, "*B"]
    """That they have after this one."""


def _worlds(config: WorldConfig) -> tuple[WorldConfig, ...]:
    """The world as each robot finds it; one where all find it alike."""
    law = config.grasping
    if not isinstance(law, GraspingByRobot):
        return (config,)
    return tuple(config.as_robot(robot) for robot in range(len(law.laws)))


def _table_of(config: WorldConfig, state: TableState) -> _Table:
    robots, belief, worlds = _robots(state), belief_of(config, state), _worlds(config)
    xp, is_dirty, weights = library_of(belief.hides), expit(belief.log_odds), softmax(belief.grip.log_weights)
    ways = occlusions_of_each(belief)
    failed = tuple(_failed(world, ways, belief.grip.mean) for world in worlds)
    is_washing = others_of(state).is_at_object & (robots.verb == Verb.WASH)
    is_target = robots.target[..., None] == xp.arange(state.num_objects)
    return _Table(
        worlds=worlds,
        belief=belief,
        is_dirty=is_dirty,
        weights=weights,
        label=label_of_tries(is_dirty, *label_in_each(config, belief.seen, ways)),
        held=tuple(-xp.expm1(each[..., 0, :, :]) for each in failed),
        probability=tuple(_ONE - xp.sum(weights[..., None, :, :] * xp.exp(each), axis=-1) for each in failed),
        occluded=ways[..., 0, :],
        attempt_s=tuple(expected_attempt_s(world, ways[..., 0, :], belief.grip) for world in worlds),
        is_washed=xp.any(is_washing[..., None] & is_target, axis=-2),
    )


def _failed(config: WorldConfig, ways: Float[Array, "*B M N"], mean: Float[Array, "*B N"]) -> Float[Array, "*B V N G"]:
    """Log P(a try fails) at each node of the grip offset, in each of the ways but that in the hand."""
    offset = grip_offsets(config, mean)
    return known_grasping(config).log_failure(ways[..., :-1, :, None], offset[..., None, :, :])


def _robots(state: TableState) -> Robots:
    assert state.robots is not None
    return state.robots


def _crew(config: WorldConfig, state: TableState, table: _Table, goes_on: Bool[Array, "*B K"]) -> _Crew:
    xp, robots, workspace = library_of(goes_on), _robots(state), state.workspace
    assert isinstance(workspace, Workspace)
    to_go = robots.decisions_to_go - is_decider(state)
    reach = (goes_on & (to_go > 0))[..., None] & workspace.is_in_reach
    speed = xp.asarray(config.speed, dtype=np.float32)
    of_robot_speed = xp.where(reach, speed[:, None], _ZERO)
    if config.has_own_laws:
        fastest = tuple(of_robot_speed[..., k, :] for k in range(robots.num_robots))
    else:
        fastest = (xp.max(of_robot_speed, axis=-2),)
    num_going = xp.maximum(xp.sum(goes_on, axis=-1), 1).astype(np.float32)
    reward_per_s = config.reward_per_s / num_going
    price = -reward_per_s[..., None]
    return _Crew(
        reward_per_s=reward_per_s,
        reach=tuple(each > _ZERO for each in fastest),
        effort=tuple(
            price * attempt_s / xp.where(each > _ZERO, each, _ONE)
            for attempt_s, each in zip(table.attempt_s, fastest, strict=True)
        ),
        is_wanted=state.is_on_table & xp.any(reach, axis=-2) & ~table.is_washed,
        num_decisions=xp.sum(xp.where(goes_on, to_go, 0), axis=-1),
    )


def _tries(table: _Table, crew: _Crew, label: Label, probability: list[Float[Array, "*B #2 W N"]]) -> Tries:
    """One more try of each object, by whom it is worth the most."""
    each = [
        tries_after_label(
            table.worlds[0], table.is_dirty[..., None, None, :], label, of_law, effort[..., None, None, :]
        )
        for of_law, effort in zip(probability, crew.effort, strict=True)
    ]
    if len(each) == 1:
        return each[0]
    xp = library_of(each[0].gain)
    best, most = each[0], xp.where(crew.reach[0][..., None, None, :], each[0].gain, -_ONE)
    for reach, other in zip(crew.reach[1:], each[1:], strict=True):
        gain = xp.where(reach[..., None, None, :], other.gain, -_ONE)
        is_more = gain > most
        best = Tries(*(xp.where(is_more, new, old) for new, old in zip(other, best, strict=True)))
        most = xp.where(is_more, gain, most)
    return best


def _value(crew: _Crew, tries: Tries) -> Float[Array, "*S N"]:
    """Gains of as many tries as there are decisions (their mean stands for the best)."""
    return left_or_tried(_ZERO, tries, crew.num_decisions[..., None, None])


def _value_now(table: _Table, crew: _Crew) -> Float[Array, "*B"]:
    """Value of the table as it stands."""
    label = Label(*(each[..., :1, :] for each in table.label))
    now = _tries(table, crew, label, [each[..., None, :1, :] for each in table.probability])
    return _value(crew, now.among(crew.is_wanted[..., None, None, :]))[..., 0, 0]


def _attempts(
    config: WorldConfig, table: _Table, crew: _Crew, robot: Int[Array, "*B"]
) -> tuple[Float[Array, "*B N"], Float[Array, "*B N"]]:
    """Worth of WASH and of LIFT of each object by the robot that decides, one of the crew."""
    world = config.as_robot(robot)
    failed = failure_log_probability(world, table.occluded, table.belief.grip.mean)
    then = [once_more(table.weights, -library_of(failed).expm1(failed), each) for each in table.held]
    probability = then[0][0]
    ways = [
        probabilities_of_tries(by_way, if_held, if_missed)
        for by_way, (_, if_held, if_missed) in zip(table.probability, then, strict=True)
    ]
    gains = _value(crew, summed_tries(_tries(table, crew, table.label, ways), crew.is_wanted))
    own_s = _own_s(config, table, robot)
    after_miss = (1.0 - probability) * gains[..., 0, :] + crew.reward_per_s[..., None] * own_s
    worth = wash_worth(world, table.is_dirty, probability, counts_penalty=True)
    wash = worth + probability * gains[..., 1, :] + after_miss
    lift = world.reward_lift_per_s * own_s + probability * gains[..., 2, :] + after_miss
    return wash, lift


def _own_s(config: WorldConfig, table: _Table, robot: Int[Array, "*B"]) -> Float[Array, "*B N"]:
    """Expected time that a robot takes for each object [s]."""
    xp = library_of(robot)
    speed = xp.asarray(config.speed, dtype=np.float32)[robot][..., None]
    if not config.has_own_laws:
        return table.attempt_s[0] / speed
    return of_robot(xp.stack(table.attempt_s, axis=-2), robot) / speed


def _wait_s(config: WorldConfig, robots: Robots, others: Others, table: _Table) -> Float[Array, "*B"]:
    """Time until the first of the other robots is expected to be done; 0 where none is at work [s]."""
    xp, speed = library_of(robots.since_s), np.asarray(config.speed, dtype=np.float32)
    laws = range(robots.num_robots) if config.has_own_laws else [0] * robots.num_robots
    expected = [at(table.attempt_s[law], robots.target[..., k]) for k, law in enumerate(laws)]
    expected_s = xp.stack(expected, axis=-1) / speed
    left_s = xp.maximum(expected_s - robots.since_s, LEAST_LEFT * expected_s)
    is_leaving = robots.is_busy & (robots.verb == Verb.FINISH)
    left_s = xp.where(is_leaving, config.transport_s / speed, left_s)
    is_to_end = others.is_at_object | is_leaving
    first_s = xp.min(xp.where(is_to_end, left_s, np.float32(np.inf)), axis=-1)
    return xp.where(xp.any(is_to_end, axis=-1), first_s, _ZERO)
