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
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.planners.belief import (
    Belief,
    Grip,
    dirty_after_label,
    expected_attempt_s,
    failure_log_probability,
    grasp_probability,
    occlusion_without,
)
from halfseen.planners.heuristics import wash_worth
from halfseen.world.action_space import ActionSpace, Verb, possible_actions
from halfseen.world.config import WorldConfig

UNLIMITED = 1_000_000
"""Steps to go that never run out."""


class Tries(NamedTuple):
    """One more try of each object, where it is worth it."""

    gain: Float[Array, "*S N"]
    number: Float[Array, "*S N"]
    """Probability that it is worth it."""

    def among(self, is_there: Bool[Array, "*S N"]) -> "Tries":
        """Sum over objects."""
        return Tries(*(jnp.sum(jnp.where(is_there, each, 0.0), axis=-1) for each in self))


def leaf_value(config: WorldConfig, belief: Belief) -> Float[Array, ""]:
    """V_0: every object is left where it stands, or tried once if that is worth more."""
    occluded = occlusion_without(belief, jnp.zeros_like(belief.is_on_table))
    probability = grasp_probability(config, occluded, belief.grip)
    is_dirty = jax.nn.sigmoid(belief.log_odds)
    gain = jax.nn.relu(wash_worth(config, is_dirty, probability, counts_penalty=True))
    tries = Tries(gain, jnp.where(gain > 0.0, 1.0, 0.0)).among(belief.is_on_table)
    return left_or_tried(_all_left(config, belief), tries, belief.steps_to_go)


def _all_left(config: WorldConfig, belief: Belief) -> Float[Array, ""]:
    """Expected price of the dirty objects on the table."""
    return config.reward_dirty_left * jnp.sum(jnp.where(belief.is_on_table, jax.nn.sigmoid(belief.log_odds), 0.0))


def left_or_tried(left: Float[Array, "*#S"], tries: Tries, steps_to_go: Int[Array, ""]) -> Float[Array, "*S"]:
    """Value of leaving all, plus the gains of as many tries as there are steps (their mean stands for the best)."""
    return left + jnp.minimum(1.0, steps_to_go / jnp.maximum(tries.number, 1.0)) * tries.gain


def one_step_q(config: WorldConfig, belief: Belief) -> Float[Array, " A"]:
    """Q_1 of every action of one table, in closed form; −∞ where an action is impossible."""
    num_objects = belief.is_on_table.shape[0]
    is_dirty = jax.nn.sigmoid(belief.log_odds)
    target = jnp.eye(num_objects, dtype=bool)
    others = belief.is_on_table & ~target
    occluded = occlusion_without(belief, jnp.zeros(num_objects, dtype=bool))
    occluded_without = jax.vmap(lambda taken: occlusion_without(belief, taken))(target)
    probability, if_held, if_missed = grasp_probabilities(config, occluded, belief.grip)
    if_cleared = grasp_probability(config, occluded_without, belief.grip)

    tries = partial(tries_after_label, config, is_dirty, belief.seen)
    # After a miss all is as before but the grip of the target.
    before = tries(occluded, probability)
    missed = jax.tree.map(
        lambda sum_before, own, new: sum_before - own + new,
        before.among(belief.is_on_table),
        before,
        tries(occluded, if_missed),
    )
    washed = tries(occluded_without, if_cleared).among(others)
    around = tries(occluded_without, jnp.broadcast_to(probability, target.shape)).among(others)
    lifted = jax.tree.map(jnp.add, around, tries(jnp.zeros_like(occluded), if_held, is_held=True))

    left, steps = _all_left(config, belief), belief.steps_to_go - 1
    after_miss = (1.0 - probability) * left_or_tried(left, missed, steps)
    worth = wash_worth(config, is_dirty, probability, counts_penalty=False)
    washed_left = left - config.reward_dirty_left * is_dirty
    wash = worth + probability * left_or_tried(washed_left, washed, steps) + after_miss
    look = config.reward_lift_per_s * expected_attempt_s(config, occluded, belief.grip)
    lift = look + probability * left_or_tried(left, lifted, steps) + after_miss
    values = ActionSpace(num_objects).join(left, {Verb.WASH: wash, Verb.LIFT: lift})
    return jnp.where(possible_actions(belief), values, -jnp.inf)


def grasp_probabilities(
    config: WorldConfig, occluded: Float[Array, " N"], grip: Grip, next_config: WorldConfig | None = None
) -> tuple[Float[Array, " N"], Float[Array, " N"], Float[Array, " N"]]:
    """P(an attempt succeeds), and P(the next one does) after a success and after a failure at the same occlusion.

    The next one is made in `next_config`, where another robot makes it.
    """
    at_node, weight = _at_nodes(config, occluded, grip), jax.nn.softmax(grip.log_weights, axis=-1)
    then = at_node if next_config is None else _at_nodes(next_config, occluded, grip)

    def again(after: Float[Array, "N G"]) -> Float[Array, " N"]:
        mass = jnp.maximum(jnp.sum(after, axis=-1), jnp.finfo(after.dtype).tiny)
        return jnp.sum(after * then, axis=-1) / mass

    probability = grasp_probability(config, occluded, grip)
    return probability, again(weight * at_node), again(weight * (1.0 - at_node))


def _at_nodes(config: WorldConfig, occluded: Float[Array, " N"], grip: Grip) -> Float[Array, "N G"]:
    """P(an attempt succeeds) at each node of the grip offset."""
    return -jnp.expm1(failure_log_probability(config, occluded, grip.mean))


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


def tries_after_label(
    config: WorldConfig,
    is_dirty: Float[Array, " N"],
    seen: Float[Array, " N"],
    occluded: Float[Array, "*S N"],
    probability: Float[Array, "*S N"],
    is_held: bool = False,
    effort: Float[Array, " N"] | float = 0.0,
) -> Tries:
    """E (worth of one more try, less the effort of it)₊ over the next label, and P(it is positive)."""
    says_dirty, if_dirty, if_clean = dirty_after_label(
        config, jnp.broadcast_to(is_dirty, occluded.shape), seen, occluded, is_held
    )
    worth_dirty = wash_worth(config, if_dirty, probability, counts_penalty=True) - effort
    worth_clean = wash_worth(config, if_clean, probability, counts_penalty=True) - effort
    gain = says_dirty * jax.nn.relu(worth_dirty) + (1.0 - says_dirty) * jax.nn.relu(worth_clean)
    number = jnp.where(worth_dirty > 0.0, says_dirty, 0.0) + jnp.where(worth_clean > 0.0, 1.0 - says_dirty, 0.0)
    return Tries(gain, number)
