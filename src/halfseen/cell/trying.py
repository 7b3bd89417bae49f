"""What a robot does to learn its own laws: it lifts whatever stands there, at random."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array

from halfseen.world.action_space import ActionSpace, Verb, possible_actions
from halfseen.world.policy import Decision
from halfseen.world.state import TableState


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LiftAtRandom:
    """Lifts each object on the table with the same probability; finishes where none is left."""

    def decide(self, state: TableState, key: Array) -> Decision:
        """Choose for one table."""
        actions = ActionSpace(state.num_objects)
        every = jnp.arange(actions.num_actions)
        is_lift = possible_actions(state) & (actions.verb(every) == Verb.LIFT)
        may = jnp.where(jnp.any(is_lift), is_lift, actions.verb(every) == Verb.FINISH)
        action = jax.random.categorical(key, jnp.where(may, 0.0, -jnp.inf))
        return Decision(action.astype(jnp.int32), 1.0 / jnp.sum(may))
