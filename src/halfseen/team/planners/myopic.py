"""The look-ahead of one step for the robot that decides, with WAIT among its actions and the seconds paid.

As `planners.one_step` has it, what lies beyond the step is valued by V_0: each object is left, or tried once, whichever
is worth more, by whoever reaches it; now a try costs the price of its seconds, too. What another robot is washing
counts for nobody, since it is tried already. FINISH leaves to the others what they reach. WAIT gains the
labels of the next look for nothing but the seconds in which this robot is idle: at no price of seconds it is never
worse than to begin at once with what another label may change one's mind about.

With one robot and no price it is `one_step.one_step_q`, but for what is common to all actions.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.planners.belief import Belief, belief_of, expected_attempt_s, grasp_probability, occlusion_without
from halfseen.planners.heuristics import wash_worth
from halfseen.planners.one_step import Tries, grasp_probabilities, tries_after_label
from halfseen.team.actions import possible_actions
from halfseen.team.others import Others, others_of, reached_by_decider
from halfseen.team.planners.effort import num_going_on
from halfseen.team.state import TeamState
from halfseen.world.action_space import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.number import Number
from halfseen.world.policy import Decision, surely

LEAST_LEFT = 0.3
"""What is at least expected to be left of an attempt that goes on, as a share of its expected time."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MyopicTeam:
    """argmax of the look-ahead of one step, for each robot that is free.

    Parameters
    ----------
    config
        The world that it believes in.
    reward_per_s
        Price of each second of the table's clock, as in `TeamConfig`; 0 or below [1/s].
    """

    config: WorldConfig
    reward_per_s: Number = 0.0

    def q_values(self, state: TeamState, key: Array | None = None) -> Float[Array, " A"]:
        """Worth of each action of one table, measured from leaving all as it is; −∞ where it is impossible."""
        return team_one_step_q(self.config, self.reward_per_s, state)

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose for one table; nothing is drawn."""
        return surely(jnp.argmax(self.q_values(state)).astype(jnp.int32))


class _Step(NamedTuple):
    """What the look-ahead knows of one table."""

    belief: Belief
    occluded: Float[Array, " N"]
    """Of each object now."""
    cleared: Float[Array, "N N"]
    """Of each object (last axis) once another is gone."""
    attempt_s: Float[Array, " N"]
    effort: Float[Array, " N"]
    is_wanted: Bool[Array, " N"]
    """What is left for somebody to try."""
    steps: Int[Array, ""]
    """Decisions that all robots together have after this one."""


def team_one_step_q(config: WorldConfig, reward_per_s: Number, state: TeamState) -> Float[Array, " A"]:
    """Worth of each action of one table, WAIT last, measured from leaving all as it is; −∞ where it is impossible."""
    others, step = others_of(state), _step_of(config, reward_per_s, state)
    before = _tries(config, step, step.occluded, grasp_probability(config, step.occluded, step.belief.grip))
    of_wash, of_lift = _attempts(config, step, before)
    idle = reward_per_s * _wait_s(config, state, others, step) / num_going_on(state)
    wait = _value(before.among(step.is_wanted), step.steps) + idle
    # Whoever is last to leave ends the path, and nothing is looked at any more.
    finish = _value(before.among(step.is_wanted & others.reached), step.steps) * jnp.any(others.goes_on)
    values = ActionSpace(state.table.num_objects).join(finish, {Verb.WASH: of_wash, Verb.LIFT: of_lift})
    return jnp.where(possible_actions(state), jnp.append(values, wait), -jnp.inf)


def _step_of(config: WorldConfig, reward_per_s: Number, state: TeamState) -> _Step:
    belief, num_objects = belief_of(config, state.table), state.table.num_objects
    others, robots = others_of(state), state.robots
    occluded = occlusion_without(belief, jnp.zeros(num_objects, dtype=bool))
    cleared = jax.vmap(lambda taken: occlusion_without(belief, taken))(jnp.eye(num_objects, dtype=bool))
    attempt_s = expected_attempt_s(config, occluded, belief.grip)
    is_washing = others.is_at_object & (robots.verb == Verb.WASH)
    is_washed = jnp.any(is_washing[:, None] & (robots.target[:, None] == jnp.arange(num_objects)), axis=0)
    steps = jnp.sum(jnp.where(robots.is_done, 0, robots.decisions_to_go)) - 1
    return _Step(
        belief=belief,
        occluded=occluded,
        cleared=cleared,
        attempt_s=attempt_s,
        effort=-reward_per_s * attempt_s / num_going_on(state),
        is_wanted=(reached_by_decider(state) | others.reached) & ~is_washed,
        steps=steps,
    )


def _attempts(config: WorldConfig, step: _Step, before: Tries) -> tuple[Float[Array, " N"], Float[Array, " N"]]:
    """Worth of WASH and of LIFT of each object."""
    belief, target = step.belief, jnp.eye(len(step.occluded), dtype=bool)
    probability, if_held, if_missed = grasp_probabilities(config, step.occluded, belief.grip)
    own, others = step.is_wanted, step.is_wanted & ~target
    missed = jax.tree.map(
        lambda total, old, new: total + jnp.where(own, new - old, 0.0),
        before.among(own),
        before,
        _tries(config, step, step.occluded, if_missed),
    )
    if_cleared = grasp_probability(config, step.cleared, belief.grip)
    washed = _tries(config, step, step.cleared, if_cleared).among(others)
    around = _tries(config, step, step.cleared, jnp.broadcast_to(probability, target.shape)).among(others)
    held = _tries(config, step, jnp.zeros_like(step.occluded), if_held, is_held=True)
    lifted = jax.tree.map(lambda total, new: total + jnp.where(own, new, 0.0), around, held)
    after_miss = (1.0 - probability) * _value(missed, step.steps) - step.effort
    worth = wash_worth(config, jax.nn.sigmoid(belief.log_odds), probability, counts_penalty=True)
    wash = worth + probability * _value(washed, step.steps) + after_miss
    lift = config.reward_lift_per_s * step.attempt_s + probability * _value(lifted, step.steps) + after_miss
    return wash, lift


def _tries(
    config: WorldConfig,
    step: _Step,
    occluded: Float[Array, "*S N"],
    probability: Float[Array, "*S N"],
    is_held: bool = False,
) -> Tries:
    is_dirty = jax.nn.sigmoid(step.belief.log_odds)
    return tries_after_label(config, is_dirty, step.belief.seen, occluded, probability, is_held, step.effort)


def _value(tries: Tries, steps: Int[Array, ""]) -> Float[Array, "*S"]:
    """Gains of as many tries as there are steps (their mean stands for the best)."""
    return jnp.minimum(1.0, steps / jnp.maximum(tries.number, 1.0)) * tries.gain


def _wait_s(config: WorldConfig, state: TeamState, others: Others, step: _Step) -> Float[Array, ""]:
    """Time until the first of the other robots is expected to be done; 0 where none is at work [s]."""
    robots = state.robots
    expected_s = step.attempt_s[robots.target]
    left_s = jnp.maximum(expected_s - robots.since_s, LEAST_LEFT * expected_s)
    is_leaving = robots.is_busy & (robots.verb == Verb.FINISH)
    left_s = jnp.where(is_leaving, config.transport_s, left_s)
    is_to_end = others.is_at_object | is_leaving
    return jnp.where(jnp.any(is_to_end), jnp.min(jnp.where(is_to_end, left_s, jnp.inf)), 0.0)
