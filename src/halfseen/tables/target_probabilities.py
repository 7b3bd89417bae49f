"""π(a | S_t) of policies of tables in the states of a log, for off-policy evaluation."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from halfseen.errors import ArgumentError
from halfseen.logs import Logs
from halfseen.programs import kept_jit
from halfseen.world.action_space import possible_actions
from halfseen.world.policy import ExploringPolicy, Policy, UniformPolicy
from halfseen.world.recording import states_of
from halfseen.world.state import TableState


def table_probabilities(policy: Any, logs: Logs, horizon: int) -> Float[np.ndarray, "n T A"]:
    """π(a | S_t) of any deterministic `halfseen.world.Policy`, or one mixed with `UniformPolicy`.

    Raises
    ------
    ArgumentError
        It is none, is for another horizon, or draws its actions and cannot say how.
    """
    if not isinstance(policy, Policy):
        raise ArgumentError(f"{type(policy).__name__} decides nothing about tables, which the task is of")
    return np.array(_probabilities_at(policy, states_of(logs, horizon)), dtype=np.float64)


def action_probabilities(policy: Any, state: TableState) -> Float[Array, " A"]:
    """π(a | S) of one table; NaN where the policy draws its actions and does not say how."""
    is_possible = possible_actions(state)
    uniform = is_possible / jnp.sum(is_possible)
    if isinstance(policy, UniformPolicy):
        return uniform
    if isinstance(policy, ExploringPolicy):
        return policy.random_share * uniform + (1.0 - policy.random_share) * action_probabilities(policy.base, state)
    decision = policy.decide(state, jax.random.key(0))
    is_taken = jnp.arange(len(is_possible)) == decision.action
    return jnp.where(decision.probability == 1.0, is_taken.astype(uniform.dtype), jnp.nan)


@kept_jit
def _probabilities_at(policy: Any, states: TableState) -> Float[Array, "n T A"]:
    return jax.vmap(jax.vmap(lambda state: action_probabilities(policy, state)))(states)
