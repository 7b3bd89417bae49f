"""How likely the logging policy was to take what it took: as logged, or estimated.

The estimate is a conditional logit [McFadden1974]_,

    b(a | S_t) ∝ exp(α_k + β_kᵀ φ(S_t, a)) over the actions that are possible in S_t,

with k the block of the action: on named actions that is the multinomial logistic regression on the covariates, on a
table one choice among all objects and verbs. Each stage has its own, or pooled stages share one.
"""

from typing import Literal, get_args

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import minimize
from scipy.special import logsumexp

from halfseen.errors import ArgumentError, LogError
from halfseen.learners.q_learning.path_arrays import PathArrays

Propensity = Literal["logged", "estimated"]

RIDGE = 1.0
"""Penalty ½·RIDGE·‖β‖² on features of unit variance, beside a log-likelihood that is summed over rows."""


def check_propensity(propensity: str) -> None:
    """Refuse what is neither ``"logged"`` nor ``"estimated"``."""
    if propensity not in get_args(Propensity):
        raise ArgumentError(f"propensity is {propensity!r}; it is 'logged' or 'estimated'")


def logged_propensity(paths: PathArrays, is_needed: Bool[np.ndarray, "n T"]) -> Float[np.ndarray, "n T"]:
    """Take the column ``probability``; 1 where it is not needed.

    Raises
    ------
    LogError
        It is null where it is needed; path and stage are named.
    """
    missing = is_needed & np.isnan(paths.probability)
    if missing.any():
        path, stage = np.argwhere(missing)[0]
        raise LogError(
            f"path {paths.path_ids[path]}, stage {stage + 1}: its probability was not logged, so how likely its "
            "action was is not known; log it, or estimate it with propensity 'estimated'"
        )
    return np.where(is_needed, paths.probability, 1.0)


def estimated_propensity(
    paths: PathArrays, is_needed: Bool[np.ndarray, "n T"], blocks: Int[np.ndarray, " A"], is_pooled: bool
) -> Float[np.ndarray, "n T"]:
    """Estimate b(A_t | S_t) from the actions of all stages that are known; 1 where it is not needed.

    Parameters
    ----------
    paths
        The log.
    is_needed
        Stages that are asked about.
    blocks
        Block of coefficients of each action.
    is_pooled
        One model for all stages, instead of one for each.
    """
    known = paths.is_begun & paths.has_action
    likely = np.ones(known.shape)
    num_stages = known.shape[1]
    for stages in [slice(None)] if is_pooled else [slice(t, t + 1) for t in range(num_stages)]:
        rows = np.zeros_like(known)
        rows[:, stages] = known[:, stages]
        if rows.any():
            taken = paths.action[rows]
            each = conditional_logit(paths.features[rows], paths.is_possible[rows], taken, blocks)
            likely[rows] = each[np.arange(len(taken)), taken]
    return np.where(is_needed, likely, 1.0)


def conditional_logit(
    features: Float[np.ndarray, "rows A F"],
    is_possible: Bool[np.ndarray, "rows A"],
    taken: Int[np.ndarray, " rows"],
    blocks: Int[np.ndarray, " A"],
    weight: Float[np.ndarray, " rows"] | None = None,
) -> Float[np.ndarray, "rows A"]:
    """Fit the choice of an action, and return how likely each was; 0 where not possible.

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
        Of each row; those of weight 0 are not fitted to, and answered all the same. None for 1.
    """
    seen = features[is_possible]
    spread = seen.std(axis=0)
    scaled = np.where(is_possible[..., None], (features - seen.mean(axis=0)) / np.where(spread > 0, spread, 1.0), 0.0)
    design = np.concatenate([np.ones((*taken.shape, len(blocks), 1)), scaled], axis=-1)
    weight = np.ones(len(taken)) if weight is None else weight
    fitted = weight > 0
    beta = _fitted_logit(design[fitted], is_possible[fitted], taken[fitted], blocks, weight[fitted])
    utility = _utility(design, is_possible, beta, blocks)
    return np.exp(utility - logsumexp(utility, axis=1, keepdims=True))


def _utility(design: np.ndarray, is_possible: np.ndarray, beta: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    of_block = design @ beta.T
    return np.where(is_possible, of_block[:, np.arange(len(blocks)), blocks], -np.inf)


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
        utility = _utility(design, is_possible, beta, blocks)
        log_probability = utility - logsumexp(utility, axis=1, keepdims=True)
        miss = np.exp(log_probability)
        miss[row, taken] -= 1.0
        of_block = (membership[:, None] * (weight[:, None] * miss)).reshape(shape[0], -1)
        slope = of_block @ design.reshape(-1, shape[1])
        penalty = beta.copy()
        penalty[:, 0] = 0.0
        value = -(weight * log_probability[row, taken]).sum() + 0.5 * RIDGE * float((penalty**2).sum())
        return value, (slope + RIDGE * penalty).ravel()

    fit = minimize(loss, np.zeros(shape[0] * shape[1]), jac=True, method="L-BFGS-B", options={"maxiter": 500})
    return fit.x.reshape(shape)
