"""What a log prefers: where many actions share few stages, the policy stays near the behaviour policy.

If many actions share few stages, the behaviour policy decides where Q cannot (behaviour regularisation):

    argmax_a  Q̂(S, a) − margin + τ·log b(a | S)

is the mode of the policy whose Q is regularised by the Kullback–Leibler divergence from b [WuTuckerNachum2019]_. Three
quantities are estimated:

- *b* is a multinomial logit, shrunk towards uniform choice by the penalty that predicts held-out trajectories best. A
  log of uniform choices has no preference. If the logged probabilities tell apart what was preferred and what was only
  explored, b is fitted to the former.
- *τ* = 2 σ √(p / n_a), two standard errors of Q: σ is the noise of its targets, p the number of coefficients of an
  action, n_a its mean number of completed stages; at most 2 σ. It vanishes as a log grows.
- *Trust*: following b must not have hurt. The advantage A_t = R_t + V̂(S_{t+1}) − V̂(S_t) of the logged action, V̂ the
  value of b by least squares [BradtkeBarto1996]_, is correlated with how much b, fitted to other trajectories,
  preferred that action. Let z be the sum of the products divided by its standard error over trajectories: τ counts
  fully where z ≥ 0, and not at all where z ≤ −1.
"""

from typing import NamedTuple

import numpy as np

from halfseen.learning.behaviour import log_chances, mean_and_scale, unscaled
from halfseen.learning.rows import TrajectoryArrays
from halfseen.shapes import Bool, Float, Int

RIDGES = (256.0, 64.0, 16.0, 4.0, 1.0)
"""Penalties ½·ridge·‖β‖² on standardised covariates and intercepts, added to a summed log-likelihood."""
NUM_FOLDS = 5
VALUE_RIDGE = 3.0
"""Ridge penalty of V̂."""
STANDARD_ERRORS = 2.0
"""τ in standard errors of Q."""
CLEARLY, ABOUT = 2.0, 0.1
"""Factor of a probability over chance that shows a preference, and tolerance of its number of actions in a state."""


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
    weight: Float[np.ndarray, " rows"]

    def at(self, rows: Bool[np.ndarray, " rows"]) -> "_Choices":
        return _Choices(*(each[rows] for each in self))

    def log_chances(self, beta: Float[np.ndarray, "A F1"]) -> Float[np.ndarray, "rows A"]:
        return log_chances(beta[:, 0] + self.covariates @ beta[:, 1:].T, self.is_possible)

    def fitted(self, ridge: float, start: Float[np.ndarray, "A F1"] | None = None) -> Float[np.ndarray, "A F1"]:
        """Fit a weighted multinomial logit, shrunk towards uniform choice."""
        import scipy.optimize

        rows, shape = np.arange(len(self.taken)), (self.is_possible.shape[1], self.covariates.shape[1] + 1)
        design = np.column_stack([np.ones(len(rows)), self.covariates])

        def loss_and_slope(flat: Float[np.ndarray, " P"]) -> tuple[float, Float[np.ndarray, " P"]]:
            beta = flat.reshape(shape)
            log_chance = self.log_chances(beta)
            miss = np.exp(log_chance)
            miss[rows, self.taken] -= 1.0
            miss *= self.weight[:, None]
            loss = -self.weight @ log_chance[rows, self.taken] + 0.5 * ridge * (flat @ flat)
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
    mean, scale = mean_and_scale(covariates[known])
    standard = np.where(trajectories.is_begun[..., None], (covariates - mean) / scale, 0.0)
    weight = _weights(trajectories.probability[known], trajectories.is_possible[known])
    choices = _Choices(standard[known], trajectories.is_possible[known], trajectories.action[known], weight)
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
    return Preference(unscaled(beta, mean, scale), trust * STANDARD_ERRORS * noise * share**0.5)


def _weights(
    probability: Float[np.ndarray, " rows"], is_possible: Bool[np.ndarray, "rows A"]
) -> Float[np.ndarray, " rows"]:
    """1 for stages in which the log did what it prefers, 0 where it explored; 1 for all if that cannot be told.

    It can if every state has one action that is `CLEARLY` times as probable as chance, so that N = 1, with N the mean
    of 1{b(A | S) is so large} / b(A | S), up to `ABOUT` and two standard errors.
    """
    likely, chance = np.nan_to_num(probability), 1.0 / np.maximum(is_possible.sum(axis=1), 1)
    is_preferred = likely > CLEARLY * chance
    number = np.where(is_preferred, 1.0 / np.where(is_preferred, likely, 1.0), 0.0)
    error = number.std() / np.sqrt(len(number))
    is_told = is_preferred.any() and abs(number.mean() - 1.0) <= ABOUT + 2.0 * error
    return is_preferred.astype(np.float64) if is_told else np.ones(len(likely))


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
    likelihood = each[:, np.arange(len(fold)), choices.taken] @ choices.weight
    best = int(np.argmax(likelihood))
    return RIDGES[best], each[best]
