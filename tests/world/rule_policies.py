"""Policies for tests that look at objects by their index, so that padding cannot change what they do."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from halfseen.world.action_space import FINISH
from halfseen.world.policy import surely


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class InTurn:
    """LIFT, then WASH, the first object on the table, until it is gone; then the next; FINISH at the last step."""

    def decide(self, state, key):
        first = jnp.argmax(state.is_on_table)
        is_lift = state.steps_to_go % 2 == 0
        action = 1 + first + jnp.where(is_lift, state.num_objects, 0)
        return surely(jnp.where(state.steps_to_go == 1, FINISH, action).astype(jnp.int32))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Suspicious:
    """WASH what looks dirtiest."""

    def decide(self, state, key):
        worst = jnp.argmax(jnp.where(state.is_on_table, state.log_odds, -jnp.inf))
        return surely((1 + worst).astype(jnp.int32))
