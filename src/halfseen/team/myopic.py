"""A look one step ahead for the robot that decides, with WAIT among its actions and the seconds paid.

As in `planners.one_step`, what lies beyond the step is valued by V_0: each object is left or tried once, whichever is
worth more, by the fastest robot that reaches it and has a decision left; a try costs the price of its seconds, too.
Where robots have laws of grasping of their own, it is tried by the one of them to which that is worth the most.
What another robot is washing counts for nobody, as it is tried already. FINISH leaves to the others what they reach.
WAIT gains the labels of the next look for the seconds in which this robot is idle.

While n robots go on, a second of one is taken to add 1/n of it to the table's clock. With one robot and no price it is
`one_step.one_step_q`, but for what is common to all actions.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.planners.belief import Belief, belief_of, expected_attempt_s, grasp_probability, occlusion_without
from halfseen.planners.heuristics import wash_worth
from halfseen.planners.one_step import Tries, grasp_probabilities, left_or_tried, tries_after_label
from halfseen.team.actions import possible_actions
from halfseen.team.config import TeamConfig
from halfseen.team.others import Others, others_of
from halfseen.team.state import TeamState
from halfseen.world.action_space import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Decision, surely

LEAST_LEFT = 0.3
"""What is at least expected to be left of an attempt that goes on, as a share of its expected time."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MyopicTeam:
    """The best action by a look one step ahead.

    Parameters
    ----------
    config
        The team that it believes in, with the price of time.
    """

    config: TeamConfig

    @property
    def num_robots(self) -> int:
        """K."""
        return self.config.num_robots

    def q_values(self, state: TeamState) -> Float[Array, " A"]:
        """Worth of each action of one table, WAIT last, above leaving all as it is; −∞ where it is impossible."""
        others = others_of(state)
        is_me = jnp.arange(self.num_robots) == state.decider
        table = _table_of(self.config, state)
        with_me, without_me = (
            _crew(self.config, state, table, who) for who in (others.goes_on | is_me, others.goes_on)
        )
        wash, lift = _attempts(self.config, with_me, state.decider)
        idle_s = _wait_s(self.config, state, others, table)
        wait = with_me.value_now() + with_me.reward_per_s * idle_s
        # Whoever is last to leave ends the path, and nothing is looked at any more.
        finish = without_me.value_now() * jnp.any(others.goes_on)
        values = ActionSpace(state.table.num_objects).join(finish, {Verb.WASH: wash, Verb.LIFT: lift})
        return jnp.where(possible_actions(state), jnp.append(values, wait), -jnp.inf)

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose for one table; nothing is drawn."""
        return surely(jnp.argmax(self.q_values(state)).astype(jnp.int32))


class _Table(NamedTuple):
    """What is known of one table, by `TeamConfig.worlds`: H is 1 where all robots have one law, and else K."""

    worlds: tuple[WorldConfig, ...]
    belief: Belief
    occluded: Float[Array, " N"]
    attempt_s: Float[Array, "H N"]
    """Expected under each law that there is, of a robot of speed 1 [s]."""
    is_washed: Bool[Array, " N"]
    """What another robot is washing."""


class _Crew(NamedTuple):
    """Robots that go on, at one table."""

    table: _Table
    reward_per_s: Float[Array, ""]
    """Price of a second of one of them [1/s]."""
    reach: Bool[Array, "H N"]
    """What is reached by one of them that has a decision left, under each law."""
    effort: Float[Array, "H N"]
    """Price of the seconds of a try by the fastest of these."""
    is_wanted: Bool[Array, " N"]
    """What is left for one of them to try."""
    num_decisions: Int[Array, ""]
    """That they have after this one."""

    def tries(
        self, occluded: Float[Array, "*S N"], probability: Float[Array, "H *S N"], is_held: bool = False
    ) -> Tries:
        """One more try of each object, by whom it is worth the most."""
        world, belief = self.table.worlds[0], self.table.belief
        is_dirty = jax.nn.sigmoid(belief.log_odds)

        def tried(probability: Float[Array, "*S N"], effort: Float[Array, " N"]) -> Tries:
            return tries_after_label(
                world, is_dirty, belief.seen, occluded, probability, is_held=is_held, effort=effort
            )

        each = [tried(*of_law) for of_law in zip(probability, self.effort, strict=True)]
        best = each[0]
        if len(each) > 1:
            gain, number = (jnp.stack(values) for values in zip(*each, strict=True))
            reach = self.reach.reshape(len(each), *(1,) * (gain.ndim - 2), gain.shape[-1])
            who = jnp.argmax(jnp.where(reach, gain, -1.0), axis=0, keepdims=True)
            best = Tries(*(jnp.take_along_axis(values, who, axis=0)[0] for values in (gain, number)))
        return best

    def probability(self, occluded: Float[Array, "*S N"]) -> Float[Array, "H *S N"]:
        """P(a try succeeds) under each law."""
        return jnp.stack([grasp_probability(world, occluded, self.table.belief.grip) for world in self.table.worlds])

    def each_now(self) -> Tries:
        """One more try of each object as it stands."""
        return self.tries(self.table.occluded, self.probability(self.table.occluded))

    def value(self, tries: Tries) -> Float[Array, "*S"]:
        """Gains of as many tries as there are decisions (their mean stands for the best)."""
        return left_or_tried(jnp.zeros(()), tries, self.num_decisions)

    def value_now(self) -> Float[Array, ""]:
        """Value of the table as it stands."""
        return self.value(self.each_now().among(self.is_wanted))


def _table_of(config: TeamConfig, state: TeamState) -> _Table:
    belief, robots = belief_of(config.world, state.table), state.robots
    occluded = occlusion_without(belief, jnp.zeros_like(belief.is_on_table))
    is_washing = others_of(state).is_at_object & (robots.verb == Verb.WASH)
    is_target = robots.target[:, None] == jnp.arange(state.table.num_objects)
    return _Table(
        worlds=config.worlds,
        belief=belief,
        occluded=occluded,
        attempt_s=jnp.stack([expected_attempt_s(world, occluded, belief.grip) for world in config.worlds]),
        is_washed=jnp.any(is_washing[:, None] & is_target, axis=0),
    )


def _crew(config: TeamConfig, state: TeamState, table: _Table, goes_on: Bool[Array, " K"]) -> _Crew:
    robots = state.robots
    to_go = robots.decisions_to_go - (jnp.arange(robots.num_robots) == state.decider)
    reach = (goes_on & (to_go > 0))[:, None] & state.workspace.is_in_reach
    fastest = jnp.where(reach, jnp.asarray(config.speed)[:, None], 0.0)
    if not config.has_own_laws:
        fastest = jnp.max(fastest, axis=0, keepdims=True)
    is_reached = fastest > 0.0
    reward_per_s = config.reward_per_s / jnp.maximum(jnp.sum(goes_on), 1)
    return _Crew(
        table=table,
        reward_per_s=reward_per_s,
        reach=is_reached,
        effort=-reward_per_s * table.attempt_s / jnp.where(is_reached, fastest, 1.0),
        is_wanted=state.table.is_on_table & jnp.any(is_reached, axis=0) & ~table.is_washed,
        num_decisions=jnp.sum(jnp.where(goes_on, to_go, 0)),
    )


def _attempts(config: TeamConfig, crew: _Crew, robot: Int[Array, ""]) -> tuple[Float[Array, " N"], Float[Array, " N"]]:
    """Worth of WASH and of LIFT of each object by the robot that decides, one of the crew."""
    worlds, belief, occluded, _, _ = crew.table
    world = config.world.as_robot(robot)
    target = jnp.eye(len(occluded), dtype=bool)
    cleared = jax.vmap(lambda taken: occlusion_without(belief, taken))(target)
    then = [grasp_probabilities(world, occluded, belief.grip, by) for by in worlds]
    probability, if_held, if_missed = then[0][0], *(jnp.stack([each[k] for each in then]) for k in (1, 2))
    own, others = crew.is_wanted, crew.is_wanted & ~target
    # After a miss all is as before but the grip of the target.
    before = crew.each_now()
    missed = jax.tree.map(
        lambda total, old, new: total + jnp.where(own, new - old, 0.0),
        before.among(own),
        before,
        crew.tries(occluded, if_missed),
    )
    washed = crew.tries(cleared, crew.probability(cleared)).among(others)
    now = crew.probability(occluded)[:, None]
    around = crew.tries(cleared, jnp.broadcast_to(now, (len(worlds), *target.shape))).among(others)
    held = crew.tries(jnp.zeros_like(occluded), if_held, is_held=True)
    lifted = jax.tree.map(lambda total, new: total + jnp.where(own, new, 0.0), around, held)
    own_s = _own_s(config, crew.table, robot)
    after_miss = (1.0 - probability) * crew.value(missed) + crew.reward_per_s * own_s
    worth = wash_worth(world, jax.nn.sigmoid(belief.log_odds), probability, counts_penalty=True)
    wash = worth + probability * crew.value(washed) + after_miss
    lift = world.reward_lift_per_s * own_s + probability * crew.value(lifted) + after_miss
    return wash, lift


def _own_s(config: TeamConfig, table: _Table, robot: Int[Array, "..."]) -> Float[Array, "... N"]:
    """Expected time that a robot takes for each object [s]."""
    law = robot if config.has_own_laws else jnp.zeros_like(robot)
    return table.attempt_s[law] / jnp.asarray(config.speed)[robot][..., None]


def _wait_s(config: TeamConfig, state: TeamState, others: Others, table: _Table) -> Float[Array, ""]:
    """Time until the first of the other robots is expected to be done; 0 where none is at work [s]."""
    robots, speed, each = state.robots, jnp.asarray(config.speed), jnp.arange(config.num_robots)
    expected_s = _own_s(config, table, each)[each, robots.target]
    left_s = jnp.maximum(expected_s - robots.since_s, LEAST_LEFT * expected_s)
    is_leaving = robots.is_busy & (robots.verb == Verb.FINISH)
    left_s = jnp.where(is_leaving, config.world.transport_s / speed, left_s)
    is_to_end = others.is_at_object | is_leaving
    return jnp.where(jnp.any(is_to_end), jnp.min(jnp.where(is_to_end, left_s, jnp.inf)), 0.0)
