"""What a log does of itself: the behaviour policy, a conditional logit [McFadden1974]_ of its actions.

    b(a | S) ∝ exp(α_k + β_kᵀ φ(S, a)) over the actions that are possible in S,

with k the block of the action: on named actions that is the multinomial logistic regression on the covariates, on a
table one choice among all objects and verbs.

Where Q is taken at a lower confidence bound, doing what the log does needs no proof: it makes nothing worse than it
was. So the margin of an action is waived as far as the behaviour policy leans towards it (`leaning`), and only what
leaves the behaviour policy must be better beyond doubt, as in safe policy improvement [LarocheTrichelairTachet2019]_.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import logsumexp

from halfseen.learners.q_learning.choice import choice_probabilities
from halfseen.learners.q_learning.path_arrays import PathArrays

RIDGE = 1.0
"""Penalty ½·RIDGE·‖β‖² on features of unit variance, beside a log-likelihood that is summed over rows."""


def behaviour_of(paths: PathArrays, blocks: Int[np.ndarray, " A"]) -> Float[np.ndarray, "K F"]:
    """Fit the behaviour policy to all stages of a log whose action is known: coefficients, the offset first.

    Parameters
    ----------
    paths
        The log.
    blocks
        Block of coefficients of each action.
    """
    known = paths.is_begun & paths.has_action
    return fit_choice(paths.features[known], paths.is_possible[known], paths.action[known], blocks)


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
    """Coefficients of each block, the offset first."""
    membership = (np.arange(int(blocks.max()) + 1)[:, None] == blocks).astype(np.float64)
    row = np.arange(len(taken))
    shape = (len(membership), design.shape[-1])

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        beta = flat.reshape(shape)
        of_block = design @ beta.T
        utility = np.where(is_possible, of_block[:, np.arange(len(blocks)), blocks], -np.inf)
        log_probability = utility - logsumexp(utility, axis=1, keepdims=True)
        miss = np.exp(log_probability)
        miss[row, taken] -= 1.0
        of_block = (membership[:, None] * (weight[:, None] * miss)).reshape(shape[0], -1)
        slope = of_block @ design.reshape(-1, shape[1])
        penalty = beta.copy()
        penalty[:, 0] = 0.0
        value = -(weight * log_probability[row, taken]).sum() + 0.5 * RIDGE * float((penalty**2).sum())
        return value, (slope + RIDGE * penalty).ravel()

    # A decision does not come here, and the import takes longer than it.
    from scipy.optimize import minimize

    fit = minimize(loss, np.zeros(shape[0] * shape[1]), jac=True, method="L-BFGS-B", options={"maxiter": 500})
    return fit.x.reshape(shape)
