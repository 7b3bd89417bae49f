"""What a log does of itself: the behaviour policy, a conditional logit [McFadden1974]_ of its actions.

    b(a | S) ∝ exp(α_k + β_kᵀ φ(S, a)) over the actions that are possible in S,

with k the block of the action: on named actions that is the multinomial logistic regression on the covariates, on a
table one choice among all objects and verbs.

Where Q is taken at a lower confidence bound, doing what the log does needs no proof: it makes nothing worse than it
was. So the margin of an action is waived as far as the behaviour policy leans towards it (`leaning`), and only what
leaves the behaviour policy must be better beyond doubt, as in safe policy improvement [LarocheTrichelairTachet2019]_.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.arrays import library_of

RIDGE = 1.0
"""Penalty ½·RIDGE·‖β‖² on features of unit variance, beside a log-likelihood that is summed over rows."""

_MOST_STEPS, _LEAST_SHARE, _TOLERANCE, _FLAT = 100, 1e-6, 1e-12, 1e-10
"""Newton's steps, the least share of one, the fall of the loss, as a share of it, that ends them, and the share of the
curvature that is added where the loss may be flat."""


def choice_probabilities(utility: Float[Any, "*S A"], is_possible: Bool[Any, "*#S A"]) -> Float[Any, "*S A"]:
    """How likely each action is; 0 where it is not possible."""
    xp = library_of(utility)
    among = xp.where(is_possible, utility, -xp.inf)
    odds = xp.exp(among - among.max(axis=-1, keepdims=True))
    return odds / odds.sum(axis=-1, keepdims=True)


def leaning(utility: Float[Any, "*S A"], is_possible: Bool[Any, "*#S A"]) -> Float[Any, "*S A"]:
    """How far the choice is from chance towards each action: 0 at one time in k or less, 1 at always.

    k counts the actions that there are to choose from.
    """
    xp = library_of(utility)
    chance = 1.0 / xp.maximum(is_possible.sum(axis=-1, keepdims=True), 2)
    return xp.clip((choice_probabilities(utility, is_possible) - chance) / (1.0 - chance), 0.0, 1.0)


def seen_among(allowed: Bool[Any, "*S A"], seen: Bool[Any, "*T A"]) -> Bool[Any, "*S A"]:
    """Keep the actions that were seen; all that are allowed where none was."""
    both = allowed & seen
    return both | (allowed & ~both.any(axis=-1, keepdims=True))


def fit_choice(
    features: Float[np.ndarray, "rows A F"],
    is_possible: Bool[np.ndarray, "rows A"],
    taken: Int[np.ndarray, " rows"],
    blocks: Int[np.ndarray, " A"],
    weight: Float[np.ndarray, " rows"] | None = None,
) -> Float[np.ndarray, "K F1"]:
    """Fit the choice of an action: coefficients of each block, the offset first.

    Parameters
    ----------
    features
        φ(S, a).
    is_possible
        What there was to choose from.
    taken
        What was chosen.
    blocks
        Block of coefficients of each action.
    weight
        Of each row; None for 1.
    """
    seen = features[is_possible]
    mean, spread = seen.mean(axis=0), seen.std(axis=0)
    scale = np.where(spread > 0, spread, 1.0)
    design = np.ones((*taken.shape, len(blocks), 1 + features.shape[-1]))
    design[..., 1:] = np.where(is_possible[..., None], (features - mean) / scale, 0.0)
    beta = _fitted_logit(design, is_possible, taken, blocks, np.ones(len(taken)) if weight is None else weight)
    slopes = beta[:, 1:] / scale
    return np.column_stack([beta[:, 0] - slopes @ mean, slopes])


def conditional_logit(
    features: Float[np.ndarray, "rows A F"],
    is_possible: Bool[np.ndarray, "rows A"],
    taken: Int[np.ndarray, " rows"],
    blocks: Int[np.ndarray, " A"],
    weight: Float[np.ndarray, " rows"] | None = None,
) -> Float[np.ndarray, "rows A"]:
    """Fit the choice of an action to the rows that weigh something, and return how likely each was in every row."""
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
    """Coefficients of each block, the offset first, by Newton's steps, halved until the loss falls."""
    members = [np.flatnonzero(blocks == k) for k in range(int(blocks.max()) + 1)]
    parts = [np.ascontiguousarray(design[:, some]) for some in members]
    row, num_features = np.arange(len(taken)), design.shape[-1]
    penalty = RIDGE * np.tile(np.arange(num_features) > 0, len(members))

    def judged(beta: np.ndarray) -> tuple[float, np.ndarray]:
        """Loss, and how likely each action is."""
        utility = np.empty(is_possible.shape)
        for some, part, of_block in zip(members, parts, beta.reshape(len(members), -1), strict=True):
            utility[:, some] = part @ of_block
        utility = np.where(is_possible, utility, -np.inf)
        log_probability = utility - _log_sum_exp(utility)
        loss = -(weight * log_probability[row, taken]).sum() + 0.5 * float(penalty @ beta**2)
        return loss, np.exp(log_probability)

    beta = np.zeros(len(members) * num_features)
    loss, probability = judged(beta)
    for _ in range(_MOST_STEPS):
        miss = probability.copy()
        miss[row, taken] -= 1.0
        slope = penalty * beta + np.concatenate(
            [np.einsum("ra,raf->f", weight[:, None] * miss[:, m], part) for m, part in zip(members, parts, strict=True)]
        )
        curvature = _curvature([probability[:, some] for some in members], parts, weight) + np.diag(penalty)
        # The loss may be flat along offsets: there the slope is 0, and so is the step.
        step = np.linalg.solve(curvature + _FLAT * np.diag(np.maximum(np.diag(curvature), 1.0)), slope)
        fall, share = float(slope @ step), 1.0
        if fall <= _TOLERANCE * (1.0 + loss):
            break
        found = judged(beta - step)
        while share > _LEAST_SHARE and not found[0] <= loss - 0.25 * share * fall:
            share /= 2.0
            found = judged(beta - share * step)
        if not found[0] < loss:
            break
        beta, (loss, probability) = beta - share * step, found
    return beta.reshape(len(members), -1)


def _log_sum_exp(utility: Float[np.ndarray, "rows A"]) -> Float[np.ndarray, "rows 1"]:
    largest = utility.max(axis=1, keepdims=True)
    return largest + np.log(np.exp(utility - largest).sum(axis=1, keepdims=True))


def _curvature(
    probability: list[np.ndarray], parts: list[np.ndarray], weight: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, "P P"]:
    """Σ w (Σ_a p_a x_a x_aᵀ − x̄ x̄ᵀ), x of the block of each action and x̄ = Σ_a p_a x_a."""
    num_features = parts[0].shape[-1]
    means = [np.matmul(p[:, None, :], part)[:, 0] for p, part in zip(probability, parts, strict=True)]
    mean = np.concatenate(means, axis=1)
    curvature = -(mean * weight[:, None]).T @ mean
    for k, (p, part) in enumerate(zip(probability, parts, strict=True)):
        flat, own = part.reshape(-1, num_features), slice(k * num_features, (k + 1) * num_features)
        curvature[own, own] += flat.T @ (flat * (weight[:, None] * p).reshape(-1, 1))
    return curvature
