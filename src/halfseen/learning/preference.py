"""What a log prefers, and how far the policy follows it.

*Few actions.* The margin of an action is reduced as far as the log prefers it (`behaviour`), unless what it prefers
clearly earned less: unless the mean over trajectories of

    Σ_t δ_t / Ĝ(U_t⁻) · A_t · (ℓ(A_t | S_t) − Σ_a b(a | S_t) ℓ(a | S_t)),

with A_t the advantage below, ℓ the excess propensity and Ĝ by Kaplan and Meier, is negative by two standard errors.

*Many actions.* If many actions share few stages, the behaviour policy decides where Q cannot (behaviour
regularisation):

    argmax_a  Q̂(S, a) − margin + τ·log b(a | S)

is the mode of the policy whose Q is regularised by the Kullback–Leibler divergence from b [WuTuckerNachum2019]_. Two
quantities are estimated:

- *b* is a multinomial logit, shrunk towards uniform choice by the penalty that predicts held-out trajectories best. If
  the logged probabilities tell apart what was preferred and what was only explored, b is fitted to the former. A log
  has no preference, τ = 0, unless b predicts other trajectories better than uniform choice by a standard error.
- *τ* weighs two predictors of what an action earns. The advantage A_t = R_t + V̂(S_{t+1}) − V̂(S_t) of the logged
  action, V̂ the value of the logging policy by least squares [BradtkeBarto1996]_, is regressed on how far the action
  leads the log's average one in Q̂ and in log b, both fitted to other trajectories [Breiman1996]_. Q̂ below its median
  in a state counts as the median: such an action is not taken, and Q̂ may be far too low there.

      A_t ≈ c · lead of Q̂ + κ · lead of log b,    τ = (κ + s_κ)⁺ / (c − 2 s_c),

  with standard errors s over trajectories, so that in doubt the log is followed. τ is at most 2 σ, σ² the mean of A_t²,
  and 2 σ if c is not clearly positive. The largest Q̂ errs more than others. So τ is doubled as often as held-out
  advantages of what the policy would do, weighted by inverse probability, clearly grow.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from halfseen.learning.behaviour import excess_propensity, log_chances, mean_and_scale, unscaled
from halfseen.learning.judging import FEWEST_HELD_OUT, q_of_stages
from halfseen.learning.q_model import QModel
from halfseen.learning.recursion import fit_q
from halfseen.learning.rows import TrajectoryArrays
from halfseen.learning.targets import Weighted
from halfseen.shapes import Bool, Float, Int
from halfseen.workers.threads import one_thread

RIDGES = (256.0, 64.0, 16.0, 4.0, 1.0)
"""Penalties ½·ridge·‖β‖² on standardised covariates and intercepts, added to a summed log-likelihood."""
NUM_FOLDS, NUM_FOLDS_OF_Q = 5, 2
VALUE_RIDGE = 3.0
"""Ridge penalty of V̂."""
STANDARD_ERRORS = 2.0
"""By which c is lowered; that make an advantage clear; and σ in the largest τ."""
MULTIPLES = 2.0 ** np.arange(5)
"""Multiples of τ that are tried."""
LEAST_PROBABILITY = 0.01
"""Lower bound of the probability by which an advantage is divided."""
CLEARLY, ABOUT = 2.0, 0.1
"""Factor of a probability over chance that shows a preference, and tolerance of its number of actions in a state."""


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

    def logged(self, log_chance: Float[np.ndarray, "rows A"]) -> Float[np.ndarray, "rows A"]:
        """Probabilities of the logging policy: b, and chance where the log explores."""
        preferred, chance = float(self.weight.mean()), self.is_possible / self.is_possible.sum(axis=1, keepdims=True)
        return preferred * np.exp(log_chance) + (1.0 - preferred) * chance

    def of_taken(self, each: Float[np.ndarray, "rows A"]) -> Float[np.ndarray, " rows"]:
        return each[np.arange(len(each)), self.taken]

    def lead(
        self, each: Float[np.ndarray, "rows A"], logged: Float[np.ndarray, "rows A"]
    ) -> Float[np.ndarray, " rows"]:
        """Value of the action taken, less its mean under the logging policy."""
        finite = np.where(self.is_possible, each, 0.0)
        return self.of_taken(finite) - (logged * finite).sum(axis=1)

    def has_preference(self, log_chance: Float[np.ndarray, "rows A"], of_trajectory: Int[np.ndarray, " rows"]) -> bool:
        """Whether b predicts the actions of other trajectories better than uniform choice, by a standard error."""
        more = self.weight * (self.of_taken(log_chance) + np.log(self.is_possible.sum(axis=1)))
        each = np.bincount(of_trajectory, more)
        return bool(each.sum() > np.sqrt((each**2).sum()))

    def followed(
        self, q: Float[np.ndarray, "rows A"], tau: float, log_chance: Float[np.ndarray, "rows A"]
    ) -> Bool[np.ndarray, "M rows"]:
        """Whether the action taken is that of argmax Q̂ + τ·log b, for each multiple of τ."""
        scores = (np.where(self.is_possible, q + times * tau * log_chance, -np.inf) for times in MULTIPLES)
        return np.array([each.argmax(axis=1) == self.taken for each in scores])


class Stacked(NamedTuple):
    """How far held-out Q̂ and log b predict advantages: c and κ, and their standard errors over trajectories."""

    coefficients: Float[np.ndarray, " 2"]
    errors: Float[np.ndarray, " 2"]

    def weight(self, most: float) -> float:
        """τ [reward per nat]."""
        of_q = self.coefficients[0] - STANDARD_ERRORS * self.errors[0]
        of_log = max(self.coefficients[1] + self.errors[1], 0.0)
        return float(min(of_log / of_q, most)) if of_q > 0 else most * float(of_log > 0)


def with_preference(model: QModel, trajectories: TrajectoryArrays) -> tuple[QModel, tuple[str, ...]]:
    """Decide from a log or a sample of it how far to follow what it prefers; return the model and what was found.

    With many actions, b and τ are estimated. With few, b is dropped if what the log prefers clearly earned less.
    """
    if not model.has_many_actions:
        return _without_costly(model, trajectories)
    known, (standard, mean, scale) = trajectories.is_begun & trajectories.has_action, _standardised(trajectories)
    weight = _weights(trajectories.probability[known], trajectories.is_possible[known])
    choices = _Choices(standard[known], trajectories.is_possible[known], trajectories.action[known], weight)
    of_trajectory, done = np.nonzero(known)[0], trajectories.is_completed[known]
    ridge, log_b = _held_out(choices, of_trajectory % NUM_FOLDS)
    q, logged = _held_out_q(model, trajectories)[known], choices.logged(log_b)
    advantage = np.where(done, advantages(trajectories, standard)[known], 0.0)
    leads = np.column_stack(
        [choices.lead(each, logged)[done] for each in (at_least_median(q, choices.is_possible), log_b)]
    )
    found = stacked(leads, advantage[done], of_trajectory[done])
    tau = found.weight(STANDARD_ERRORS * float(np.sqrt(np.mean(advantage[done] ** 2))))
    if not choices.has_preference(log_b, of_trajectory):
        tau = 0.0
    if tau > 0:
        chance = trajectories.probability[known]
        chance = np.maximum(np.where(np.isnan(chance), choices.of_taken(logged), chance), LEAST_PROBABILITY)
        tau *= MULTIPLES[clearly_best(choices.followed(q, tau, log_b) * advantage / chance, of_trajectory)]
    behaviour = unscaled(choices.fitted(ridge), mean, scale)
    return replace(model, behaviour=behaviour, behaviour_weight=float(tau)), (_in_words(found, tau),)


def _without_costly(model: QModel, trajectories: TrajectoryArrays) -> tuple[QModel, tuple[str, ...]]:
    """Drop b if the actions that it prefers clearly earned less than others."""
    if model.behaviour is None or not model.task.is_shared or not _prefers(model.behaviour, trajectories):
        return model, ()
    gain = gains_of_preferred(model.behaviour, trajectories)
    if gain.sum() >= -STANDARD_ERRORS * np.sqrt((gain**2).sum()):
        return model, ()
    why = "the margin of Q is not reduced for actions that the log often takes: they earned less than others"
    return replace(model, behaviour=None), (why,)


def _prefers(behaviour: Float[np.ndarray, "A F1"], trajectories: TrajectoryArrays) -> bool:
    """Whether b describes the completed stages better than uniform choice, by Akaike's criterion."""
    choices = _completed(trajectories)
    more = choices.of_taken(choices.log_chances(behaviour)) + np.log(choices.is_possible.sum(axis=1))
    return bool(more.sum() > behaviour[1:].size)


