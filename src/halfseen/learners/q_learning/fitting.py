"""Q-functions of one log or of a batch, in float64, whatever the precision elsewhere."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from halfseen.errors import ArgumentError
from halfseen.learners.q_learning.encoding import Encoding
from halfseen.learners.q_learning.kernel_map import KernelMap
from halfseen.learners.q_learning.recursion import QFunctions, StageMode, Transitions, backward
from halfseen.tables.table_policy import LinearTablePolicy

REGS = np.logspace(-3, 2, 11)
"""The λ that ``reg="cv"`` chooses from; features are scaled to unit variance, so they need no other unit."""

KERNEL_REGS = np.logspace(-6, 1, 15)
"""The same for the norm of an RKHS."""


def backward_options(encoding: Encoding, stages: StageMode, num_folds: int, is_scaled: bool) -> dict[str, Any]:
    """Collect what `backward` is compiled for."""
    return {
        "num_blocks": encoding.num_blocks,
        "stages": stages,
        "num_folds": num_folds,
        "end_action": encoding.end_action if stages == "pooled" else None,
        "is_scaled": is_scaled,
    }


def fit_q_functions(
    log: Transitions,
    encoding: Encoding,
    regs: Float[np.ndarray, " L"],
    stages: StageMode,
    num_folds: int,
    is_scaled: bool = True,
) -> QFunctions:
    """Run the recursion in float64 on one log, or on a batch of logs if the arrays have a leading axis for it.

    Raises
    ------
    ArgumentError
        A path is in a fold that does not exist, and would count for nothing.
    """
    largest = int(np.asarray(log.fold).max())
    if largest >= num_folds:
        raise ArgumentError(f"fold {largest} of {num_folds}: folds are 0 to {num_folds - 1}; deal the paths anew")
    blocks = encoding.block_of_action(log.is_possible.shape[-1])
    options = backward_options(encoding, stages, num_folds, is_scaled)
    with jax.enable_x64(True):
        arrays = jax.tree.map(jnp.asarray, log)
        is_batch = log.action.ndim == 3
        fit = backward_batch if is_batch else backward
        fitted = fit(arrays, jnp.asarray(blocks), jnp.asarray(regs), **options)
        return jax.tree.map(np.asarray, fitted)


def backward_batch(log: Transitions, blocks: jax.Array, regs: jax.Array, **options: Any) -> QFunctions:
    """Fit a batch of logs in one compiled call."""
    return jax.vmap(lambda one: backward(one, blocks, regs, **options))(log)


def as_policy(q_functions: QFunctions, stages: StageMode) -> LinearTablePolicy:
    """Turn the Q-functions of a table (or of a batch of logs) into policies, indexed by steps to go."""
    coefficients = np.asarray(q_functions.coefficients, dtype=np.float32)
    return LinearTablePolicy(jnp.asarray(coefficients if stages == "pooled" else coefficients[..., ::-1, :, :]))


def single_precision(kernel_map: KernelMap | None) -> KernelMap | None:
    """Make the kernel of a table's policy as coarse as its states."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=jnp.float32), kernel_map)
