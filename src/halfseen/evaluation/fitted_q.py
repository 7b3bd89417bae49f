"""Fitted Q evaluation under censoring [Le2019]_: eq. 3 with the policy's own action in place of the best one.

One compiled function fits Q to many weightings of the same log: to all paths, and to all but each fold in turn. So no
path is judged by a Q that it shaped (*cross-fitting*), and how much the value changes from fold to fold tells its
standard error (the delete-a-group jackknife [Kott2001]_). Ĝ, and the distribution of durations behind imputed targets,
are those of the whole log: they have few parameters.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from halfseen.learners.q_learning.q_learner import CensoredQLearner
from halfseen.learners.q_learning.recursion import (
    Transitions,
    backward,
    imputed_target,
    of_successor,
    q_values,
    target_of,
)


class Judged(NamedTuple):
    """What a Q says of every stage of a log, for one weighting or for each of B."""

    value: Float[Any, "*B n T"]
    """V̂_t(S_t) = Σ_a π(a | S_t) Q̂_t(S_t, a)."""
    taken: Float[Any, "*B n T"]
    """Q̂_t(S_t, A_t)."""
    target: Float[Any, "*B n T"]
    """X_t = R_t + V̂_{t+1}(S_{t+1}), or Y_t where targets are imputed; 0 where there is none."""


@dataclass(frozen=True)
class Fitting:
    """How Q is fitted; what does not change between weightings.

    Parameters
    ----------
    options
        Of `backward`.
    regs
        The λ to choose from.
    blocks
        Block of coefficients of each action.
    """

    options: tuple[tuple[str, Any], ...]
    regs: Float[np.ndarray, " L"]
    blocks: Int[np.ndarray, " A"]

    def judge(
        self, log: Transitions, reward: Float[np.ndarray, "n T"], multiplicity: Float[np.ndarray, "B n"]
    ) -> Judged:
        """Fit Q to each weighting, and let it judge every path.

        Parameters
        ----------
        log
            The log, with the policy.
        reward
            As logged; those of `log` may have had noise taken out of them.
        multiplicity
            How often each path counts.
        """
        with jax.enable_x64(True):
            arrays = jax.tree.map(jnp.asarray, (log, reward, self.blocks, self.regs))
            # One after the other, each to its end: eigenproblems in flight at once can block for ever (`waiting_for`).
            each = [
                jax.block_until_ready(_judge(*arrays, jnp.asarray(one), options=self.options)) for one in multiplicity
            ]
            return Judged(*(np.stack([np.asarray(leaf) for leaf in leaves]) for leaves in zip(*each, strict=True)))


def fitting_of(model: CensoredQLearner, num_paths: int, num_actions: int) -> Fitting:
    """Read from a learner how it fits Q to a log of so many paths."""
    options = tuple(model.backward_options(num_paths).items())
    return Fitting(options, model.regs, model.encoding.block_of_action(num_actions))


@partial(jax.jit, static_argnames="options")
def _judge(
    log: Transitions,
    reward: Float[Array, "n T"],
    blocks: Int[Array, " A"],
    regs: Float[Array, " L"],
    counts: Float[Array, " n"],
    *,
    options: tuple[tuple[str, Any], ...],
) -> Judged:
    settings = dict(options)
    fits = backward(_counted(log, counts), blocks, regs, **settings)
    if settings["stages"] == "pooled":
        fits = jax.tree.map(lambda leaf: leaf[::-1], fits)
    assert log.policy is not None
    q = jax.vmap(q_values, in_axes=(0, 1, None), out_axes=1)(
        jnp.asarray(fits.coefficients), jnp.asarray(log.features), blocks
    )
    value = jnp.sum(log.policy * q, axis=-1)
    taken = jnp.take_along_axis(q, log.action[..., None], axis=2)[..., 0]
    target = target_of(log._replace(reward=reward), of_successor(value))
    if fits.told is not None:
        target = imputed_target(log, jnp.asarray(fits.told), target, blocks)
    return Judged(value, taken, target)


def _counted(log: Transitions, counts: Float[Array, " n"]) -> Transitions:
    imputed = log.imputation
    if imputed is not None:
        imputed = imputed._replace(is_told=imputed.is_told * counts[:, None])
    return log._replace(weight=log.weight * counts[:, None], imputation=imputed)


def jackknifed(value: Float[np.ndarray, "B n"], fold: Int[np.ndarray, " n"]) -> tuple[float, float]:
    """Value of the policy by Q̂ alone, and its standard error.

    Parameters
    ----------
    value
        V̂_1(S_1) of every path: by the Qs that were fitted without each fold, and last by that of all paths.
    fold
        Of each path.
    """
    num_folds = len(value) - 1
    without = np.array([value[k, fold != k].mean() for k in range(num_folds)])
    error = np.sqrt((num_folds - 1.0) / num_folds * np.sum((without - without.mean()) ** 2))
    return float(value[-1].mean()), float(error)
