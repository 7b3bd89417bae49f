"""Censored Q-learning, backwards over the stages (paper, eq. 3), for linear 𝒬.

    Q̂_{T+1} ≡ 0;  Q̂_t = argmin E_n[ (R_t + max_a' Q̂_{t+1}(S_{t+1}, a') − Q_t(S_t, A_t))² · δ_t / Ĝ(U_t⁻) ]

A linear Q is α_k + β_kᵀ φ(S, a) with k the block of the action, and each step adds the ridge of `least_squares`.

*Separate* stages: each stage has its own Q_t, fitted on its own rows and shrunk towards 0.

*Pooled* stages, for worlds whose dynamics do not depend on t: Q_h is indexed by the steps to go, h = 1..T, and fitted
on the rows of all stages; a row that the horizon ended says nothing of a longer future, so it serves Q_1 alone. One
more step to go changes little, so Q_h is shrunk towards Q_{h−1}. With λ = 0 nothing is shrunk, and eq. 3 is exact.

*Surprises* are control variates [Glasserman2003]_: numbers that S_{t+1} tells and whose mean given (S_t, A_t) is 0.
Each regression runs on them too, and Q leaves them out: what they explain of the target is noise that Q is spared.
"""

from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from halfseen.learners.q_learning.least_squares import Factor, Fit, Rows, factorise, solve

StageMode = Literal["separate", "pooled"]
AnyArray = Array | np.ndarray


class Transitions(NamedTuple):
    """One log as dense arrays, padded to T stages; `jax.vmap` adds an axis of logs."""

    features: Float[AnyArray, "*B n T A F"]
    """φ(S_t, a) of every action, without the constant; zeros where S_t was not seen."""
    is_possible: Bool[AnyArray, "*B n T A"]
    action: Int[AnyArray, "*B n T"]
    reward: Float[AnyArray, "*B n T"]
    """0 where not completed."""
    weight: Float[AnyArray, "*B n T"]
    """δ_t / Ĝ(U_t⁻): 0 where the stage was not completed."""
    is_last: Bool[AnyArray, "*B n T"]
    """Completed stages after which the path had come to its own end."""
    fold: Int[AnyArray, "*B n"]
    """Fold of each path for cross-validation, from 0; below the number of folds."""
    surprises: Float[AnyArray, "*B n T Z"] | None = None
    """Of mean 0 given (S_t, A_t), if any are known; what they hold at a path's end does not count."""


class QFunctions(NamedTuple):
    """Q of every stage (separate) or of every number of steps to go (pooled); index 0 is stage 1, or one step to go."""

    coefficients: Float[AnyArray, "*B T K F"]
    """The offset first."""
    reg: Float[AnyArray, "*B T K"]
    """The λ that was used."""


def q_values(
    coefficients: Float[AnyArray, "K F"],
    features: Float[AnyArray, "*S A F1"],
    block_of_action: Int[AnyArray, " A"],
) -> Float[Array, "*S A"]:
    """Q of every action: the offset of its block plus βᵀφ."""
    per_action = coefficients[block_of_action]
    return per_action[:, 0] + jnp.einsum("...af,af->...a", features, per_action[:, 1:])


