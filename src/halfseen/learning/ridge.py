"""Weighted ridge regression in blocks, from sums over rows; λ by weighted cross-validation; and standard errors.

For each block (a verb, or an action)

    minimise over α, β:  λ ‖β‖² + (1/n) Σ_rows w · (y − α − xᵀβ)²,

with n the number of *trajectories*, x scaled to unit weighted variance in its block, and an unpenalised intercept α. In
an RKHS, x are features of the kernel and keep their scale, and ‖β‖² is the norm of the function.

With U diag(e) Uᵀ the centred and scaled Gram matrix, N the total weight and S = diag(1/scale) U, the *basis*

    B = [[1, −meanᵀ S], [0, S]]    has    Bᵀ (Σ w (1, x)(1, x)ᵀ) B = diag(N, e),

so that (α, β) = B diag(1/N, 1/(e + nλ)) Bᵀ Σ w (1, x) y for every λ and every target. Held-out errors follow from the
sums by fold, so trying all λ needs no second pass over the rows.

*Standard errors.* With σ² the variance of the targets about Q̂,

    s²(x) = σ² (1/N + zᵀ (C + nλ I)⁻¹ z) = σ² ‖diag(1/N, 1/(e + nλ))^½ Bᵀ (1, x)‖²,    z = (x − mean) / scale,

with C the centred and scaled Gram matrix. This is the posterior variance of Bayesian ridge regression (in an RKHS, of a
Gaussian process), so it grows where no completed stage is near [AbbasiYadkori2011]_ [JinYangWang2021]_.
"""

from typing import NamedTuple

import numpy as np

from halfseen.shapes import Float, Int

RANK_TOLERANCE = 1e-11
"""Eigenvalues below this share of the largest count as zero: that direction was not observed, and β is 0 along it."""

TIE_TOLERANCE = 1e-9
"""Held-out errors that differ by less than this share of the largest count as equal."""

_TINY = np.finfo(np.float64).tiny


class Ridge(NamedTuple):
    """Normal equations by block; they depend on the Gram matrices alone, so they serve every target."""

    regs: Float[np.ndarray, " L"]
    basis: Float[np.ndarray, "V1 K F F"]
    """B, without each fold (if there are several) and, last, with all of them."""
    values: Float[np.ndarray, "V1 K F"]
    """N, and e."""
    shrink: Float[np.ndarray, "L V1 K F"]
    """1/N and 1/(e + nλ) for each λ; 0 along directions that were not observed."""
    held_out: Float[np.ndarray, "V0 K F F"]
    """Bᵀ (Σ w x xᵀ) B of the rows of each fold, with B fitted without it; empty without folds."""


def ridge_of(
    gram: Float[np.ndarray, "V K F F"],
    regs: Float[np.ndarray, " L"],
    num_trajectories: int,
    is_scaled: bool = True,
    offset: float = 0.0,
) -> Ridge:
    """Factorise the normal equations.

    Parameters
    ----------
    gram
        Σ w x xᵀ by fold and block; the first entry of x is 1.
    regs
        The λ to choose from, increasing.
    num_trajectories
        n.
    is_scaled
        Whether λ penalises features as if each had unit variance.
    offset
        Fraction of λ that penalises the mean of a block; 0 leaves it free.
    """
    basis, values = _diagonalised(gram, is_scaled)
    num_held_out = len(basis) - 1
    trajectories = num_trajectories * np.append(np.full(num_held_out, (len(gram) - 1) / len(gram)), 1.0)
    penalty = np.zeros((len(regs), len(trajectories), 1, values.shape[-1]))
    penalty[:] = (regs[:, None] * trajectories)[:, :, None, None]
    penalty[..., 0] *= offset
    is_seen = values > RANK_TOLERANCE * values[..., 1:].max(axis=-1, keepdims=True, initial=0.0)
    is_seen[..., 0] = values[..., 0] > 0
    shrink = np.where(is_seen, 1.0 / np.where(is_seen, values + penalty, 1.0), 0.0)
    without = basis[:num_held_out]
    return Ridge(regs, basis, values, shrink, np.swapaxes(without, -1, -2) @ gram[:num_held_out] @ without)


def _diagonalised(
    gram: Float[np.ndarray, "V K F F"], is_scaled: bool
) -> tuple[Float[np.ndarray, "V1 K F F"], Float[np.ndarray, "V1 K F"]]:
    """B, and N and e."""
    train, total = _leave_one_out(gram), gram.sum(axis=0)
    mass = train[..., 0, 0]
    mean = train[..., 0, 1:] / np.where(mass > 0, mass, 1.0)[..., None]
    centred = train[..., 1:, 1:] - mass[..., None, None] * mean[..., :, None] * mean[..., None, :]
    variance = np.diagonal(centred[-1], axis1=-2, axis2=-1)
    is_varied = variance > RANK_TOLERANCE * np.diagonal(total, axis1=-2, axis2=-1)[:, 1:]
    of_all = np.maximum(total[:, :1, 0], _TINY)
    scale = np.sqrt(np.where(is_varied, variance / of_all if is_scaled else 1.0, np.inf))
    scaled = centred / (scale[:, :, None] * scale[:, None, :])
    # LAPACK does not accept empty matrices, which a Q without covariates has.
    spread, vectors = np.linalg.eigh(scaled) if scaled.size else (scaled.sum(axis=-1), scaled)
    basis = np.zeros_like(train)
    basis[..., 0, 0] = 1.0
    basis[..., 1:, 1:] = vectors / scale[:, :, None]
    basis[..., 0, 1:] = -np.matmul(mean[..., None, :], basis[..., 1:, 1:])[..., 0, :]
    return basis, np.concatenate([mass[..., None], spread], axis=-1)


