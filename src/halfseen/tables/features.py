"""What a linear Q looks at on a table: a few numbers for each verb, whatever the number of objects.

Every feature is a sum over the objects on the table, or the largest of them, or concerns the target alone, so it
depends neither on N nor on the order of the objects, and none uses a parameter of the world.

The first eleven features describe the table and mean the same for every verb:

===========================  =========================================================================================
Σ p                          dirty objects expected on the table, p = P(DIRTY)
Σ 1                          objects on the table
Σ win, Σ sure                how much there is to win, win = (p − ½)₊, and to win almost surely, sure = (p − ¾)₊
Σ win·ease, Σ sure·ease      how much of it is within reach
Σ doubt, Σ doubt·ease        how much is not known, doubt = 4 p (1 − p), and how much of that is within reach
Σ ease                       how much is within reach
Σ soon                       how much of what there is to win after one more look is within reach
idle = exp(−8 · max soon)    1 where no object is worth another step, and soon 0 where one is
===========================  =========================================================================================

with ease = (1 − occlusion) · (1 + successes) / (1 + attempts) · likelier: the share in sight, times the rule of
succession for a grip, times what shows of the grip. Of that, likelier = 4 / (3 + e⁻ᵍ), with g the mean of the grip
offset, is the probability that odds of three to one become by g, over what it was. Or, given a grasp model, ease is
the probability that it gives to a grasp.

One more look at an object that shows the share v for the first time leaves win(v) = ½ (p − ½ + v/4)₊ + ½ (p − ½ − v/4)₊
to be won on average, were its label right with probability ½ + v/4, and soon = ease · win(v). While no surface counts
as seen, every look is news, and v = 1 − occlusion. Where some does, errors persist, and the last look was taken from
here: v = 0, and only an object that is held up shows what was not seen of it, v = unseen = 1 − seen.

What follows concerns the target; `laid bare` is what it would show if it were grasped: ease · Σ_j (occlusion of j that
target i alone causes) · (…), the doubt of j times unseen; and LIFT gains ease · (ease · win(unseen) − soon) by the
better look, and looks at the target's doubt times unseen. FINISH looks at Σ p alone.

What differs between targets decides between them. So the largest `soon` stands in a feature of the table, the same for
all: the largest of the *others* tells as much of the table, but is least for the best target, and turned Q against it.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from halfseen.world.action_space import ActionSpace, Verb
from halfseen.world.grasp_model import GraspModel
from halfseen.world.number import namespace
from halfseen.world.state import TableState, attempt_counts

FEATURES_VERSION = 1
"""Coefficients mean nothing beside other features: raise this number whenever a feature changes."""

NUM_FEATURES = 22
NUM_TABLE_FEATURES = 11

WASH_DIRTY, WASH_EASE = NUM_TABLE_FEATURES + 2, NUM_TABLE_FEATURES + 4
"""Where the features of WASH hold P(DIRTY) and the ease of the target."""

LEAST_IN_SIGHT = 1e-6
"""Share that one object leaves of another's silhouette at least: what is in sight without it follows by division."""

LIKELY_ODDS = 3.0
"""Odds that a grasp holds at which the mean of a grip offset counts: the rule of succession starts from certainty."""

ROUNDING = 1e-6
"""Differences of float32 numbers below this are 0."""


class Columns(NamedTuple):
    """What the features are made of, one number an object."""

    is_there: Bool[Array, " N"]
    table: list[Float[Array, " N"]]
    """To be summed over the objects on the table."""
    idle: Float[Array, ""]
    """What follows the sums."""
    of_verb: Mapping[Verb, list[Float[Array, " N"]]]
    """Of each object as a target of the verb."""


