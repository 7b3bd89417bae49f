"""WASH one, LIFT one, or FINISH: one integer for each action of a table with N objects.

``0`` is FINISH, ``1 + i`` is WASH i, ``1 + N + i`` is LIFT i.
"""

from enum import IntEnum

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from halfseen.world.state import TableState

FINISH = 0


class Verb(IntEnum):
    """What the robot can do."""

    FINISH = 0
    WASH = 1
    LIFT = 2


def num_actions(num_objects: int) -> int:
    """Number of actions of a table with N objects."""
    return 1 + 2 * num_objects


def encode(verb: Verb, target: int, num_objects: int) -> int:
    """Integer of an action; `target` is ignored for FINISH."""
    return FINISH if verb is Verb.FINISH else 1 + (verb - 1) * num_objects + target


def verb_of(action: Int[Array | np.ndarray, "*B"], num_objects: int) -> Int[Array, "*B"]:
    """Verb of each action, as in `Verb`."""
    return jnp.where(action == FINISH, 0, 1 + (action - 1) // num_objects)


def target_of(action: Int[Array | np.ndarray, "*B"], num_objects: int) -> Int[Array, "*B"]:
    """Object of each action; 0 for FINISH, which has none."""
    return jnp.where(action == FINISH, 0, (action - 1) % num_objects)


def possible_actions(state: TableState) -> Bool[Array, " A"]:
    """Which actions one table allows: FINISH always, WASH and LIFT of what stands on the table."""
    return jnp.concatenate([jnp.ones(1, dtype=bool), state.is_on_table, state.is_on_table])
