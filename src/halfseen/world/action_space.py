"""WASH one, LIFT one, or FINISH: one integer for each action of a table with N objects, in this file alone.

``0`` is FINISH; then come the verbs that have a target, each with its N actions: ``1 + i`` is WASH i, ``1 + N + i`` is
LIFT i. Whoever adds a verb adds it to `Verb`; no other file computes with these numbers.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

FINISH = 0


class Verb(IntEnum):
    """What the robot can do."""

    FINISH = 0
    WASH = 1
    LIFT = 2


TARGETED = tuple(verb for verb in Verb if verb is not Verb.FINISH)
"""Verbs that are done to an object."""


@dataclass(frozen=True)
class ActionSpace:
    """The actions of a table with N objects. Arrays in are NumPy's or JAX's, and so are those out.

    Parameters
    ----------
    num_objects
        N, at least 1.

    Examples
    --------
    >>> space = ActionSpace(2)
    >>> space.names
    ('FINISH', 'WASH 0', 'WASH 1', 'LIFT 0', 'LIFT 1')
    >>> space.encode(Verb.LIFT, 1), space.verb(4), space.target(4)
    (4, 2, 1)
    """

    num_objects: int

    @classmethod
    def of_size(cls, num_actions: int) -> "ActionSpace":
        """Space with so many actions."""
        return cls((num_actions - 1) // len(TARGETED))

    @property
    def num_actions(self) -> int:
        """Number A of actions."""
        return 1 + len(TARGETED) * self.num_objects

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each action, such as ``"WASH 0"``."""
        return (Verb.FINISH.name, *(f"{verb.name} {k}" for verb in TARGETED for k in range(self.num_objects)))

    @property
    def verbs(self) -> Int[np.ndarray, " A"]:
        """Verb of each action, as in `Verb`."""
        return np.asarray(self.verb(np.arange(self.num_actions)))

    def encode(self, verb: Any, target: Any) -> Any:
        """Integer of an action, or of an array of them; `target` is ignored for FINISH."""
        return (verb > 0) * (1 + (verb - 1) * self.num_objects + target)

    def verb(self, action: Any) -> Any:
        """Verb of each action, as in `Verb`."""
        return 1 + (action - 1) // self.num_objects

    def target(self, action: Any) -> Any:
        """Object of each action; 0 for FINISH, which has none."""
        return (action > 0) * ((action - 1) % self.num_objects)

    def of(self, verb: Verb) -> slice:
        """Where the actions of a verb stand among all."""
        if verb is Verb.FINISH:
            return slice(0, 1)
        first = self.encode(int(verb), 0)
        return slice(first, first + self.num_objects)

    def join(self, finish: Float[Array, "*S"], of_verb: Mapping[Verb, Float[Array, " N *S"]]) -> Float[Array, " A *S"]:
        """Lay out values of FINISH, and by object of other verbs, in the order of the actions.

        A verb that is left out is worth −∞: whoever does not know it never takes it.
        """
        unknown = jnp.full((self.num_objects, *jnp.shape(finish)), -jnp.inf)
        return jnp.concatenate([jnp.asarray(finish)[None], *(of_verb.get(verb, unknown) for verb in TARGETED)])


@runtime_checkable
class Table(Protocol):
    """What tells of one table which objects stand on it: a state, a belief."""

    @property
    def is_on_table(self) -> Bool[Array, "*B N"]:
        """False in the dishwasher, and for padding."""
        ...


def possible_actions(state: Table) -> Bool[Array, " A"]:
    """Which actions one table allows: FINISH always, every other verb on what stands on the table."""
    return jnp.concatenate([jnp.ones(1, dtype=bool), *[state.is_on_table] * len(TARGETED)])