def table_columns(state: TableState, grasp: GraspModel | None = None) -> Columns:
    """Find what the features of one table are made of."""
    is_dirty = jax.nn.sigmoid(state.log_odds)
    win, sure = jax.nn.relu(is_dirty - 0.5), jax.nn.relu(is_dirty - 0.75)
    doubt = 4.0 * is_dirty * (1.0 - is_dirty)
    in_sight, laid_bare = _sight(state)
    unseen = 1.0 - state.seen
    ease = in_sight * succession(*attempt_counts(state), state.grip) if grasp is None else grasp.probability(state)
    soon = ease * _win_after_look(is_dirty, jnp.where(state.seen > 0.0, 0.0, in_sight))
    clearer = ease * (ease * _win_after_look(is_dirty, unseen) - soon)
    best = jnp.max(jnp.where(state.is_on_table, soon, 0.0), initial=0.0)
    laid_bare_doubt = ease * jnp.sum(laid_bare * (doubt * unseen), axis=1)
    in_doubt, left_to_see = ([part, ease, part * ease] for part in (doubt, doubt * unseen))
    at_stake = [win, win * ease, sure, sure * ease]
    return Columns(
        is_there=state.is_on_table,
        table=[is_dirty, jnp.ones_like(is_dirty), *at_stake, *in_doubt, soon],
        idle=jnp.exp(-8.0 * best),
        of_verb={
            Verb.WASH: [
                ease * jnp.sum(laid_bare * win, axis=1),
                laid_bare_doubt,
                is_dirty,
                is_dirty * ease,
                ease,
                *at_stake,
                soon,
                soon * ease,
            ],
            # Rounding is no variance: where nothing else varies, a regression would scale it up.
            Verb.LIFT: [laid_bare_doubt, *left_to_see, jnp.where(clearer > ROUNDING, clearer, 0.0)],
        },
    )


def table_features(state: TableState, grasp: GraspModel | None = None) -> Float[Array, "A F"]:
    """φ(S, a) of every action of one table, in the order of the actions, padded with zeros to F = 22."""
    columns = table_columns(state, grasp)
    sums = jnp.sum(jnp.where(columns.is_there[:, None], jnp.stack(columns.table, axis=-1), 0.0), axis=0)
    table = jnp.append(sums, columns.idle)
    shared = jnp.broadcast_to(table, (state.num_objects, len(table)))
    each = {
        verb: _padded(jnp.concatenate([shared, jnp.stack(values, axis=-1)], axis=1))
        for verb, values in columns.of_verb.items()
    }
    return ActionSpace(state.num_objects).join(_padded(table[None, :1])[0], each)


def table_q(
    coefficients: Float[Array, "K F"], state: TableState, grasp: GraspModel | None = None
) -> Float[Array, " A"]:
    """Q of every action of one table, with the offset first in `coefficients`: what `q_values` makes of the features.

    The features are never put together: each sum runs over objects and features at once, and a decision takes half
    the time.
    """
    columns = table_columns(state, grasp)
    offset, shared, own = jnp.split(coefficients, [1, 1 + NUM_TABLE_FEATURES], axis=1)
    # FINISH looks at the first alone.
    shared = shared.at[Verb.FINISH, 1:].set(0.0)
    per_object = sum(value[:, None] * shared[None, :, f] for f, value in enumerate(columns.table))
    sums = jnp.sum(jnp.where(columns.is_there[:, None], per_object, 0.0), axis=0)
    table = offset[:, 0] + sums + columns.idle * shared[:, -1]
    each = {
        verb: table[verb] + sum(value * own[verb, f] for f, value in enumerate(values))
        for verb, values in columns.of_verb.items()
    }
    return ActionSpace(state.num_objects).join(table[Verb.FINISH], each)


def _padded(features: Float[Array, "M f"]) -> Float[Array, "M F"]:
    return jnp.pad(features, ((0, 0), (0, NUM_FEATURES - features.shape[1])))


def _win_after_look(is_dirty: Float[Array, " N"], shown: Float[Array, " N"]) -> Float[Array, " N"]:
    step = shown / 4.0
    return (jax.nn.relu(is_dirty - 0.5 + step) + jax.nn.relu(is_dirty - 0.5 - step)) / 2.0


def succession(successes: Any, failures: Any, grip: Any) -> Any:
    """Rule of succession for a grip, times what shows of it: P(held) of objects that are wholly in sight."""
    likelier = (1.0 + LIKELY_ODDS) / (LIKELY_ODDS + namespace(grip).exp(-grip))
    return (1.0 + successes) / (1.0 + successes + failures) * likelier


def _sight(state: TableState) -> tuple[Float[Array, " N"], Float[Array, "N N"]]:
    """Share of each object in sight; and [i, j], how much more of j would be without i, 0 for what is not there."""
    left = jnp.where(state.is_on_table[None, :], jnp.maximum(1.0 - state.hides, LEAST_IN_SIGHT), 1.0)
    in_sight = jnp.prod(left, axis=1)
    more = jnp.where(state.is_on_table[:, None], in_sight[:, None] * (1.0 / left - 1.0), 0.0)
    return in_sight, more.T