@partial(jax.jit, static_argnames=("num_blocks", "stages", "num_folds", "end_action"))
def backward(
    log: Transitions,
    block_of_action: Int[Array, " A"],
    regs: Float[Array, " L"],
    *,
    num_blocks: int,
    stages: StageMode,
    num_folds: int,
    end_action: int | None = None,
) -> QFunctions:
    """Fit all Q-functions of one log.

    Parameters
    ----------
    log
        The log.
    block_of_action
        Which block of coefficients each action uses.
    regs
        The λ to choose from.
    num_blocks
        K.
    stages
        ``"separate"`` or ``"pooled"``.
    num_folds
        V, folds of the cross-validation.
    end_action
        For pooled stages: the action that the horizon forces upon a path, so that Q_0(S) = Q(S, end_action); every Q
        is shrunk towards it. It must end a path wherever it is taken, and a feature must mean the same in all blocks
        or be 0 for it. None if reaching the horizon costs nothing, Q_0 ≡ 0.
    """
    masks, which = _masks(log, stages, end_action)
    factors = jax.vmap(lambda mask: factorise(_rows(log, block_of_action, mask), num_blocks, num_folds))(masks)
    taken_block = block_of_action[log.action].ravel()
    num_coefficients = log.features.shape[-1] + 1

    def regress(index: Int[Array, ""], successor: Float[Array, "n T"], centre: Float[Array, "K F"]) -> Fit:
        factor: Factor = jax.tree.map(lambda leaf: leaf[index], factors)
        target = (log.reward + jnp.where(log.is_last, 0.0, successor)).ravel()
        expected = jnp.sum(factor.design * centre[taken_block], axis=-1)
        fit = solve(factor, jnp.asarray(target) - expected, regs, log.action.shape[0])
        return Fit(fit.coefficients + centre, fit.reg)

    def step(carry: tuple[Float[Array, "n T"], Float[Array, "K F"]], index: Int[Array, ""]):
        value, centre = carry
        fit = regress(index, _of_successor(value), centre)
        of_q = fit.coefficients[:, :num_coefficients]
        value = _largest_possible(q_values(of_q, log.features, block_of_action), log.is_possible)
        return (value, fit.coefficients if stages == "pooled" else centre), Fit(of_q, fit.reg)

    value = jnp.zeros_like(log.reward)
    centre = jnp.zeros((num_blocks, factors.design.shape[-1]), log.reward.dtype)
    if stages == "pooled" and end_action is not None:
        ended = regress(which[0], value, centre).coefficients
        value = q_values(ended[:, :num_coefficients], log.features, block_of_action)[..., end_action]
        centre = jnp.broadcast_to(ended[block_of_action[end_action]], centre.shape)
    _, fits = jax.lax.scan(step, (value, centre), which)
    if stages == "separate":
        fits = jax.tree.map(lambda leaf: leaf[::-1], fits)
    return QFunctions(fits.coefficients, fits.reg)


def _largest_possible(q: Float[Array, "n T A"], is_possible: Bool[AnyArray, "n T A"]) -> Float[Array, "n T"]:
    """Find max_a Q over the possible actions, 0 where none is: such a row is padding, and must stay finite."""
    largest = jnp.max(jnp.where(is_possible, q, -jnp.inf), axis=-1)
    return jnp.where(jnp.any(is_possible, axis=-1), largest, 0.0)


def _masks(
    log: Transitions, stages: StageMode, end_action: int | None
) -> tuple[Bool[Array, "M n T"], Int[Array, " T"]]:
    """Rows that serve each distinct regression, and which of these each backward step uses."""
    num_stages = log.action.shape[1]
    stage = jnp.arange(num_stages)
    if stages == "separate":
        masks = jnp.broadcast_to(stage[:, None, None] == stage, (num_stages, *log.action.shape))
        return masks, stage[::-1]
    goes_on = jnp.broadcast_to(stage < num_stages - 1, log.action.shape)
    if end_action is not None:
        goes_on = goes_on | (log.action == end_action)
    return jnp.stack([jnp.ones_like(goes_on), goes_on]), jnp.minimum(stage, 1)


def _rows(log: Transitions, block_of_action: Int[Array, " A"], mask: Bool[Array, "n T"]) -> Rows:
    taken = jnp.take_along_axis(log.features, log.action[..., None, None], axis=2)[:, :, 0]
    if log.surprises is not None:
        taken = jnp.concatenate([taken, jnp.where(log.is_last[..., None], 0.0, log.surprises)], axis=-1)
    return Rows(
        features=taken.reshape(log.action.size, taken.shape[-1]),
        block=block_of_action[log.action].ravel(),
        weight=jnp.where(mask, log.weight, 0.0).ravel(),
        fold=jnp.repeat(log.fold, log.action.shape[1]),
    )


def _of_successor(value: Float[Array, "n T"]) -> Float[Array, "n T"]:
    return jnp.concatenate([value[:, 1:], jnp.zeros_like(value[:, :1])], axis=1)
