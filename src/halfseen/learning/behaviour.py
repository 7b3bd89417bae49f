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

*Preference.* If many actions share few stages, the behaviour policy decides where Q cannot (behaviour regularisation):

    argmax_a  Q̂(S, a) − margin + τ·log b(a | S)

is the mode of the policy whose Q is regularised by the Kullback–Leibler divergence from b [WuTuckerNachum2019]_. Three
quantities are estimated:

- *b* is a multinomial logit, shrunk towards uniform choice by the penalty that predicts held-out trajectories best. A
  log of uniform choices has no preference.
- *τ* = 2 σ √(p / n_a), two standard errors of Q: σ is the noise of its targets, p the number of coefficients of an
  action, n_a its mean number of completed stages; at most 2 σ. It vanishes as a log grows.
- *Trust*: following b must not have hurt. The advantage A_t = R_t + V̂(S_{t+1}) − V̂(S_t) of the logged action, V̂ the
  value of b by least squares [BradtkeBarto1996]_, is correlated with how much b, fitted to other trajectories,
  preferred that action. Let z be the sum of the products divided by its standard error over trajectories: τ counts
  fully where z ≥ 0, and not at all where z ≤ −1.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import library_of
from halfseen.learning.rows import TrajectoryArrays
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


def log_chances(
    utility: Float[np.ndarray, "*S A"], is_possible: Bool[np.ndarray, "*#S A"]
) -> Float[np.ndarray, "*S A"]:
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
    mean, scale = _mean_and_scale(features[is_possible])
    design = np.ones((*taken.shape, len(blocks), 1 + features.shape[-1]))
    design[..., 1:] = np.where(is_possible[..., None], (features - mean) / scale, 0.0)
    beta = _fitted_logit(design, is_possible, taken, blocks, np.ones(len(taken)) if weight is None else weight)
    return _unscaled(beta, mean, scale)


def _mean_and_scale(features: Float[np.ndarray, "rows F"]) -> tuple[Float[np.ndarray, " F"], Float[np.ndarray, " F"]]:
    mean, spread = features.mean(axis=0), features.std(axis=0)
    return mean, np.where(spread > 0, spread, 1.0)


