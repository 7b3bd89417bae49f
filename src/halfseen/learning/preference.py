"""Where many actions share few stages, what the log does speaks where Q cannot (behaviour regularisation).

    argmax_a  Q̂(S, a) − margin + τ·log b(a | S)

is the policy of a Q that is regularised by the Kullback–Leibler divergence from the behaviour policy b
[WuTuckerNachum2019]_, at its mode. Three things are not chosen but found:

- *b* is a multinomial logit, shrunk towards choosing evenly by as much as predicts held-out trajectories best. A log
  that chose evenly prefers nothing.
- *τ* = 2 σ √(p / n_a), two standard errors of Q: σ the noise of its targets, p the coefficients of an action, n_a its
  mean number of completed stages; at most 2 σ. It vanishes as a log grows.
- *Trust*: following b must not have hurt. The advantage A_t = R_t + V̂(S_{t+1}) − V̂(S_t) of the logged action, V̂ the
  value of b by least squares [BradtkeBarto1996]_, is correlated with how much b, fitted to other trajectories,
  preferred that action. With z the sum of the products by its standard error over trajectories, τ counts in full
  where z ≥ 0, and nothing where z ≤ −1.
"""

from typing import NamedTuple

import numpy as np

from halfseen.learning.behaviour import log_chances
from halfseen.learning.rows import TrajectoryArrays
from halfseen.shapes import Bool, Float, Int

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


def preference_of(trajectories: TrajectoryArrays, num_completed: int) -> Preference:
    """Find what a log of named actions prefers.

    Parameters
    ----------
    trajectories
        The log, or a sample of it.
    num_completed
        Completed stages of the whole log.
    """
    known = trajectories.is_begun & trajectories.has_action
    covariates = trajectories.features[..., 0, :]
    mean, spread = covariates[known].mean(axis=0), covariates[known].std(axis=0)
    scale = np.where(spread > 0, spread, 1.0)
    standard = np.where(trajectories.is_begun[..., None], (covariates - mean) / scale, 0.0)
    choices = _Choices(standard[known], trajectories.is_possible[known], trajectories.action[known])
    fold = np.broadcast_to(np.arange(len(known))[:, None] % NUM_FOLDS, known.shape)[known]
    ridge, held_out = _held_out(choices, fold)
    beta = _fitted(choices, ridge)
    slopes = beta[:, 1:] / scale
    advantage = advantages(trajectories, standard)
    num_actions, num_coefficients = beta.shape
    share = min(1.0, num_coefficients * num_actions / max(num_completed, 1))
    noise = float(np.sqrt(np.mean(advantage[trajectories.is_completed] ** 2)))
    lead = np.zeros(known.shape)
    lead[known] = _lead(held_out, choices)
    trust = float(np.clip(1.0 + _z((lead * advantage).sum(axis=1)), 0.0, 1.0))
    behaviour = np.column_stack([beta[:, 0] - slopes @ mean, slopes])
    return Preference(behaviour, trust * STANDARD_ERRORS * noise * share**0.5)


def advantages(trajectories: TrajectoryArrays, covariates: Float[np.ndarray, "n T F"]) -> Float[np.ndarray, "n T"]:
    """How much more than V̂ each completed stage brought; 0 for other stages.

    V̂ is linear in the stage, the covariates and their squares.

    Parameters
    ----------
    trajectories
        The log.
    covariates
        Standardised, 0 where no stage began.
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


def _z(each: Float[np.ndarray, " n"]) -> float:
    """The sum by its standard error; 0 where nothing varies."""
    error = float(np.sqrt((each**2).sum()))
    return float(each.sum()) / error if error > 0 else 0.0


def _lead(log_chance: Float[np.ndarray, "rows A"], choices: _Choices) -> Float[np.ndarray, " rows"]:
    """How much likelier the action was than actions are on average, in nats."""
    finite = np.where(choices.is_possible, log_chance, 0.0)
    expected = (np.where(choices.is_possible, np.exp(log_chance), 0.0) * finite).sum(axis=1)
    return log_chance[np.arange(len(log_chance)), choices.taken] - expected


def _held_out(choices: _Choices, fold: Int[np.ndarray, " rows"]) -> tuple[float, Float[np.ndarray, "rows A"]]:
    """The ridge that predicts best what was held out, and what it predicts."""
    each = np.zeros((len(RIDGES), *choices.is_possible.shape))
    for number in range(NUM_FOLDS):
        is_held_out, start = fold == number, None
        if is_held_out.all() or not is_held_out.any():
            continue
        for r, ridge in enumerate(RIDGES):
            start = _fitted(choices.at(~is_held_out), ridge, start)
            each[r, is_held_out] = _log_chances(start, choices.at(is_held_out))
    likelihood = each[:, np.arange(len(fold)), choices.taken].sum(axis=1)
    best = int(np.argmax(likelihood))
    return RIDGES[best], each[best]


def _log_chances(beta: Float[np.ndarray, "A F1"], choices: _Choices) -> Float[np.ndarray, "rows A"]:
    return log_chances(beta[:, 0] + choices.covariates @ beta[:, 1:].T, choices.is_possible)


def _fitted(
    choices: _Choices, ridge: float, start: Float[np.ndarray, "A F1"] | None = None
) -> Float[np.ndarray, "A F1"]:
    """A multinomial logit, shrunk towards choosing evenly."""
    import scipy.optimize

    rows, shape = np.arange(len(choices.taken)), (choices.is_possible.shape[1], choices.covariates.shape[1] + 1)
    design = np.column_stack([np.ones(len(rows)), choices.covariates])

    def loss_and_slope(flat: Float[np.ndarray, " P"]) -> tuple[float, Float[np.ndarray, " P"]]:
        beta = flat.reshape(shape)
        log_chance = _log_chances(beta, choices)
        miss = np.exp(log_chance)
        miss[rows, choices.taken] -= 1.0
        loss = -log_chance[rows, choices.taken].sum() + 0.5 * ridge * (flat @ flat)
        return float(loss), (miss.T @ design + ridge * beta).ravel()

    first = np.zeros(shape) if start is None else start
    return scipy.optimize.minimize(loss_and_slope, first.ravel(), jac=True, method="L-BFGS-B").x.reshape(shape)
