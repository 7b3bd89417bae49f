"""How well Q̂ is known, state by state: the standard error behind its lower confidence bound (*pessimism*).

A block's Q̂(x) = α + βᵀφ(x) rests on the completed stages of its actions. With C their centred Gram matrix, N their
weight, λ the ridge and σ² the variance of their targets about Q̂,

    s²(x) = σ² (1/N + zᵀ (C + nλ I)⁻¹ z),    z = (φ(x) − mean) / scale,

the variance of a ridge regression read as Bayes does (in an RKHS, of a Gaussian process), so that it grows where no
completed stage is near [AbbasiYadkori2011]_ [JinYangWang2021]_. Imputed targets of cut stages count as nothing seen.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from halfseen.learners.q_learning.least_squares import Design, Factor, factorise, gram_of, waiting_for
from halfseen.learners.q_learning.transitions import AnyArray, Choices


class Spread(NamedTuple):
    """What of s no target changes, by block; of the completed stages alone."""

    factor: Factor
    """Without folds."""
    weights: "WeightSums"


class WeightSums(NamedTuple):
    """Sums over the completed stages of each block; those of parts of a log add up."""

    mass: Float[AnyArray, " K"]
    """Σw."""
    squares: Float[AnyArray, " K"]
    """Σw²: heavy weights make of many stages few."""
    count: Float[AnyArray, " K"]
    """Stages with a weight."""


def spread_of_rows(design: Design, earlier: Float[Array, "..."], is_scaled: bool) -> Spread:
    """Sum and factorise the completed stages, once `earlier` is there."""
    gram = waiting_for(earlier, gram_of(design).sum(axis=0, keepdims=True))
    return Spread(factorise(gram, is_scaled), weight_sums(design))


def weight_sums(design: Design) -> WeightSums:
    """Sum the weights of each block."""
    is_seen = (design.weight > 0).astype(design.weight.dtype)
    return WeightSums(*(by_block(each, design) for each in (design.weight, design.weight**2, is_seen)))


def by_block(values: Float[Array, " R"], design: Design) -> Float[Array, " K"]:
    """Sum over the rows of each block."""
    return jax.ops.segment_sum(values, design.group % design.shape[1], design.shape[1])


def roots(
    spread: Spread, regs: Float[Array, " K"], num_paths: int | Float[Array, ""], squares: Float[Array, " K"]
) -> Float[Array, "K F F"]:
    """R of every block, so that s(x) = ‖Rᵀ (1, φ(x))‖.

    Parameters
    ----------
    spread
        Of the completed stages.
    regs
        λ of each block.
    num_paths
        n.
    squares
        Σ w (X − Q̂)² of the completed stages.
    """
    deviation = deviations(spread, regs, num_paths, squares)
    return unit_roots(spread, regs, num_paths) * deviation[:, None, None]


def unit_roots(spread: Spread, regs: Float[Array, " K"], num_paths: int | Float[Array, ""]) -> Float[Array, "K F F"]:
    """R of every block for targets of which one effective stage varies by 1 about Q̂: no target changes it but by λ."""
    factor, penalised = spread.factor, _penalised(spread, regs, num_paths)
    gram, mass = factor.gram[0], _mass(spread)
    slopes = factor.eigenvectors[0] / factor.scale[..., None] / jnp.sqrt(penalised)[:, None, :]
    offset = -jnp.einsum("kf,kfe->ke", gram[:, 0, 1:] / mass[:, None], slopes)
    first = jnp.zeros((len(mass), gram.shape[-1])).at[:, 0].set(1.0 / jnp.sqrt(mass))
    return jnp.concatenate([first[..., None], jnp.concatenate([offset[:, None], slopes], axis=1)], axis=2)


def deviations(
    spread: Spread, regs: Float[Array, " K"], num_paths: int | Float[Array, ""], squares: Float[Array, " K"]
) -> Float[Array, " K"]:
    """What R is times its `unit_roots`, for each block."""
    eigenvalues, penalised = spread.factor.eigenvalues[0], _penalised(spread, regs, num_paths)
    fitted = 1.0 + jnp.sum(jnp.maximum(eigenvalues, 0.0) / penalised, axis=-1)
    return jnp.sqrt(_variance(spread.weights, squares, fitted) * spread.weights.squares / _mass(spread))


def _penalised(spread: Spread, regs: Float[Array, " K"], num_paths: int | Float[Array, ""]) -> Float[Array, "K F1"]:
    eigenvalues = spread.factor.eigenvalues[0]
    largest = jnp.max(eigenvalues, axis=-1, keepdims=True, initial=0.0)
    tiny = jnp.finfo(eigenvalues.dtype).tiny
    return jnp.maximum(eigenvalues + (regs * num_paths)[:, None], 1e-8 * largest + tiny)


def _mass(spread: Spread) -> Float[Array, " K"]:
    gram = spread.factor.gram[0]
    return jnp.maximum(gram[:, 0, 0], jnp.finfo(gram.dtype).tiny)


def standard_errors(
    root: Float[Array, "K F F"], features: Float[Array, "n T E F1"], block_of_action: Int[Array, " A"]
) -> Float[Array, "n T A"]:
    """S of every action in every state."""
    last = features.shape[2] - 1

    def of_action(action: Int[Array, ""]) -> Float[Array, "n T"]:
        each = root[block_of_action[action]]
        return jnp.sqrt(jnp.sum((each[0] + features[:, :, jnp.minimum(action, last)] @ each[1:]) ** 2, axis=-1))

    # One action after the other: its product is one of two matrices, where all at once would be slow ones in batches.
    return jnp.moveaxis(jax.lax.map(of_action, jnp.arange(len(block_of_action))), 0, -1)


def standard_errors_of_choices(
    root: Float[Array, "K F F"], choices: Choices, block_of_action: Int[Array, " A"]
) -> Float[Array, "C S"]:
    """S of all that is possible."""
    each = root[block_of_action[choices.action[:, 0]]]
    along = each[:, :1] + jnp.einsum("csf,cfg->csg", jnp.asarray(choices.features), each[:, 1:])
    return jnp.sqrt(jnp.sum(along**2, axis=-1))


def _variance(weights: WeightSums, squares: Float[Array, " K"], fitted: Float[Array, " K"]) -> Float[Array, " K"]:
    """σ² of each block; as many stages as there are coefficients that λ leaves are used up by the fit."""
    left = weights.count / jnp.maximum(weights.count - fitted, 0.1 * weights.count + 0.5)
    return jnp.asarray(left * squares / jnp.where(weights.mass > 0, weights.mass, 1.0))