def _unscaled(
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


RIDGES = (256.0, 64.0, 16.0, 4.0, 1.0)
"""Penalties ½·ridge·‖β‖² on standardised covariates and intercepts, added to a summed log-likelihood."""
NUM_FOLDS = 5
VALUE_RIDGE = 3.0
"""Ridge penalty of V̂."""
STANDARD_ERRORS = 2.0
"""τ in standard errors of Q."""


class Preference(NamedTuple):
    """The behaviour policy and the weight of its preference."""

    behaviour: Float[np.ndarray, "A F1"]
    """Coefficients of b on the covariates, the intercept first."""
    behaviour_weight: float
    """τ [reward per nat]; 0 if following b has hurt."""


class _Choices(NamedTuple):
    """Stages with known state and action."""

    covariates: Float[np.ndarray, "rows F"]
    """Standardised."""
    is_possible: Bool[np.ndarray, "rows A"]
    taken: Int[np.ndarray, " rows"]

    def at(self, rows: Bool[np.ndarray, " rows"]) -> "_Choices":
        return _Choices(*(each[rows] for each in self))

    def log_chances(self, beta: Float[np.ndarray, "A F1"]) -> Float[np.ndarray, "rows A"]:
        return log_chances(beta[:, 0] + self.covariates @ beta[:, 1:].T, self.is_possible)

    def fitted(self, ridge: float, start: Float[np.ndarray, "A F1"] | None = None) -> Float[np.ndarray, "A F1"]:
        """Fit a multinomial logit, shrunk towards uniform choice."""
        import scipy.optimize

        rows, shape = np.arange(len(self.taken)), (self.is_possible.shape[1], self.covariates.shape[1] + 1)
        design = np.column_stack([np.ones(len(rows)), self.covariates])

        def loss_and_slope(flat: Float[np.ndarray, " P"]) -> tuple[float, Float[np.ndarray, " P"]]:
            beta = flat.reshape(shape)
            log_chance = self.log_chances(beta)
            miss = np.exp(log_chance)
            miss[rows, self.taken] -= 1.0
            loss = -log_chance[rows, self.taken].sum() + 0.5 * ridge * (flat @ flat)
            return float(loss), (miss.T @ design + ridge * beta).ravel()

        first = np.zeros(shape) if start is None else start
        return scipy.optimize.minimize(loss_and_slope, first.ravel(), jac=True, method="L-BFGS-B").x.reshape(shape)

    def lead(self, log_chance: Float[np.ndarray, "rows A"]) -> Float[np.ndarray, " rows"]:
        """Log probability of the action taken, less its mean under the policy [nat]."""
        finite = np.where(self.is_possible, log_chance, 0.0)
        expected = (np.where(self.is_possible, np.exp(log_chance), 0.0) * finite).sum(axis=1)
        return log_chance[np.arange(len(log_chance)), self.taken] - expected


def preference_of(trajectories: TrajectoryArrays, num_completed: int) -> Preference:
    """Estimate the preference of a log of named actions from a sample; the log has `num_completed` completed stages."""
    known = trajectories.is_begun & trajectories.has_action
    covariates = trajectories.features[..., 0, :]
    mean, scale = _mean_and_scale(covariates[known])
    standard = np.where(trajectories.is_begun[..., None], (covariates - mean) / scale, 0.0)
    choices = _Choices(standard[known], trajectories.is_possible[known], trajectories.action[known])
    fold = np.broadcast_to(np.arange(len(known))[:, None] % NUM_FOLDS, known.shape)[known]
    ridge, held_out = _held_out(choices, fold)
    beta, advantage = choices.fitted(ridge), advantages(trajectories, standard)
    share = min(1.0, beta.size / max(num_completed, 1))
    noise = float(np.sqrt(np.mean(advantage[trajectories.is_completed] ** 2)))
    lead = np.zeros(known.shape)
    lead[known] = choices.lead(held_out)
    paid = (lead * advantage).sum(axis=1)
    error = float(np.sqrt((paid**2).sum()))
    trust = float(np.clip(1.0 + (float(paid.sum()) / error if error > 0 else 0.0), 0.0, 1.0))
    return Preference(_unscaled(beta, mean, scale), trust * STANDARD_ERRORS * noise * share**0.5)


def advantages(trajectories: TrajectoryArrays, covariates: Float[np.ndarray, "n T F"]) -> Float[np.ndarray, "n T"]:
    """Return above V̂ of each completed stage; 0 for other stages.

    V̂ is linear in the stage, in the covariates, which are standardised and 0 where no stage began, and in their
    squares.
    """
    done, horizon = trajectories.is_completed, covariates.shape[1]
    stage = np.broadcast_to(np.arange(horizon)[:, None] / horizon, (*covariates.shape[:2], 1))
    design = np.concatenate([np.ones_like(stage), stage, covariates, covariates**2], axis=-1)
    after = np.zeros_like(design)
    after[:, :-1] = design[:, 1:]
    goes_on = done & ~trajectories.is_last
    step = design[done] - np.where(goes_on[done][:, None], after[done], 0.0)
    penalty = VALUE_RIDGE * np.diag(np.arange(design.shape[-1]) > 0)
    value = np.linalg.lstsq(design[done].T @ step + penalty, design[done].T @ trajectories.reward[done], rcond=None)[0]
    found = np.zeros(done.shape)
    found[done] = trajectories.reward[done] - step @ value
    return found


def _held_out(choices: _Choices, fold: Int[np.ndarray, " rows"]) -> tuple[float, Float[np.ndarray, "rows A"]]:
    """Return the ridge penalty that predicts held-out trajectories best, and those predictions."""
    each = np.zeros((len(RIDGES), *choices.is_possible.shape))
    for number in range(NUM_FOLDS):
        is_held_out, start = fold == number, None
        if is_held_out.all() or not is_held_out.any():
            continue
        for r, ridge in enumerate(RIDGES):
            start = choices.at(~is_held_out).fitted(ridge, start)
            each[r, is_held_out] = choices.at(is_held_out).log_chances(start)
    likelihood = each[:, np.arange(len(fold)), choices.taken].sum(axis=1)
    best = int(np.argmax(likelihood))
    return RIDGES[best], each[best]
