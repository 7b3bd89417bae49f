"""Weighted ridge regression in blocks, with λ chosen by weighted cross-validation over paths.

For each block (a verb, or an action)

    minimise over α, β:  λ ‖β‖² + (1/n) Σ_rows w · (y − α − xᵀβ)²,

with n the number of *paths*, x scaled to unit weighted variance in its block, and the offset α left free. Everything
runs on sums over rows, by fold and block: held-out errors follow from them, so that trying all λ costs no second pass
over the rows, and the sums of parts of a log add up to those of the whole. One call fits one log; `jax.vmap` fits
thousands. In an RKHS, where x are features of the kernel, x keeps its scale, and ‖β‖² is the norm of the function.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

RANK_TOLERANCE = 1e-11
"""Eigenvalues below this share of the largest count as zero: that direction was never seen, and β is 0 along it."""

CHUNK = 64
"""Rows that one matrix product serves."""

FEW_GROUPS = 4
"""Up to so many, one product over all rows, most of it zeros, takes less than to deal the rows."""

TIE_TOLERANCE = 1e-9
"""Held-out errors that differ by less than this share of the largest are equal."""


class Rows(NamedTuple):
    """Rows of one log; what does not count has weight 0 and may hold any finite number."""

    features: Float[Array, "R F"]
    """Without the constant."""
    block: Int[Array, " R"]
    weight: Float[Array, " R"]
    fold: Int[Array, " R"]
    """Fold of the row's path."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Design:
    """Rows ready to be summed, by V folds and K blocks (`jax.vmap` adds batch axes)."""

    features: Float[Array, "*B R F"]
    """The constant first."""
    weight: Float[Array, "*B R"]
    group: Int[Array, "*B R"]
    """Fold and block of each row, as one number: fold · K + block."""
    shape: tuple[int, int] = field(metadata={"static": True})
    """V and K."""

    @property
    def num_groups(self) -> int:
        """V · K."""
        return self.shape[0] * self.shape[1]

    def weighing(self, weight: Float[Array, "*B R"]) -> "Design":
        """Let the same rows weigh something else."""
        return replace(self, weight=weight)


class Factor(NamedTuple):
    """Normal equations by block, factorised without each fold (if there are several) and, last, with all of them.

    They depend on the Gram matrices alone, so one factorisation serves every target.
    """

    gram: Float[Array, "V K F F"]
    train_gram: Float[Array, "V1 K F F"]
    scale: Float[Array, "K F1"]
    eigenvalues: Float[Array, "V1 K F1"]
    eigenvectors: Float[Array, "V1 K F1 F1"]


class Fit(NamedTuple):
    """Coefficients of one log."""

    coefficients: Float[Array, "K F"]
    """On the features as given, the offset first."""
    reg: Float[Array, " K"]
    """The λ that was used."""


def design_of(rows: Rows, num_blocks: int, num_folds: int) -> Design:
    """Put the constant first, and tell the rows' folds and blocks."""
    features = jnp.concatenate([jnp.ones_like(rows.weight)[:, None], rows.features], axis=1)
    return Design(features, rows.weight, rows.fold * num_blocks + rows.block, (num_folds, num_blocks))


def gram_of(design: Design) -> Float[Array, "V K F F"]:
    """Σ w x xᵀ by fold and block; those of parts of a log add up."""
    return moment_of(design, design.features)


def moment_of(design: Design, others: Float[Array, "R G"]) -> Float[Array, "V K F G"]:
    """Σ w x zᵀ by fold and block, with z other numbers of each row; those of parts of a log add up."""
    if design.num_groups <= FEW_GROUPS:
        of_group = jnp.where(design.group[:, None] == jnp.arange(design.num_groups), design.weight[:, None], 0.0)
        weighted = of_group[:, :, None] * design.features[:, None, :]
        sums = weighted.reshape(len(weighted), design.num_groups * design.features.shape[1]).T @ others
        return sums.reshape(*design.shape, design.features.shape[1], others.shape[1])
    place, group_of_chunk = _chunked(design)
    num_chunks = len(group_of_chunk)

    def in_chunks(values: Float[Array, "R G"]) -> Float[Array, "C r G"]:
        empty = jnp.zeros((num_chunks * CHUNK, values.shape[1]), values.dtype)
        return empty.at[place].set(values).reshape(num_chunks, CHUNK, values.shape[1])

    weighted = in_chunks(design.features * design.weight[:, None])
    of_chunk = jnp.einsum("crf,crg->cfg", weighted, in_chunks(others))
    sums = jax.ops.segment_sum(of_chunk, group_of_chunk, design.num_groups)
    return sums.reshape(*design.shape, *sums.shape[1:])