def gains_of_preferred(behaviour: Float[np.ndarray, "A F1"], trajectories: TrajectoryArrays) -> Float[np.ndarray, " n"]:
    """Sum over the stages of each trajectory of what an action earned, times how much the log prefers it."""
    done, choices = trajectories.is_completed, _completed(trajectories)
    log_b = choices.log_chances(behaviour)
    lead = choices.lead(excess_propensity(log_b, choices.is_possible), np.exp(log_b))
    by_kaplan_meier = Weighted()
    weight = by_kaplan_meier.weights(trajectories, by_kaplan_meier.fit_cuts(trajectories.clocks))
    advantage = advantages(trajectories, _standardised(trajectories)[0], weight)
    return np.bincount(np.nonzero(done)[0], (weight * advantage)[done] * lead, trajectories.num_trajectories)


def _completed(trajectories: TrajectoryArrays) -> _Choices:
    """Completed stages, with covariates as they are."""
    done = trajectories.is_completed
    covariates, possible = trajectories.features[done][:, 0], trajectories.is_possible[done]
    return _Choices(covariates, possible, trajectories.action[done], np.ones(int(done.sum())))


def _standardised(
    trajectories: TrajectoryArrays,
) -> tuple[Float[np.ndarray, "n T F"], Float[np.ndarray, " F"], Float[np.ndarray, " F"]]:
    """Covariates of the stages that began, standardised, 0 elsewhere; their means and scales."""
    covariates = trajectories.features[..., 0, :]
    mean, scale = mean_and_scale(covariates[trajectories.is_begun & trajectories.has_action])
    return np.where(trajectories.is_begun[..., None], (covariates - mean) / scale, 0.0), mean, scale


