"""One backward step of eq. 3: sums over rows → weighted ridge regression in blocks → Q, and how well it is known.

*Sums.* Those of the parts of a log add up to those of the whole. An imputed target Y is linear in the coefficients of
the regression of X (`rows.Imputation`), which are known only once all parts were read. So Σ w x Y is kept as what it is
of the share of X, and what it is for each coefficient.

*Ridge.* For each block (a verb, or an action)

    minimise over α, β:  λ ‖β‖² + (1/n) Σ_rows w · (y − α − xᵀβ)²,

with n the number of *paths*, x scaled to unit weighted variance in its block, and the offset α left free; λ is chosen
by weighted cross-validation over paths. Held-out errors follow from the sums by fold, so that trying all λ costs no
second pass over the rows. In an RKHS, where x are features of the kernel, x keeps its scale, and ‖β‖² is the norm of
the function.

*Standard errors* are behind the lower confidence bound of Q (*pessimism*). A block's Q̂(x) = α + βᵀφ(x) rests on the
completed stages of its actions. With C their centred Gram matrix, N their weight, λ the ridge and σ² the variance of
their targets about Q̂,

    s²(x) = σ² (1/N + zᵀ (C + nλ I)⁻¹ z),    z = (φ(x) − mean) / scale,

the variance of a ridge regression read as Bayes does (in an RKHS, of a Gaussian process), so that it grows where no
completed stage is near [AbbasiYadkori2011]_ [JinYangWang2021]_. Imputed targets of cut stages count as nothing seen.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from halfseen.learning.rows import QFunctions, Rows


class Bound(NamedTuple):
    """How far Q is lowered: by ‖Rᵀ (1, φ)‖ of each block, times `margin`."""

    root: Float[np.ndarray, "K F F"]
    margin: Float[np.ndarray, " K"]


class Successor(NamedTuple):
    """What V̂(S_{t+1}) is made of."""

    slices: tuple[int, ...]
    """Those that hold S_{t+1}."""
    coefficients: Float[np.ndarray, "K F"]
    bound: Bound | None
    forced: int | None = None
    """The action that is taken, whatever Q says: the one that the horizon forces upon a path."""


class Step(NamedTuple):
    """One backward step."""

    slices: tuple[int, ...]
    """Those that are fitted."""
    successor: Successor | None
    """None where nothing follows."""
    centre: Float[np.ndarray, "K F"] | None
    """What coefficients are shrunk towards, those of control variates among them; None for 0."""


class Shape(NamedTuple):
    """Of the sums."""

    num_folds: int
    num_blocks: int
    is_pessimistic: bool


class OutcomeGrams(NamedTuple):
    """Of imputed targets: the regression of X, and how Σ w x Y depends on its coefficients."""

    gram: Float[np.ndarray, "V K M M"]
    of_state: Float[np.ndarray, "V K F M1"]
    """Σ w x (1 − share) xᵀ, for the coefficients of the features."""
    of_time: Float[np.ndarray, "V K F G"]
    """Σ w x expectedᵀ, for those of the terms."""


class SeenGrams(NamedTuple):
    """Of the completed stages, for pessimism."""

    gram: Float[np.ndarray, "K F F"]
    weights: Float[np.ndarray, "3 K"]
    """Σw; Σw², as heavy weights make of many stages few; and the number of stages with a weight."""


class Grams(NamedTuple):
    """Sums that no target changes."""

    main: Float[np.ndarray, "V K F F"]
    outcome: OutcomeGrams | None
    seen: SeenGrams | None


class SeenCrosses(NamedTuple):
    """Of the completed stages: Σ w x X and Σ w X²."""

    cross: Float[np.ndarray, "K F"]
    square: Float[np.ndarray, " K"]


class Crosses(NamedTuple):
    """Sums that depend on the targets X."""

    main: Float[np.ndarray, "V K F"]
    """Of X, or of its share in imputed targets, less what the centre says."""
    outcome: Float[np.ndarray, "V K M"] | None
    seen: SeenCrosses | None


def _weights(rows: Rows) -> Float[np.ndarray, "4 R"]:
    """What rows weigh in the main sums, in those of what the state tells of Y, of completed stages, and of X."""
    weight = rows.weight
    if rows.share is None or rows.outcome_weight is None:
        return np.broadcast_to(weight, (4, len(weight)))
    of_outcome = np.where(weight > 0, rows.outcome_weight, 0.0)
    return np.stack([weight, weight * (1.0 - rows.share), weight * rows.outcome_weight, of_outcome])


def grams_of(rows: Rows, slices: tuple[int, ...], shape: Shape) -> Grams:
    """Sum up what no target changes over the rows of some slices.

    Parameters
    ----------
    rows
        A part of the log.
    slices
        Which.
    shape
        Of the sums.
    """
    weights, width = _weights(rows), rows.matrix.shape[1]
    moments = np.zeros((len(weights), shape.num_folds, shape.num_blocks, width, width))
    sums = np.zeros((3, shape.num_blocks))
    for which, fold, block, begin, end in rows.groups:
        if which in slices:
            for each, found in _moments(rows.matrix[begin:end], weights[:, begin:end]):
                moments[each, fold, block] += found
            seen = weights[2, begin:end]
            sums[:, block] += seen.sum(), seen @ seen, np.count_nonzero(seen)
    num_features, num_variates, num_terms, _ = rows.widths
    num_design = num_features + num_variates
    terms = slice(num_design, num_design + num_terms)
    main, seen = moments[0, :, :, :num_design, :num_design], None
    if shape.is_pessimistic:
        seen = SeenGrams(moments[2, :, :, :num_design, :num_design].sum(axis=0), sums)
    if rows.is_used is None:
        return Grams(main, None, seen)
    is_outcome = np.r_[:num_features, terms]
    used = np.concatenate([rows.is_used, np.ones(num_terms)])
    outcome = OutcomeGrams(
        gram=moments[3][:, :, is_outcome[:, None], is_outcome] * used[:, None] * used,
        of_state=moments[1, :, :, :num_design, :num_features] * rows.is_used,
        of_time=moments[0, :, :, :num_design, terms.stop :],
    )
    return Grams(main, outcome, seen)


def _moments(
    matrix: Float[np.ndarray, "r M"], weights: Float[np.ndarray, "4 r"]
) -> Iterator[tuple[list[int], Float[np.ndarray, "M M"]]]:
    """Σ w z zᵀ for several weights: those that are the same are summed once, and those that are 0 not at all."""
    left = [number for number, weight in enumerate(weights) if weight.any()]
    while left:
        weight = weights[left[0]]
        same = [number for number in left if (weights[number] == weight).all()]
        weighted = matrix if (weight == 1.0).all() else matrix * weight[:, None]
        yield same, matrix.T @ weighted
        left = [number for number in left if number not in same]


def crosses_of(rows: Rows, step: Step, values: Float[np.ndarray, " R1"], shape: Shape) -> Crosses:
    """Sum up what depends on the targets over the rows of a step.

    Parameters
    ----------
    rows
        A part of the log.
    step
        The step.
    values
        V̂ of the state of every row, and 0.
    shape
        Of the sums.
    """
    weights, num_design = _weights(rows), int(rows.widths[:2].sum())
    width = int(rows.widths[:3].sum())
    sums = np.zeros((shape.num_folds, shape.num_blocks, width, 3))
    squares = np.zeros(shape.num_blocks)
    for which, fold, block, begin, end in rows.groups:
        if which not in step.slices:
            continue
        group = slice(begin, end)
        target = rows.reward[group] + values[rows.after[group]]
        of_share = target if rows.share is None else rows.share[group] * target
        if step.centre is not None:
            of_share = of_share - rows.design[group] @ step.centre[block]
        of_seen = weights[2, group] * target
        each = np.array([weights[0, group] * of_share, weights[3, group] * target, of_seen]).T
        sums[fold, block] += rows.matrix[group, :width].T @ each
        squares[block] += of_seen @ target
    seen = SeenCrosses(sums[:, :, :num_design, 2].sum(axis=0), squares) if shape.is_pessimistic else None
    if rows.is_used is None:
        return Crosses(sums[:, :, :num_design, 0], None, seen)
    of_terms = slice(num_design, width)
    outcome = np.concatenate([sums[:, :, : rows.widths[0], 1] * rows.is_used, sums[:, :, of_terms, 1]], axis=-1)
    return Crosses(sums[:, :, :num_design, 0], outcome, seen)


def plus(one: Any, other: Any) -> Any:
    """Add up the sums of two parts; None is nothing yet."""
    if one is None or other is None:
        return other if one is None else one
    if isinstance(one, tuple):
        each = (plus(*pair) for pair in zip(one, other, strict=True))
        return type(one)(*each) if hasattr(one, "_fields") else type(one)(each)
    return one + other


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


def _unit_roots(factor: Factor, penalty: Float[np.ndarray, " K"]) -> Float[np.ndarray, "K F F"]:
    """R of every block, s(x) = ‖Rᵀ (1, φ(x))‖, for targets of which one effective stage varies by 1 about Q̂.

    Parameters
    ----------
    factor
        Of the completed stages, without folds.
    penalty
        nλ of each block.
    """
    gram, mass = factor.gram[0], _mass(factor)
    slopes = factor.eigenvectors[0] / factor.scale[..., None] / np.sqrt(_penalised(factor, penalty))[:, None, :]
    found = np.zeros_like(gram)
    found[:, 0, 0] = 1.0 / np.sqrt(mass)
    found[:, 0, 1:] = -np.einsum("kf,kfe->ke", gram[:, 0, 1:] / mass[:, None], slopes)
    found[:, 1:, 1:] = slopes
    return found


def _deviations(
    factor: Factor,
    weights: Float[np.ndarray, "3 K"],
    penalty: Float[np.ndarray, " K"],
    squares: Float[np.ndarray, " K"],
) -> Float[np.ndarray, " K"]:
    """What R is times its `_unit_roots`, for each block; `squares` are Σ w (X − Q̂)² of the completed stages.

    As many stages as there are coefficients that λ leaves are used up by the fit.
    """
    mass, of_squares, count = weights
    fitted = 1.0 + np.sum(np.maximum(factor.eigenvalues[0], 0.0) / _penalised(factor, penalty), axis=-1)
    left = count / np.maximum(count - fitted, 0.1 * count + 0.5)
    variance = left * squares / np.where(mass > 0, mass, 1.0)
    return np.sqrt(variance * of_squares / _mass(factor))


def _penalised(factor: Factor, penalty: Float[np.ndarray, " K"]) -> Float[np.ndarray, "K F1"]:
    eigenvalues = factor.eigenvalues[0]
    largest = eigenvalues.max(axis=-1, keepdims=True, initial=0.0)
    return np.maximum(eigenvalues + penalty[:, None], 1e-8 * largest + np.finfo(float).tiny)


def _mass(factor: Factor) -> Float[np.ndarray, " K"]:
    return np.maximum(factor.gram[0, :, 0, 0], np.finfo(float).tiny)


class StepFit(NamedTuple):
    """Q of one step."""

    q: QFunctions
    coefficients: Float[np.ndarray, "K F"]
    """Those of control variates, which Q leaves out, come last."""
    bound: Bound | None = None
    """With pessimism, how far Q is lowered by one standard error."""


class Equations(NamedTuple):
    """The normal equations of a step, factorised once for all targets."""

    grams: Grams
    main: Factor
    outcome: Factor | None
    seen: Factor | None
    """Of the completed stages, without folds."""
    num_features: int
    """Of Q, the offset among them; what comes after it are control variates."""

    @classmethod
    def of(cls, grams: Grams, is_scaled: bool, num_features: int) -> "Equations":
        """Factorise the sums of all parts."""
        outcome, seen = None, None
        if grams.outcome is not None:
            gram = with_prior(grams.outcome.gram, grams.outcome.of_time.shape[-1])
            outcome = factorise(gram, is_scaled)
        if grams.seen is not None:
            gram = grams.seen.gram[None, :, :num_features, :num_features]
            seen = factorise(gram, is_scaled)
        return cls(grams, factorise(grams.main, is_scaled), outcome, seen, num_features)


def fit_step(
    equations: Equations,
    crosses: Crosses,
    centre: Float[np.ndarray, "K F"] | None,
    regs: Float[np.ndarray, " L"],
    num_paths: int,
) -> StepFit:
    """Fit Q of one step.

    Parameters
    ----------
    equations
        Of all parts.
    crosses
        Of all parts.
    centre
        What coefficients are shrunk towards; None for 0.
    regs
        The λ to choose from.
    num_paths
        n, of all parts together.
    """
    cross, outcome, grams = crosses.main, None, equations.grams
    if grams.outcome is not None and equations.outcome is not None and crosses.outcome is not None:
        num_terms = grams.outcome.of_time.shape[-1]
        outcome = solve(equations.outcome, crosses.outcome, regs, num_paths).coefficients
        cross = cross + np.einsum("vkfm,km->vkf", grams.outcome.of_state, outcome[:, :-num_terms])
        cross = cross + np.einsum("vkfg,kg->vkf", grams.outcome.of_time, outcome[:, -num_terms:])
    fit = solve(equations.main, cross, regs, num_paths)
    coefficients = fit.coefficients if centre is None else fit.coefficients + centre
    found = QFunctions(coefficients[:, : equations.num_features], fit.reg, outcome)
    if equations.seen is None or grams.seen is None or crosses.seen is None:
        return StepFit(found, coefficients)
    penalty = fit.reg * num_paths
    unit_root = _unit_roots(equations.seen, penalty)
    squares = _squared_residuals(grams.seen, crosses.seen, coefficients)
    deviation = _deviations(equations.seen, grams.seen.weights, penalty, squares)
    root = unit_root * deviation[:, None, None]
    return StepFit(found._replace(root=root), coefficients, Bound(unit_root, deviation))


def _squared_residuals(
    grams: SeenGrams, crosses: SeenCrosses, coefficients: Float[np.ndarray, "K F"]
) -> Float[np.ndarray, " K"]:
    """Σ w (X − βᵀx)² of the completed stages."""
    explained = 2.0 * np.sum(coefficients * crosses.cross, axis=-1)
    quadratic = np.einsum("kf,kfg,kg->k", coefficients, grams.gram, coefficients)
    return np.maximum(crosses.square - explained + quadratic, 0.0)