def with_prior(gram: Float[np.ndarray, "V K F F"], num_last: int) -> Float[np.ndarray, "V K F F"]:
    """Add one pseudo-observation for each of the last features, with value 1, all others 0 and target 0.

    It shrinks each coefficient towards 0 as much as one row would, so a feature that was rarely observed, or always
    near 0, has no extreme coefficient.
    """
    num_folds, _, _, num_features = gram.shape
    is_last = np.arange(num_features) >= num_features - num_last
    return gram + np.diag(np.where(is_last, 1.0 / num_folds, 0.0))


def solve(
    ridge: Ridge, cross: Float[np.ndarray, "V K F"], is_joint: bool = False
) -> tuple[Float[np.ndarray, "K F"], Float[np.ndarray, " K"]]:
    """Regress on the rows of the normal equations, given Σ w x y; return coefficients, the intercept first, and each λ.

    The λ with the smallest held-out error is chosen for each block, or jointly for all; of equally good ones, as in a
    block that is too small to distinguish them, the last.
    """
    num_blocks, num_held_out, best = cross.shape[1], len(ridge.held_out), 0
    transposed, train = np.swapaxes(ridge.basis, -1, -2), _leave_one_out(cross)
    along = ridge.shrink * np.matmul(transposed, train[..., None])[..., 0]
    if len(ridge.regs) > 1:
        # Σ w (y − xᵀβ)² over all folds, up to Σ w y², which does not depend on λ.
        tried = np.ascontiguousarray(along[:, :num_held_out].transpose(1, 2, 3, 0))
        of_cross = np.matmul(transposed[:num_held_out], cross[:num_held_out, ..., None])
        errors = (tried * (ridge.held_out @ tried - 2.0 * of_cross)).sum(axis=(0, 2)).T
        best = _last_smallest(errors.sum(axis=1, keepdims=True) if is_joint else errors)
    chosen = along[best, -1, np.arange(num_blocks)]
    coefficients = np.matmul(ridge.basis[-1], chosen[..., None])[..., 0]
    return coefficients, np.broadcast_to(ridge.regs[best], num_blocks).copy()


def _last_smallest(errors: Float[np.ndarray, "L K"]) -> Int[np.ndarray, " K"]:
    # Equal errors differ by rounding, which must not affect the choice.
    is_smallest = errors <= errors.min(axis=0) + TIE_TOLERANCE * np.abs(errors).max(axis=0)
    return len(errors) - 1 - np.argmax(is_smallest[::-1], axis=0)


def _leave_one_out(sums: Float[np.ndarray, " V *S"]) -> Float[np.ndarray, " V1 *S"]:
    total = sums.sum(axis=0, keepdims=True)
    # Without folds nothing is held out.
    return np.concatenate([total - sums, total]) if len(sums) > 1 else total


class Errors(NamedTuple):
    """Standard errors of a fit: that of xᵀβ is ‖Rᵀ x‖ · deviation, with R the root of each block."""

    root: Float[np.ndarray, "K F F"]
    deviation: Float[np.ndarray, " K"]


def standard_errors(
    ridge: Ridge,
    penalty: Float[np.ndarray, " K"],
    squares: Float[np.ndarray, " K"],
    counts: Float[np.ndarray, "3 K"],
    offset: float = 0.0,
) -> Errors:
    """Compute the standard errors of a fit.

    The degrees of freedom are the number of rows minus the effective number of coefficients.

    Parameters
    ----------
    ridge
        Of the observed rows, without folds.
    penalty
        nλ of each block.
    squares
        Σ w (y − xᵀβ)².
    counts
        Σw; Σw², for the effective number of rows; and the number of rows with positive weight.
    offset
        As for `ridge_of`.
    """
    values, (weight, of_squares, count) = ridge.values[0], counts
    mass, spread = np.maximum(values[:, 0], _TINY), values[:, 1:]
    least = 1e-8 * spread.max(axis=-1, keepdims=True, initial=0.0) + _TINY
    penalised = np.maximum(spread + penalty[:, None], least)
    held = mass + offset * penalty
    root = ridge.basis[0] / np.sqrt(np.column_stack([held, penalised]))[:, None, :]
    fitted = mass / held + np.sum(np.maximum(spread, 0.0) / penalised, axis=-1)
    left = count / np.maximum(count - fitted, 0.1 * count + 0.5)
    variance = left * squares / np.where(weight > 0, weight, 1.0)
    return Errors(root, np.sqrt(variance * of_squares / mass))
