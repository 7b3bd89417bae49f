"""What a linear Q looks at on a table: a few numbers for each verb, whatever the number of objects.

Every feature is a sum over the objects on the table or concerns the target alone, so it depends neither on N nor on
the order of the objects, and none uses a parameter of the world.

The first nine features describe the table and mean the same for every verb:

===========================  =========================================================================================
Σ p                          dirty objects expected on the table, p = P(DIRTY)
Σ 1                          objects on the table
Σ win, Σ sure                how much there is to win, win = (p − ½)₊, and to win almost surely, sure = (p − ¾)₊
Σ win·ease, Σ sure·ease      how much of it is within reach
Σ doubt, Σ doubt·ease        how much is not known, doubt = 4 p (1 − p), and how much of that is within reach
Σ ease                       how much is within reach
===========================  =========================================================================================

with ease = (1 − occlusion) · (1 + successes) / (1 + attempts), the share in sight times Laplace's guess of a grip; or,
given a grasp model, the chance of a grasp that it tells. What follows concerns the target; `unhides` is what it would
lay bare: Σ_j (occlusion of j that target i alone causes) · (…). FINISH looks at Σ p alone.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from halfseen.world.actions import Verb
from halfseen.world.grasp_model import GraspModel
from halfseen.world.state import TableState, attempt_counts, occlusion, occlusion_without

NUM_FEATURES = 17


def table_features(state: TableState, grasp: GraspModel | None = None) -> Float[Array, "A F"]:
    """φ(S, a) of every action of one table, in the order of the actions, padded with zeros to F = 17."""
    is_dirty = jax.nn.sigmoid(state.log_odds)
    win, sure = jax.nn.relu(is_dirty - 0.5), jax.nn.relu(is_dirty - 0.75)
    doubt = 4.0 * is_dirty * (1.0 - is_dirty)
    ease = _ease(state) if grasp is None else grasp.chance(state)
    unhides = _unhides(state)
    there = state.is_on_table.astype(jnp.float32)
    in_doubt = [doubt, ease, doubt * ease]
    at_stake = [win, win * ease, sure, sure * ease]
    table = [jnp.sum(there * value) for value in (is_dirty, jnp.ones_like(there), *at_stake, *in_doubt)]
    wash = [unhides @ win, is_dirty, is_dirty * ease, ease, *at_stake]
    lift = [unhides @ doubt, *in_doubt]
    return jnp.concatenate(
        [_stack([table[0][None]]), _stack(_each(table, there) + wash), _stack(_each(table, there) + lift)]
    )


def block_of_action(num_objects: int) -> Int[Array, " A"]:
    """Block of coefficients of each action: its verb."""
    verbs = jnp.array([Verb.FINISH, Verb.WASH, Verb.LIFT])
    return jnp.repeat(verbs, jnp.array([1, num_objects, num_objects]), total_repeat_length=1 + 2 * num_objects)


def _each(values: list[Float[Array, ""]], like: Float[Array, " N"]) -> list[Float[Array, " N"]]:
    return [jnp.broadcast_to(value, like.shape) for value in values]


def _stack(columns: list[Float[Array, " N"]]) -> Float[Array, "N F"]:
    stacked = jnp.stack(columns, axis=-1)
    return jnp.pad(stacked, ((0, 0), (0, NUM_FEATURES - len(columns))))


def _ease(state: TableState) -> Float[Array, " N"]:
    successes, failures = attempt_counts(state)
    return (1.0 - occlusion(state)) * (1.0 + successes) / (1.0 + successes + failures)


def _unhides(state: TableState) -> Float[Array, "N N"]:
    """[i, j]: by how much the occlusion of j falls when i is taken away; 0 for what is not on the table."""
    taken = jnp.eye(state.num_objects, dtype=bool)
    without = jax.vmap(occlusion_without, in_axes=(None, 0))(state, taken)
    return jnp.where(state.is_on_table[None, :] & ~taken, occlusion(state)[None, :] - without, 0.0)
