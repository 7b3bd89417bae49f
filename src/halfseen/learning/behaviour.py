"""What a log does of itself: the behaviour policy, a conditional logit [McFadden1974]_ of its actions.

    b(a | S) ∝ exp(α_k + β_kᵀ φ(S, a)) over the actions that are possible in S,

with k the block of the action: on named actions that is the multinomial logistic regression on the covariates, on a
table one choice among all objects and verbs.

Where Q is taken at a lower confidence bound, doing what the log does needs no proof: it makes nothing worse than it
was. So the margin of an action is waived as far as the behaviour policy leans towards it (`excess_propensity`), and
only what leaves the behaviour policy must be better beyond doubt, as in safe policy improvement
[LarocheTrichelairTachet2019]_.

It is fitted by Newton steps of bounded length (`minimise_each`), which serve several smooth functions of few numbers at
once. Where one is not convex, the eigenvalues of its Hessian are taken by their size, so that each step leads downhill
[NocedalWright2006]_. A step that did not lower its function is taken again, shorter.

*Preference.* Where many actions share few stages, what the log does speaks where Q cannot (behaviour regularisation):

    argmax_a  Q̂(S, a) − margin + τ·log b(a | S)

is the policy of a Q that is regularised by the Kullback–Leibler divergence from b [WuTuckerNachum2019]_, at its mode.
Three things are not chosen but found:

- *b* is a multinomial logit, shrunk towards choosing evenly by as much as predicts held-out trajectories best. A log
  that chose evenly prefers nothing.
- *τ* = 2 σ √(p / n_a), two standard errors of Q: σ the noise of its targets, p the coefficients of an action, n_a its
  mean number of completed stages; at most 2 σ. It vanishes as a log grows.
- *Trust*: following b must not have hurt. The advantage A_t = R_t + V̂(S_{t+1}) − V̂(S_t) of the logged action, V̂ the
  value of b by least squares [BradtkeBarto1996]_, is correlated with how much b, fitted to other trajectories,
  preferred that action. With z the sum of the products by its standard error over trajectories, τ counts in full
  where z ≥ 0, and nothing where z ≤ −1.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import library_of
from halfseen.learning.rows import TrajectoryArrays
from halfseen.shapes import Bool, Float, Int

Thetas = Float[np.ndarray, "K p"]
Derivatives = tuple[Float[np.ndarray, " K"], Thetas, Float[np.ndarray, "K p p"]]
"""Of each function: its value, gradient and Hessian."""

MAX_STEPS = 200
ENOUGH = 1e-12
"""A step that promises less than this share of the value, and 1, is the last."""
LONGEST = 2.0
"""A step changes no number by more than this at first, and by no more than it later."""
_SHORTEST, _SHORTER, _LONGER = 1e-9, 0.25, 2.0


def minimise_each(derivatives: Callable[[Thetas], Derivatives], start: Thetas) -> Thetas:
    """Find a minimum of each of K functions from its own start, given the derivatives of all at K places."""
    theta, reach = start.copy(), np.full(len(start), LONGEST)
    value, gradient, hessian = derivatives(theta)
    for _ in range(MAX_STEPS):
        step = _downhill(gradient, hessian)
        promise = -(gradient * step).sum(axis=1)
        is_open = (promise > ENOUGH * (1.0 + np.abs(value))) & (reach > _SHORTEST)
        if not is_open.any():
            # What rounding hides in the values still shows in the gradients.
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
"""Coefficients of a choice whose curvature is worth its time; more are found by L-BFGS."""

RIDGE = 1.0
"""Penalty ½·RIDGE·‖β‖² on features of unit variance, beside a log-likelihood that is summed over rows."""

_FLAT = 1e-10
"""Share of the curvature that is added where the loss may be flat."""


def log_chances(
    utility: Float[np.ndarray, "*S A"], is_possible: Bool[np.ndarray, "*#S A"]
) -> Float[np.ndarray, "*S A"]:
    """Logarithm of how likely each action is [nat]; −inf where it is not possible."""
    among = np.where(is_possible, utility, -np.inf)
    among = among - among.max(axis=-1, keepdims=True)
    return among - np.log(np.exp(among).sum(axis=-1, keepdims=True))


def choice_probabilities(utility: Float[Any, "*S A"], is_possible: Bool[Any, "*#S A"]) -> Float[Any, "*S A"]:
    """How likely each action is; 0 where it is not possible."""
    xp = library_of(utility)
    among = xp.where(is_possible, utility, -xp.inf)
    odds = xp.exp(among - among.max(axis=-1, keepdims=True))
    return odds / odds.sum(axis=-1, keepdims=True)


def excess_propensity(utility: Float[Any, "*S A"], is_possible: Bool[Any, "*#S A"]) -> Float[Any, "*S A"]:
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
    """Coefficients of features as they were, the offset first."""
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
        # The loss may be flat along offsets: there the slope is 0, and so is the step.
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
    """Σ w (Σ_a p_a x_a x_aᵀ − x̄ x̄ᵀ), x of the block of each action and x̄ = Σ_a p_a x_a."""
    num_features = parts[0].shape[-1]
    means = [np.matmul(p[:, None, :], part)[:, 0] for p, part in zip(probability, parts, strict=True)]
    mean = np.concatenate(means, axis=1)
    curvature = -(mean * weight[:, None]).T @ mean
    for k, (p, part) in enumerate(zip(probability, parts, strict=True)):
        flat, own = part.reshape(-1, num_features), slice(k * num_features, (k + 1) * num_features)
        curvature[own, own] += flat.T @ (flat * (weight[:, None] * p).reshape(-1, 1))
    return curvature


RIDGES = (256.0, 64.0, 16.0, 4.0, 1.0)
"""Penalties ½·ridge·‖β‖² on standardised covariates and offsets, beside a summed log-likelihood."""
NUM_FOLDS = 5
VALUE_RIDGE = 3.0
"""Of V̂."""
STANDARD_ERRORS = 2.0
"""Of Q, for which a nat counts."""


class Preference(NamedTuple):
    """What the log prefers, and how much that counts."""

    behaviour: Float[np.ndarray, "A F1"]
    """Coefficients of b on the covariates, the offset first."""
    behaviour_weight: float
    """τ [reward a nat]; 0 where following b has hurt."""


class _Choices(NamedTuple):
    """Stages whose state and action are known."""

    covariates: Float[np.ndarray, "rows F"]
    """Standardised."""
    is_possible: Bool[np.ndarray, "rows A"]
    taken: Int[np.ndarray, " rows"]

    def at(self, rows: Bool[np.ndarray, " rows"]) -> "_Choices":
        return _Choices(*(each[rows] for each in self))

    def log_chances(self, beta: Float[np.ndarray, "A F1"]) -> Float[np.ndarray, "rows A"]:
        return log_chances(beta[:, 0] + self.covariates @ beta[:, 1:].T, self.is_possible)

    def fitted(self, ridge: float, start: Float[np.ndarray, "A F1"] | None = None) -> Float[np.ndarray, "A F1"]:
        """A multinomial logit, shrunk towards choosing evenly."""
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
        """How much likelier the action was than actions are on average, in nats."""
        finite = np.where(self.is_possible, log_chance, 0.0)
        expected = (np.where(self.is_possible, np.exp(log_chance), 0.0) * finite).sum(axis=1)
        return log_chance[np.arange(len(log_chance)), self.taken] - expected


def preference_of(trajectories: TrajectoryArrays, num_completed: int) -> Preference:
    """Find what a log of named actions prefers, by it or a sample of it; so many of its stages were completed."""
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
    """How much more than V̂ each completed stage brought; 0 for other stages.

    V̂ is linear in the stage, the covariates, standardised and 0 where no stage began, and their squares.
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
    """The ridge that predicts best what was held out, and what it predicts."""
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
