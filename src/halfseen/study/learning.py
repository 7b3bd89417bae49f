"""Many ways to treat one set of paths, learned from in one compiled call."""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from halfseen.learners.encoding import Encoded, TableEncoding
from halfseen.learners.linear_policy import LinearTablePolicy
from halfseen.learners.q_learner import REGS
from halfseen.learners.recursion import QFunctions, Transitions, backward
from halfseen.study.treatments import Treated

NUM_FOLDS = 5
_BATCHED = Transitions(features=None, is_possible=None, action=None, reward=0, weight=0, is_last=0, fold=None)


def learn(encoded: Encoded, treated: Sequence[Treated], fold: Int[np.ndarray, " n"]) -> LinearTablePolicy:
    """Learn one policy for each treatment of the same paths; the policies come as one batch."""
    encoding = TableEncoding(horizon=encoded.action.shape[1])
    blocks = encoding.block_of_action(encoded.is_possible.shape[-1])
    with jax.enable_x64(True):
        log = Transitions(
            features=jnp.asarray(encoded.features, dtype=jnp.float64),
            is_possible=jnp.asarray(encoded.is_possible),
            action=jnp.asarray(encoded.action),
            reward=jnp.asarray(np.stack([one.reward for one in treated])),
            weight=jnp.asarray(np.stack([one.weight for one in treated])),
            is_last=jnp.asarray(np.stack([one.is_last for one in treated])),
            fold=jnp.asarray(fold),
        )
        fitted = _fit(log, jnp.asarray(blocks), jnp.asarray(REGS), encoding.num_blocks, encoding.end_action)
        coefficients: Float[np.ndarray, "B T K F"] = np.asarray(fitted.coefficients, dtype=np.float32)
    return LinearTablePolicy(jnp.asarray(coefficients))


@partial(jax.jit, static_argnames=("num_blocks", "end_action"))
def _fit(log: Transitions, blocks: jax.Array, regs: jax.Array, num_blocks: int, end_action: int | None) -> QFunctions:
    fit = partial(backward, num_blocks=num_blocks, stages="pooled", num_folds=NUM_FOLDS, end_action=end_action)
    return jax.vmap(fit, in_axes=(_BATCHED, None, None))(log, blocks, regs)
