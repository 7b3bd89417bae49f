"""A closed look one step ahead in the space of beliefs: the rule that searches of the table build upon.

What lies beyond the step is valued by a rule of thumb V_0: each object is left, or tried once, whichever is worth more,
as far as the steps allow. Q_1(b, a) = E[R + V_0(b')] is computed in closed form: the grasp succeeds or not, and each
label says one thing or the other, object by object (exact unless more tries are wanted than steps remain: then the
expected number of tries stands for their number).

With unlimited steps that exception falls away: V° is V_0 with more steps than any try could want, and
Q°(b, a) = E[R + V°(b')] is exact, for any steps to go but the last. It is no good rule near the end, but takes noise
out of rollouts (`rollout`).
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.planners.belief import (
    Belief,
    attempt_evidence,
    dirty_after_label,
    expected_attempt_s,
    grasp_probability,
    occlusion_without,
)
from halfseen.planners.heuristics import wash_worth
from halfseen.world.action_space import ActionSpace, Verb, possible_actions
from halfseen.world.config import WorldConfig

UNLIMITED = 1_000_000
"""Steps to go that never run out."""


def leaf_value(config: WorldConfig, belief: Belief) -> Float[Array, ""]:
    """V_0: every object is left where it stands, or tried once if that is worth more."""
    occluded = occlusion_without(belief, jnp.zeros_like(belief.is_on_table))
    probability = grasp_probability(config, occluded, belief.grip)
    is_dirty = jax.nn.sigmoid(belief.log_odds)
    gain = jax.nn.relu(wash_worth(config, is_dirty, probability, counts_penalty=True))
    return _left_or_tried(
        config, belief.is_on_table, is_dirty, gain, jnp.where(gain > 0.0, 1.0, 0.0), belief.steps_to_go
    )


def _left_or_tried(
    config: WorldConfig,
    is_on_table: Bool[Array, "*S N"],
    is_dirty: Float[Array, "*#S N"],
    gain: Float[Array, "*S N"],
    is_tried: Float[Array, "*S N"],
    steps_to_go: Int[Array, ""],
) -> Float[Array, "*S"]:
    """Value of leaving all, plus the gains of as many tries as there are steps (their mean stands for the best).

    `is_tried` is the probability that an object is worth a try.
    """
    num_tries = jnp.sum(jnp.where(is_on_table, is_tried, 0.0), axis=-1)
    share_tried = jnp.minimum(1.0, steps_to_go / jnp.maximum(num_tries, 1.0))
    left = config.reward_dirty_left * jnp.sum(jnp.where(is_on_table, is_dirty, 0.0), axis=-1)
    return left + share_tried * jnp.sum(jnp.where(is_on_table, gain, 0.0), axis=-1)


def one_step_q(config: WorldConfig, belief: Belief) -> Float[Array, " A"]:
    """Q_1 of every action of one table, in closed form; −∞ where an action is impossible."""
    num_objects = belief.is_on_table.shape[0]
    is_dirty = jax.nn.sigmoid(belief.log_odds)
    target = jnp.eye(num_objects, dtype=bool)
    nothing = jnp.zeros(num_objects, dtype=bool)
    occluded = occlusion_without(belief, nothing)
    occluded_without = jax.vmap(lambda taken: occlusion_without(belief, taken))(target)
    probability = grasp_probability(config, occluded, belief.grip)
    grip_held, grip_missed = (
        belief.grip + attempt_evidence(config, occluded, jnp.full(num_objects, result)) for result in (True, False)
    )
    probability_held = grasp_probability(config, occluded, grip_held)
    probability_missed = grasp_probability(config, occluded, grip_missed)
    probability_cleared = grasp_probability(config, occluded_without, belief.grip)

    def value(is_on_table: Array, seen_at: Array, probabilities: Array) -> Float[Array, " N"]:
        """E V_0 after the labels, one row for each target."""
        gain, is_tried = _expected_gain(config, is_dirty, seen_at, probabilities)
        return _left_or_tried(config, is_on_table, is_dirty, gain, is_tried, belief.steps_to_go - 1)

    there = jnp.broadcast_to(belief.is_on_table, target.shape)
    washed = value(there & ~target, occluded_without, probability_cleared)
    lifted = value(there, jnp.where(target, 0.0, occluded_without), jnp.where(target, probability_held, probability))
    missed = value(there, jnp.broadcast_to(occluded, target.shape), jnp.where(target, probability_missed, probability))
    worth = wash_worth(config, is_dirty, probability, counts_penalty=False)
    wash = worth + probability * washed + (1.0 - probability) * missed
    look = config.reward_lift_per_s * expected_attempt_s(config, occluded, belief.grip)
    lift = look + probability * lifted + (1.0 - probability) * missed
    finish = config.reward_dirty_left * jnp.sum(jnp.where(belief.is_on_table, is_dirty, 0.0))
    values = ActionSpace(num_objects).join(finish, {Verb.WASH: wash, Verb.LIFT: lift})
    return jnp.where(possible_actions(belief), values, -jnp.inf)


def rule_and_control(config: WorldConfig, belief: Belief) -> tuple[Float[Array, " A"], Float[Array, " A"]]:
    """Q_1 and Q°; with one step to go, both are Q_1, which is exact there."""
    steps = jnp.stack([belief.steps_to_go, jnp.where(belief.steps_to_go == 1, 1, UNLIMITED)])
    both = jax.vmap(lambda num_steps: one_step_q(config, _with_steps(belief, num_steps)))(steps)
    return both[0], both[1]


def control_value(config: WorldConfig, belief: Belief) -> Float[Array, ""]:
    """V°: every object is left where it stands, or tried once if that is worth more, however few steps remain."""
    return leaf_value(config, _with_steps(belief, jnp.asarray(UNLIMITED, dtype=jnp.int32)))


def _with_steps(belief: Belief, num_steps: Int[Array, ""]) -> Belief:
    return replace(belief, steps_to_go=num_steps)


def _expected_gain(
    config: WorldConfig, is_dirty: Float[Array, " N"], seen_at: Float[Array, "*S N"], probability: Float[Array, "*S N"]
) -> tuple[Float[Array, "*S N"], Float[Array, "*S N"]]:
    """E (worth of one more try)₊ over the next label, and P(it is positive)."""
    says_dirty, if_dirty, if_clean = dirty_after_label(config, jnp.broadcast_to(is_dirty, seen_at.shape), seen_at)
    worth_dirty = wash_worth(config, if_dirty, probability, counts_penalty=True)
    worth_clean = wash_worth(config, if_clean, probability, counts_penalty=True)
    gain = says_dirty * jax.nn.relu(worth_dirty) + (1.0 - says_dirty) * jax.nn.relu(worth_clean)
    is_tried = jnp.where(worth_dirty > 0.0, says_dirty, 0.0) + jnp.where(worth_clean > 0.0, 1.0 - says_dirty, 0.0)
    return gain, is_tried
