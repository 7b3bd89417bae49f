"""The behaviour policy of a log, fitted as a conditional logit of its actions [McFadden1974]_.

    b(a | S) ∝ exp(α_k + β_kᵀ φ(S, a)) over the actions that are possible in S,

with k the block of the action. For named actions this is multinomial logistic regression on the covariates; for a table
it is one choice among all objects and verbs.

Where Q is taken at a lower confidence bound, following the behaviour policy needs no evidence, because it makes nothing
worse. So the margin of an action is reduced as far as the behaviour policy prefers it (`excess_propensity`). Only
deviations from it must be clearly better, as in safe policy improvement [LarocheTrichelairTachet2019]_.

The logit is fitted by Newton steps of bounded length (`minimise_each`), for several smooth functions of few variables
at once. Where a function is not convex, the absolute eigenvalues of its Hessian are used, so that each step is a
descent direction [NocedalWright2006]_. A step that did not lower its function is retried with a shorter length.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from halfseen.arrays import LEAST_RANGE, library_of
from halfseen.shapes import Bool, Float, Int

Thetas = Float[np.ndarray, "K p"]
Derivatives = tuple[Float[np.ndarray, " K"], Thetas, Float[np.ndarray, "K p p"]]
"""Value, gradient and Hessian of each function."""

MAX_STEPS = 200
ENOUGH = 1e-12
"""Stop after a step whose predicted decrease is below this fraction of 1 + |value|."""
LONGEST = 2.0
"""Initial and largest bound on the change of each variable in a step."""
_SHORTEST, _SHORTER, _LONGER = 1e-9, 0.25, 2.0


def minimise_each(derivatives: Callable[[Thetas], Derivatives], start: Thetas) -> Thetas:
    """Minimise each of K functions from its own start, given the derivatives of all at K points."""
    theta, reach = start.copy(), np.full(len(start), LONGEST)
    value, gradient, hessian = derivatives(theta)
    for _ in range(MAX_STEPS):
        step = _downhill(gradient, hessian)
        promise = -(gradient * step).sum(axis=1)
        is_open = (promise > ENOUGH * (1.0 + np.abs(value))) & (reach > _SHORTEST)
        if not is_open.any():
            # Decreases that rounding hides in the values still show in the gradients.
            return theta + np.where((reach > _SHORTEST)[:, None], step, 0.0)
        length = np.abs(step).max(axis=1)
        step = np.where(is_open[:, None], step * np.minimum(1.0, reach / np.maximum(length, _SHORTEST))[:, None], 0.0)
        tried = derivatives(theta + step)
        is_better = is_open & (tried[0] <= value)
        theta = np.where(is_better[:, None], theta + step, theta)
        value = np.where(is_better, tried[0], value)
        gradient = np.where(is_better[:, None], tried[1], gradient)
        hessian = np.where(is_better[:, None, None], tried[2], hessian)
        shorter = _SHORTER * np.minimum(reach, length)
        reach = np.where(is_better, np.minimum(_LONGER * reach, LONGEST), np.where(is_open, shorter, reach))
    return theta


def _downhill(gradient: Thetas, hessian: Float[np.ndarray, "K p p"]) -> Thetas:
    size, axes = np.linalg.eigh(hessian)
    along = np.einsum("kij,ki->kj", axes, gradient) / np.maximum(np.abs(size), np.finfo(float).tiny)
    return -np.einsum("kij,kj->ki", axes, along)


MOST_FOR_NEWTON = 1000
"""Largest number of coefficients for Newton steps, which need the curvature; above it, L-BFGS is used."""

RIDGE = 1.0
"""Penalty ½·RIDGE·‖β‖² on features of unit variance, added to a log-likelihood summed over rows."""

_FLAT = 1e-10
"""Fraction of the curvature added in case the loss is flat."""


def log_chances(utility: Float[Any, "*S A"], is_possible: Bool[Any, "*#S A"]) -> Float[Any, "*S A"]:
    """Log probability of each action [nat]; −inf where it is not possible."""
    among = np.where(is_possible, utility, -np.inf)
    among = among - among.max(axis=-1, keepdims=True)
    return among - np.log(np.exp(among).sum(axis=-1, keepdims=True))


def choice_probabilities(utility: Float[Any, "*S A"], is_possible: Bool[Any, "*#S A"]) -> Float[Any, "*S A"]:
    """Probability of each action; 0 where it is not possible."""
    xp = library_of(utility)
    among = xp.where(is_possible, utility, -xp.inf)
    odds = xp.exp(among - among.max(axis=-1, keepdims=True))
    return odds / odds.sum(axis=-1, keepdims=True)


def excess_propensity(utility: Float[Any, "*S A"], is_possible: Bool[Any, "*#S A"]) -> Float[Any, "*S A"]:
    """Excess of each action's probability over chance: 0 at a probability of 1/k or less, 1 at certainty.

    k is the number of possible actions.
    """
    xp = library_of(utility)
    chance = 1.0 / xp.maximum(is_possible.sum(axis=-1, keepdims=True), 2)
    return xp.clip((choice_probabilities(utility, is_possible) - chance) / (1.0 - chance), 0.0, 1.0)


def seen_among(allowed: Bool[Any, "*S A"], seen: Bool[Any, "*T A"]) -> Bool[Any, "*S A"]:
    """Restrict allowed actions to those with support; keep all allowed ones if none has it."""
    both = allowed & seen
    return both | (allowed & ~both.any(axis=-1, keepdims=True))


def fit_choice(
    features: Float[np.ndarray, "rows A F"],
    is_possible: Bool[np.ndarray, "rows A"],
    taken: Int[np.ndarray, " rows"],
    blocks: Int[np.ndarray, " A"],
    weight: Float[np.ndarray, " rows"] | None = None,
) -> Float[np.ndarray, "K F1"]:
    """Fit the choice of an action: coefficients of each block, the intercept first.

    Parameters
    ----------
    features
        φ(S, a).
    is_possible
        The possible actions.
    taken
        The chosen action.
    blocks
        Block of coefficients of each action.
    weight
        Weight of each row; None for 1.
    """
    mean, scale = mean_and_scale(features[is_possible])
    design = np.ones((*taken.shape, len(blocks), 1 + features.shape[-1]))
    design[..., 1:] = np.where(is_possible[..., None], (features - mean) / scale, 0.0)
    beta = _fitted_logit(design, is_possible, taken, blocks, np.ones(len(taken)) if weight is None else weight)
    return unscaled(beta, mean, scale)


def mean_and_scale(features: Float[np.ndarray, "rows F"]) -> tuple[Float[np.ndarray, " F"], Float[np.ndarray, " F"]]:
    """Mean and standard deviation of each feature; 1 instead of a deviation of 0, or of rounding alone."""
    mean, spread = features.mean(axis=0), features.std(axis=0)
    return mean, np.where(spread > LEAST_RANGE * np.abs(mean), spread, 1.0)


def unscaled(
    beta: Float[np.ndarray, "K F1"], mean: Float[np.ndarray, " F"], scale: Float[np.ndarray, " F"]
) -> Float[np.ndarray, "K F1"]:
    """Coefficients of the unscaled features, the intercept first."""
    slopes = beta[:, 1:] / scale
    return np.column_stack([beta[:, 0] - slopes @ mean, slopes])


def conditional_logit(
    features: Float[np.ndarray, "rows A F"],
    is_possible: Bool[np.ndarray, "rows A"],
    taken: Int[np.ndarray, " rows"],
    blocks: Int[np.ndarray, " A"],
    weight: Float[np.ndarray, " rows"] | None = None,
) -> Float[np.ndarray, "rows A"]:
    """Fit the choice of an action to rows of positive weight; return the probability of each action in every row."""
    fitted = np.ones(len(taken), dtype=bool) if weight is None else weight > 0
    weight = None if weight is None else weight[fitted]
    coefficients = fit_choice(features[fitted], is_possible[fitted], taken[fitted], blocks, weight)
    each = coefficients[blocks]
    return np.asarray(choice_probabilities(each[:, 0] + np.einsum("raf,af->ra", features, each[:, 1:]), is_possible))


def _fitted_logit(
    design: Float[np.ndarray, "rows A F"],
    is_possible: Bool[np.ndarray, "rows A"],
    taken: Int[np.ndarray, " rows"],
    blocks: Int[np.ndarray, " A"],
    weight: Float[np.ndarray, " rows"],
) -> Float[np.ndarray, "K F"]:
    """Coefficients of each block, the intercept first."""
    members = [np.flatnonzero(blocks == k) for k in range(int(blocks.max()) + 1)]
    parts = [np.ascontiguousarray(design[:, some]) for some in members]
    row, num_features = np.arange(len(taken)), design.shape[-1]
    penalty = RIDGE * np.tile(np.arange(num_features) > 0, len(members))

    def loss_and_slope(beta: Float[np.ndarray, " P"]) -> tuple[float, np.ndarray, np.ndarray]:
        utility = np.empty(is_possible.shape)
        for some, part, of_block in zip(members, parts, beta.reshape(len(members), -1), strict=True):
            utility[:, some] = part @ of_block
        log_probability = log_chances(utility, is_possible)
        loss = -(weight * log_probability[row, taken]).sum() + 0.5 * float(penalty @ beta**2)
        probability = np.exp(log_probability)
        miss = probability.copy()
        miss[row, taken] -= 1.0
        slope = [np.einsum("ra,raf->f", weight[:, None] * miss[:, m], x) for m, x in zip(members, parts, strict=True)]
        return loss, penalty * beta + np.concatenate(slope), probability

    def derivatives(at: Float[np.ndarray, "1 P"]) -> Derivatives:
        loss, slope, probability = loss_and_slope(at[0])
        curvature = _curvature([probability[:, some] for some in members], parts, weight) + np.diag(penalty)
        # The loss may be flat along intercepts: the slope is 0 there, and so is the step.
        curvature += _FLAT * np.diag(np.maximum(np.diag(curvature), 1.0))
        return np.array([loss]), slope[None], curvature[None]

    start = np.zeros(len(penalty))
    if len(start) <= MOST_FOR_NEWTON:
        return minimise_each(derivatives, start[None]).reshape(len(members), -1)
    import scipy.optimize

    found = scipy.optimize.minimize(lambda beta: loss_and_slope(beta)[:2], start, jac=True, method="L-BFGS-B")
    return found.x.reshape(len(members), -1)


def _curvature(
    probability: list[np.ndarray], parts: list[np.ndarray], weight: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, "P P"]:
    """Σ w (Σ_a p_a x_a x_aᵀ − x̄ x̄ᵀ), with x in the block of each action and x̄ = Σ_a p_a x_a."""
    num_features = parts[0].shape[-1]
    means = [np.matmul(p[:, None, :], part)[:, 0] for p, part in zip(probability, parts, strict=True)]
    mean = np.concatenate(means, axis=1)
    curvature = -(mean * weight[:, None]).T @ mean
    for k, (p, part) in enumerate(zip(probability, parts, strict=True)):
        flat, own = part.reshape(-1, num_features), slice(k * num_features, (k + 1) * num_features)
        curvature[own, own] += flat.T @ (flat * (weight[:, None] * p).reshape(-1, 1))
    return curvature
