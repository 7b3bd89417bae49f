"""Weighted ridge regression in blocks, with λ chosen by weighted cross-validation over paths.

For each block (a verb, or an action)

    minimise over α, β:  λ ‖β‖² + (1/n) Σ_rows w · (y − α − xᵀβ)²,

with n the number of *paths*, x scaled to unit weighted variance in its block, and the offset α left free. Everything
runs on sums over rows, by fold and block: held-out errors follow from them, so that trying all λ costs no second pass
over the rows, and the sums of parts of a log add up to those of the whole. In an RKHS, where x are features of the
kernel, x keeps its scale, and ‖β‖² is the norm of the function.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

RANK_TOLERANCE = 1e-11
"""Eigenvalues below this share of the largest count as zero: that direction was never seen, and β is 0 along it."""

TIE_TOLERANCE = 1e-9
"""Held-out errors that differ by less than this share of the largest are equal."""


class Factor(NamedTuple):
    """Normal equations by block, factorised without each fold (if there are several) and, last, with all of them.

    They depend on the Gram matrices alone, so one factorisation serves every target.
    """

    gram: Float[np.ndarray, "V K F F"]
    mass: Float[np.ndarray, "V1 K"]
    mean: Float[np.ndarray, "V1 K F1"]
    scale: Float[np.ndarray, "K F1"]
    eigenvalues: Float[np.ndarray, "V1 K F1"]
    eigenvectors: Float[np.ndarray, "V1 K F1 F1"]


class Fit(NamedTuple):
    """Coefficients of one log."""

    coefficients: Float[np.ndarray, "K F"]
    """On the features as given, the offset first."""
    reg: Float[np.ndarray, " K"]
    """The λ that was used."""


def factorise(gram: Float[np.ndarray, "V K F F"], is_scaled: bool = True) -> Factor:
    """Factorise the normal equations; `is_scaled` brings the features of each block to unit weighted variance."""
    train, total = _leave_one_out(gram), gram.sum(axis=0)
    mass = train[..., 0, 0]
    mean = train[..., 0, 1:] / np.where(mass > 0, mass, 1.0)[..., None]
    centred = train[..., 1:, 1:] - mass[..., None, None] * mean[..., :, None] * mean[..., None, :]
    variance = np.diagonal(centred[-1], axis1=-2, axis2=-1)
    is_varied = variance > RANK_TOLERANCE * np.diagonal(total, axis1=-2, axis2=-1)[:, 1:]
    of_all = np.maximum(total[:, :1, 0], np.finfo(gram.dtype).tiny)
    scale = np.sqrt(np.where(is_varied, variance / of_all if is_scaled else 1.0, np.inf))
    scaled = centred / (scale[:, :, None] * scale[:, None, :])
    # LAPACK takes no empty matrix, and a Q without covariates has one.
    eigenvalues, eigenvectors = np.linalg.eigh(scaled) if scaled.size else (scaled.sum(axis=-1), scaled)
    return Factor(gram, mass, mean, scale, eigenvalues, eigenvectors)


def with_prior(gram: Float[np.ndarray, "V K F F"], num_last: int) -> Float[np.ndarray, "V K F F"]:
    """Let each of the last features count as seen once, at 1 and alone, with nothing to explain.

    So its coefficient is shrunk towards 0 as far as one row would, and a feature that was hardly ever seen, or never
    far from 0, has no coefficient out of all proportion.
    """
    num_folds, _, _, num_features = gram.shape
    is_last = np.arange(num_features) >= num_features - num_last
    return gram + np.diag(np.where(is_last, 1.0 / num_folds, 0.0))


def solve(factor: Factor, cross: Float[np.ndarray, "V K F"], regs: Float[np.ndarray, " L"], num_paths: int) -> Fit:
    """Regress on the rows of a factor, given Σ w x y; with more than one λ, the best held-out one serves each block.

    Where several serve equally well, as in a block too small to tell, it is the last of them: list them increasing.
    """
    train_cross, num_folds = _leave_one_out(cross), len(cross)
    num_held_out = len(train_cross) - 1
    train_paths = num_paths * np.array([*[(num_folds - 1) / num_folds] * num_held_out, 1.0])
    coefficients = _ridge(factor, train_cross, regs[:, None] * train_paths)
    if len(regs) == 1:
        return Fit(coefficients[0, -1], np.broadcast_to(regs, cross.shape[1]).copy())
    held_out = _squared_error(coefficients[:, :num_held_out], factor.gram[:num_held_out], cross[:num_held_out])
    best = _last_smallest(held_out)
    return Fit(coefficients[best, -1, np.arange(cross.shape[1])], regs[best])


def _last_smallest(errors: Float[np.ndarray, "L K"]) -> Int[np.ndarray, " K"]:
    # Equal errors differ by rounding, and that must not choose.
    is_smallest = errors <= errors.min(axis=0) + TIE_TOLERANCE * np.abs(errors).max(axis=0)
    return len(errors) - 1 - np.argmax(is_smallest[::-1], axis=0)


def _leave_one_out(sums: Float[np.ndarray, " V *S"]) -> Float[np.ndarray, " V1 *S"]:
    total = sums.sum(axis=0, keepdims=True)
    # Without folds nothing is held out.
    return np.concatenate([total - sums, total]) if len(sums) > 1 else total


def _ridge(
    factor: Factor, train_cross: Float[np.ndarray, "V1 K F"], penalty: Float[np.ndarray, "L V1"]
) -> Float[np.ndarray, "L V1 K F"]:
    """Coefficients by each λ, without each fold and with all."""
    centred = (train_cross[..., 1:] - factor.mean * train_cross[..., :1]) / factor.scale
    eigenvalues, vectors = factor.eigenvalues, factor.eigenvectors
    is_seen = eigenvalues > RANK_TOLERANCE * eigenvalues.max(axis=-1, keepdims=True, initial=0.0)
    penalised = eigenvalues + penalty[:, :, None, None]
    along = np.matmul(np.swapaxes(vectors, -1, -2), centred[..., None])[..., 0]
    along = np.where(is_seen, along / np.where(is_seen, penalised, 1.0), 0.0)
    slopes = np.moveaxis(np.matmul(vectors, np.moveaxis(along, 0, -1)), -1, 0) / factor.scale
    offset = train_cross[..., 0] / np.where(factor.mass > 0, factor.mass, 1.0) - np.sum(slopes * factor.mean, axis=-1)
    return np.concatenate([offset[..., None], slopes], axis=-1)


def _squared_error(
    coefficients: Float[np.ndarray, "L V K F"], gram: Float[np.ndarray, "V K F F"], cross: Float[np.ndarray, "V K F"]
) -> Float[np.ndarray, "L K"]:
    """Σ w (y − xᵀβ)² − Σ w y² over all folds, which no λ changes."""
    of_gram = np.moveaxis(np.matmul(gram, np.moveaxis(coefficients, 0, -1)), -1, 0)
    return np.sum(coefficients * (of_gram - 2.0 * cross), axis=(1, 3))