def cross_of(design: Design, target: Float[Array, " R"]) -> Float[Array, "V K F"]:
    """Σ w x y by fold and block; those of parts of a log add up."""
    each = (design.weight * target)[:, None] * design.features
    return jax.ops.segment_sum(each, design.group, design.num_groups).reshape(*design.shape, -1)


def _chunked(design: Design) -> tuple[Int[Array, " R"], Int[Array, " C"]]:
    """Deal rows into chunks of `CHUNK`, each of one group alone: the place of every row, and the group of every chunk.

    A row is in one fold and one block, so a product over all rows for each of them would be zeros but for one in V · K.
    """
    is_in = design.group[:, None] == jnp.arange(design.num_groups)
    rank = jnp.take_along_axis(jnp.cumsum(is_in, axis=0) - 1, design.group[:, None], axis=1)[:, 0]
    end = jnp.cumsum(-(-jnp.sum(is_in, axis=0) // CHUNK))
    begin = jnp.concatenate([jnp.zeros_like(end[:1]), end[:-1]])
    # As many as there can be: every group may leave its last chunk unfilled.
    chunks = jnp.arange(len(design.group) // CHUNK + design.num_groups)
    owner = jnp.searchsorted(end, chunks, side="right")
    return begin[design.group] * CHUNK + rank, jnp.minimum(owner, design.num_groups - 1)


def factorise(gram: Float[Array, "V K F F"], is_scaled: bool = True) -> Factor:
    """Factorise the normal equations; `is_scaled` brings the features of each block to unit weighted variance."""
    train_gram = _leave_one_out(gram)
    centred = _centred_gram(train_gram)
    variance = jnp.diagonal(centred[-1], axis1=-2, axis2=-1)
    is_varied = variance > RANK_TOLERANCE * _diagonal(gram.sum(axis=0))
    mass = jnp.maximum(gram.sum(axis=0)[:, :1, 0], jnp.finfo(gram.dtype).tiny)
    scale = jnp.sqrt(jnp.where(is_varied, variance / mass if is_scaled else 1.0, jnp.inf))
    scaled = centred / (scale[:, :, None] * scale[:, None, :])
    # LAPACK takes no empty matrix, and a Q without covariates has one.
    eigenvalues, eigenvectors = jnp.linalg.eigh(scaled) if scaled.size else (scaled.sum(axis=-1), scaled)
    return Factor(gram, train_gram, scale, eigenvalues, eigenvectors)


def with_prior(gram: Float[Array, "V K F F"], num_last: int) -> Float[Array, "V K F F"]:
    """Let each of the last features count as seen once, at 1 and alone, with nothing to explain.

    So its coefficient is shrunk towards 0 as far as one row would, and a feature that was hardly ever seen, or never
    far from 0, has no coefficient out of all proportion.
    """
    num_folds, _, _, num_features = gram.shape
    is_last = jnp.arange(num_features) >= num_features - num_last
    return gram + jnp.diag(jnp.where(is_last, 1.0 / num_folds, 0.0)).astype(gram.dtype)


def waiting_for(earlier: Float[Array, "..."], gram: Float[Array, "V K F F"]) -> Float[Array, "V K F F"]:
    """Make a Gram matrix wait for what comes of another factorisation, and change nothing.

    XLA may run what is independent at once, and in jaxlib 0.10 each batched `eigh` waits for tasks in the pool of
    threads that runs it: two of them in a pool of two wait for ever.
    """
    return gram + jnp.where(jnp.isnan(jnp.sum(earlier)), jnp.nan, 0.0)


def solve(
    factor: Factor, cross: Float[Array, "V K F"], regs: Float[Array, " L"], num_paths: int | Float[Array, ""]
) -> Fit:
    """Regress on the rows of a factor, given Σ w x y; with more than one λ, the best held-out one serves each block.

    Where several serve equally well, as in a block too small to tell, it is the last of them: list them increasing.
    """
    train_cross = _leave_one_out(cross)
    num_folds = cross.shape[0]
    shares = [(num_folds - 1) / num_folds] * (len(train_cross) - 1)
    train_paths = num_paths * jnp.array([*shares, 1.0], dtype=cross.dtype)
    coefficients = jax.vmap(_ridge, in_axes=(None, None, 0, None))(factor, train_cross, regs, train_paths)
    num_held_out = len(train_cross) - 1
    held_out = jax.vmap(_squared_error, in_axes=(0, None, None))(
        coefficients[:, :-1], factor.gram[:num_held_out], cross[:num_held_out]
    )
    best = _last_smallest(jnp.sum(held_out, axis=1))
    blocks = jnp.arange(cross.shape[1])
    return Fit(coefficients[best, -1, blocks], regs[best])


def _last_smallest(errors: Float[Array, "L K"]) -> Int[Array, " K"]:
    # Equal errors differ by rounding, and that must not choose.
    slack = TIE_TOLERANCE * jnp.max(jnp.abs(errors), axis=0)
    is_smallest = errors <= jnp.min(errors, axis=0) + slack
    return errors.shape[0] - 1 - jnp.argmax(is_smallest[::-1], axis=0)


def _leave_one_out(sums: Float[Array, " V *S"]) -> Float[Array, " V1 *S"]:
    total = sums.sum(axis=0, keepdims=True)
    # Without folds nothing is held out.
    return jnp.concatenate([total - sums, total]) if len(sums) > 1 else total


def _diagonal(gram: Float[Array, "K F F"]) -> Float[Array, "K F1"]:
    return jnp.diagonal(gram, axis1=-2, axis2=-1)[:, 1:]


def _mean(train_gram: Float[Array, "V1 K F F"]) -> Float[Array, "V1 K F1"]:
    mass = train_gram[..., 0, 0]
    return train_gram[..., 0, 1:] / jnp.where(mass > 0, mass, 1.0)[..., None]


def _centred_gram(train_gram: Float[Array, "V1 K F F"]) -> Float[Array, "V1 K F1 F1"]:
    mean = _mean(train_gram)
    return train_gram[..., 1:, 1:] - train_gram[..., 0, 0, None, None] * mean[..., :, None] * mean[..., None, :]


def _ridge(
    factor: Factor, train_cross: Float[Array, "V1 K F"], reg: Float[Array, ""], train_paths: Float[Array, " V1"]
) -> Float[Array, "V1 K F"]:
    mean, mass = _mean(factor.train_gram), factor.train_gram[..., 0, 0]
    centred = (train_cross[..., 1:] - mean * train_cross[..., :1]) / factor.scale
    is_seen = factor.eigenvalues > RANK_TOLERANCE * jnp.max(factor.eigenvalues, axis=-1, keepdims=True, initial=0.0)
    penalised = factor.eigenvalues + (reg * train_paths)[:, None, None]
    inverse = jnp.where(is_seen, 1.0 / jnp.where(is_seen, penalised, 1.0), 0.0)
    along = jnp.einsum("vkfe,vkf->vke", factor.eigenvectors, centred) * inverse
    slopes = jnp.einsum("vkfe,vke->vkf", factor.eigenvectors, along) / factor.scale
    offset = train_cross[..., 0] / jnp.where(mass > 0, mass, 1.0) - jnp.sum(slopes * mean, axis=-1)
    return jnp.concatenate([offset[..., None], slopes], axis=-1)


def _squared_error(
    coefficients: Float[Array, "V K F"], gram: Float[Array, "V K F F"], cross: Float[Array, "V K F"]
) -> Float[Array, "V K"]:
    """Σ w (y − xᵀβ)² − Σ w y² of each fold, which no λ changes."""
    quadratic = jnp.einsum("vkf,vkfg,vkg->vk", coefficients, gram, coefficients)
    return quadratic - 2.0 * jnp.sum(coefficients * cross, axis=-1)
