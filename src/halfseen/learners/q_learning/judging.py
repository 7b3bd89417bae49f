"""What fitted Qs say of every stage of a log: its value, that of the action taken, and the target of eq. 3."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from halfseen.learners.q_learning.transitions import (
    QFunctions,
    StageMode,
    Transitions,
    imputed_target,
    of_successor,
    q_values,
    target_of,
    values_of,
)


class Judged(NamedTuple):
    """What a Q says of every stage of a log, for one weighting or for each of B."""

    value: Float[Any, "*B n T"]
    """V̂_t(S_t)."""
    taken: Float[Any, "*B n T"]
    """Q̂_t(S_t, A_t)."""
    target: Float[Any, "*B n T"]
    """X_t = R_t + V̂_{t+1}(S_{t+1}), or Y_t where targets are imputed; 0 where there is none."""


def judged(
    fits: QFunctions, log: Transitions, block_of_action: Int[Array, " A"], stages: StageMode, reward: Any
) -> Judged:
    """Let each stage's own Q judge it.

    Parameters
    ----------
    fits
        What `backward` made of the log, or of another weighting of it.
    log
        The log.
    block_of_action, stages
        As for `backward`.
    reward
        As logged; those of `log` may have had noise taken out of them.
    """
    by_stage = jax.tree.map(lambda leaf: leaf[::-1], fits) if stages == "pooled" else fits
    each = jax.vmap(q_values, in_axes=(0, 1, None), out_axes=1)
    q = each(jnp.asarray(by_stage.coefficients), jnp.asarray(log.features), block_of_action)
    value = values_of(q, log)
    taken = jnp.take_along_axis(q, log.action[..., None], axis=2)[..., 0]
    target = target_of(log._replace(reward=reward), of_successor(value))
    if by_stage.outcome is not None:
        target = imputed_target(log, jnp.asarray(by_stage.outcome), target, block_of_action)
    return Judged(value, taken, target)
