"""Many ways to treat one set of paths, learned from in one compiled call."""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from halfseen.learners.q_learning.encoding import Encoded, TableEncoding
from halfseen.learners.q_learning.fitting import REGS
from halfseen.learners.q_learning.recursion import AnyArray, QFunctions, Transitions, backward
from halfseen.study.treatments import Treated
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.tables.variance_reduction import expected_rewards, label_surprises, wash_outcomes

NUM_FOLDS = 5


def learn(encoded: Encoded, treated: Sequence[Treated], fold: Int[np.ndarray, " n"]) -> LinearTablePolicy:
    """Learn one policy for each treatment of the same paths; the policies come as one batch."""
    encoding = TableEncoding(horizon=encoded.action.shape[1])
    blocks = encoding.block_of_action(encoded.is_possible.shape[-1])
    outcomes = wash_outcomes(encoded)
    rewards = [expected_rewards(one.reward, one.weight, one.is_last, outcomes) for one in treated]
    with jax.enable_x64(True):
        log = Transitions(
            features=jnp.asarray(encoded.features, dtype=jnp.float64),
            is_possible=jnp.asarray(encoded.is_possible),
            action=jnp.asarray(encoded.action),
            reward=jnp.asarray(np.stack(rewards)),
            weight=jnp.asarray(np.stack([one.weight for one in treated])),
            is_last=jnp.asarray(np.stack([one.is_last for one in treated])),
            fold=jnp.asarray(fold),
            surprises=jnp.asarray(label_surprises(encoded)),
        )
        fitted = _fit(log, jnp.asarray(blocks), jnp.asarray(REGS), encoding.num_blocks, encoding.end_action)
        coefficients: Float[np.ndarray, "B T K F"] = np.asarray(fitted.coefficients, dtype=np.float32)
    return LinearTablePolicy(jnp.asarray(coefficients))


@partial(jax.jit, static_argnames=("num_blocks", "end_action"))
def _fit(log: Transitions, blocks: jax.Array, regs: jax.Array, num_blocks: int, end_action: int | None) -> QFunctions:
    # The paths are shared by all treatments, and so held once.
    fit = partial(backward, num_blocks=num_blocks, stages="pooled", num_folds=NUM_FOLDS, end_action=end_action)

    def fit_one(reward: AnyArray, weight: AnyArray, is_last: AnyArray) -> QFunctions:
        return fit(log._replace(reward=reward, weight=weight, is_last=is_last), blocks, regs)

    return jax.vmap(fit_one)(log.reward, log.weight, log.is_last)