def _in_words(found: Stacked, tau: float) -> str:
    if tau == 0:
        return "the logging policy has no weight: it prefers no actions, or they earned no more"
    return (
        f"the logging policy counts {tau:.3g} of reward for each factor of e in its probability of an action: held "
        f"out, differences in Q were {found.coefficients[0]:.2g} ± {found.errors[0]:.2g} of what they promised"
    )


def stacked(
    leads: Float[np.ndarray, "rows 2"], advantage: Float[np.ndarray, " rows"], of_trajectory: Int[np.ndarray, " rows"]
) -> Stacked:
    """Regress advantages on the leads of the actions taken, with standard errors by trajectories."""
    inverse = np.linalg.pinv(leads.T @ leads)
    coefficients = inverse @ (leads.T @ advantage)
    score = np.zeros((int(of_trajectory.max(initial=0)) + 1, leads.shape[1]))
    np.add.at(score, of_trajectory, leads * (advantage - leads @ coefficients)[:, None])
    return Stacked(coefficients, np.sqrt(np.diag(inverse @ (score.T @ score) @ inverse)))


def at_least_median(
    q: Float[np.ndarray, "rows A"], is_possible: Bool[np.ndarray, "rows A"]
) -> Float[np.ndarray, "rows A"]:
    """Raise Q̂ to its median over the possible actions of a state."""
    return np.maximum(q, np.nanmedian(np.where(is_possible, q, np.nan), axis=1, keepdims=True))


def clearly_best(gain: Float[np.ndarray, "M rows"], of_trajectory: Int[np.ndarray, " rows"]) -> int:
    """Index of the policy whose gain over the first has the largest lower bound, one standard error below it."""
    more = np.stack([np.bincount(of_trajectory, each) for each in gain - gain[0]])
    return int(np.argmax(more.mean(axis=1) - more.std(axis=1) / more.shape[1] ** 0.5))


def _held_out_q(model: QModel, trajectories: TrajectoryArrays) -> Float[np.ndarray, "n T A"]:
    """Q̂ of every action, fitted to other trajectories; 0 if there are too few."""
    log = model.transitions(trajectories)
    num_trajectories, _, num_actions = log.is_possible.shape
    found, regression = np.zeros(log.is_possible.shape), model.regression(num_trajectories, num_actions)
    if num_trajectories < FEWEST_HELD_OUT:
        return found
    fold = np.random.default_rng([model.random_state, 5]).permutation(num_trajectories) % NUM_FOLDS_OF_Q
    with one_thread():
        for k in range(NUM_FOLDS_OF_Q):
            fits = fit_q(log.counted((fold != k).astype(np.float64)), regression)
            found[fold == k] = q_of_stages(fits, log, regression.block_of_action, model.stages)[fold == k]
    return found


def _weights(
    probability: Float[np.ndarray, " rows"], is_possible: Bool[np.ndarray, "rows A"]
) -> Float[np.ndarray, " rows"]:
    """1 for stages in which the log did what it prefers, 0 where it explored; 1 for all if that is not clear.

    It can if every state has one action that is `CLEARLY` times as probable as chance, so that N = 1, with N the mean
    of 1{b(A | S) is so large} / b(A | S), up to `ABOUT` and two standard errors.
    """
    likely, chance = np.nan_to_num(probability), 1.0 / np.maximum(is_possible.sum(axis=1), 1)
    is_preferred = likely > CLEARLY * chance
    number = np.where(is_preferred, 1.0 / np.where(is_preferred, likely, 1.0), 0.0)
    error = number.std() / np.sqrt(len(number))
    is_clear = is_preferred.any() and abs(number.mean() - 1.0) <= ABOUT + 2.0 * error
    return is_preferred.astype(np.float64) if is_clear else np.ones(len(likely))


def advantages(
    trajectories: TrajectoryArrays,
    covariates: Float[np.ndarray, "n T F"],
    weight: Float[np.ndarray, "n T"] | None = None,
) -> Float[np.ndarray, "n T"]:
    """Return above V̂ of each completed stage; 0 for other stages.

    V̂ is linear in the stage, in the covariates, which are standardised and 0 where no stage began, and in their
    squares. It is fitted to completed stages, weighted if weights are given.
    """
    done, horizon = trajectories.is_completed, covariates.shape[1]
    stage = np.broadcast_to(np.arange(horizon)[:, None] / horizon, (*covariates.shape[:2], 1))
    design = np.concatenate([np.ones_like(stage), stage, covariates, covariates**2], axis=-1)
    after = np.zeros_like(design)
    after[:, :-1] = design[:, 1:]
    goes_on = done & ~trajectories.is_last
    step = design[done] - np.where(goes_on[done][:, None], after[done], 0.0)
    penalty = VALUE_RIDGE * np.diag(np.arange(design.shape[-1]) > 0)
    weighted = design[done].T if weight is None else design[done].T * weight[done]
    value = np.linalg.lstsq(weighted @ step + penalty, weighted @ trajectories.reward[done], rcond=None)[0]
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
