"""The model of the probability of a grasp: a given one, or the one that a log's attempts support.

*Default.* By default a table's features use the visible share times the rule of succession as the probability of a
grasp (`halfseen.tables.features`). That needs no data, and is right where hidden objects are hard to grip. Where they
are not, a cell's own attempts show it. So trajectories are split into cross-validation folds. `BetaGrasp` learns from
all but one fold and predicts the held-out attempts. It is chosen only if it at least halves the squared error, beyond
noise. A slightly better prediction is not enough. The visible share also predicts how much a look reveals and how long
an attempt takes. Under the assumed laws, features with the true probability of a grasp in its place earn less, although
their error is a quarter smaller. Under the law of the cell, where the Beta leaves a fifth of the error, they earn more.

*Robots that differ.* A Beta regression for each robot (`GraspByRobot`) is chosen only if it predicts held-out attempts
better than one for all robots, beyond noise.
"""

import warnings
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from halfseen.arrays import RowIds, RowMask, Rows, stacked
from halfseen.censoring import is_fitted
from halfseen.errors import ArgumentError, HalfseenError, HalfseenWarning
from halfseen.learning.behaviour import Derivatives, Thetas, minimise_each
from halfseen.logs import Logs
from halfseen.shapes import Bool, Float
from halfseen.tables import grasp_table
from halfseen.tables.features import succession
from halfseen.tables.grasp_attempts import DecidedAttempts, attempts, checked_attempts, checked_covariates, kinds
from halfseen.tables.grasp_models import Theta, fitted_thetas, predictive
from halfseen.tables.grasp_table import SURE, GraspByRobot, GraspEstimator, GraspTable, GripEffect
from halfseen.workers.threads import one_thread
from halfseen.world.log_checks import robots_in
from halfseen.world.policy import GraspModel

NUM_FOLDS = 5
WORTH = 0.5
"""Share of the rule's squared error that the Beta must remove."""
CLEARLY = 2.0
"""Standard errors by which the removed error must exceed that share."""
FEWEST_ATTEMPTS = 30
"""Fewest decided attempts for a choice."""
GRIP_SPREAD = np.array([1.0, 0.5])
"""Standard deviations of the normal prior on shift and per_grip, with mean 0."""
KEPT = "the probability of a grasp is by the rule of succession"
BY_ROBOT = (
    "the probability of a grasp is learned from each robot’s own attempts: held out, these predict better than "
    "the attempts of all"
)


class GraspChoice(NamedTuple):
    """The chosen model of the probability of a grasp, and the reason.

    Parameters
    ----------
    grasp
        A Beta regression as a table; None for the rule of succession.
    sentence
        The choice and the reason.
    """

    grasp: GraspTable | GraspByRobot | None
    sentence: str


def choose_grasp(logs: Logs, horizon: int) -> GraspChoice:
    """Choose by a log; the rule of succession if the outcomes of its attempts are unknown."""
    try:
        return choose_by(attempts(logs, horizon), horizon, robots_in(logs))
    except HalfseenError as error:
        return GraspChoice(None, f"{KEPT}: {error}")


def choose_by(tried: pd.DataFrame, horizon: int, num_robots: int = 1) -> GraspChoice:
    """Choose by attempts.

    `tried` is the result of `attempts`, with the robot of each attempt if there are several.

    Raises
    ------
    PositivityError
        A weight is not identified.
    """
    num_decided = int(tried["is_finished"].sum())
    if num_decided < FEWEST_ATTEMPTS:
        return GraspChoice(None, f"{KEPT}: {num_decided} decided attempts are too few to learn it")
    with warnings.catch_warnings(), one_thread():
        # These weights are internal, and the standard error accounts for their noise.
        warnings.simplefilter("ignore", HalfseenWarning)
        held = _HeldOut.of(tried)
        robot = (
            tried["robot"].to_numpy()[held.decided.row] if num_robots > 1 else np.zeros(len(held.trajectory), dtype=int)
        )
        is_of = np.ones((1, len(robot)), dtype=bool)
        if num_robots > 1 and np.bincount(robot, minlength=num_robots).min() >= FEWEST_ATTEMPTS:
            is_of = np.vstack([is_of, robot == np.arange(num_robots)[:, None]])
        thetas = held.fitted(is_of)
        said = np.stack([held.said(folds) for folds in thetas[:, :-1]])
        history = held.decided.history
        # The probability used by the features, with the full effect of the visible grip.
        by_rule = (1.0 - history.occlusion) * succession(history.successes, history.failures, held.grip)
        rule, beta = held.errors(by_rule), held.errors(said[0])
    if len(said) > 1 and _is_clear(beta - held.errors(said[1 + robot, np.arange(len(robot))])):
        shared, *own = [held.table(theta[-1], mine, horizon) for theta, mine in zip(thetas, is_of, strict=True)]
        return GraspChoice(GraspByRobot(shared, stacked(own)), BY_ROBOT)
    left = f"{beta.sum() / rule.sum():.0%} of the squared error"
    if not _is_clear((1.0 - WORTH) * rule - beta):
        why = f"{KEPT}: held out, a Beta regression does not clearly halve the error ({left} remains)"
        return GraspChoice(None, why)
    return GraspChoice(
        held.table(thetas[0, -1], is_of[0], horizon),
        "the probability of a grasp is learned from the log’s attempts: held out, a Beta regression predicts "
        f"better than the rule of succession, with {left}",
    )


def _is_clear(lead: Float[np.ndarray, " trajectories"]) -> bool:
    return bool(lead.mean() > CLEARLY * lead.std(ddof=1) / np.sqrt(len(lead)))


class _HeldOut(NamedTuple):
    """Decided attempts, whose trajectories are split into folds."""

    decided: DecidedAttempts
    trajectory: RowIds
    grip: Rows

    @classmethod
    def of(cls, tried: pd.DataFrame) -> "_HeldOut":
        decided = checked_attempts(tried)
        trajectory = np.unique(tried["trajectory"].to_numpy(), return_inverse=True)[1][decided.row]
        return cls(decided, trajectory, tried["grip"].to_numpy(dtype=np.float64)[decided.row])

    def fitted(self, is_of: Bool[np.ndarray, "G n"]) -> Float[np.ndarray, "G V 3"]:
        """Fit to each group of attempts: without the trajectories of each fold, and, last, to all."""
        is_kept = np.vstack([self.trajectory % NUM_FOLDS != np.arange(NUM_FOLDS)[:, None], np.ones_like(is_of[:1])])
        weight = (is_of[:, None] & is_kept) * self.decided.weight
        return fitted_thetas(self.decided, weight.reshape(-1, len(self.trajectory))).reshape(*weight.shape[:2], -1)

    def said(self, folds: Float[np.ndarray, "V 3"]) -> Rows:
        """Prediction of each attempt by the fit without its fold."""
        said = np.stack([predictive(theta, self.decided.history) for theta in folds])
        return said[self.trajectory % NUM_FOLDS, np.arange(len(self.trajectory))]

    def errors(self, said: Rows) -> Float[np.ndarray, " trajectories"]:
        """Squared errors, weighted and summed over the attempts of each trajectory."""
        squared = self.decided.weight * np.square(said - self.decided.succeeded)
        return np.bincount(self.trajectory, squared, self.trajectory.max() + 1)

    def table(self, theta: Theta, mine: RowMask, horizon: int) -> GraspTable:
        """Tabulate a fit to some attempts, with the effect of their grips."""
        own = self.decided.among(mine)
        effect = _fitted_effect(predictive(theta, own.history), own, self.grip[mine])
        return grasp_table.table_of(predictive(theta, grasp_table.every_history(horizon)), horizon, effect)


def grasp_model_of(grasp: Any, logs: Logs, horizon: int) -> GraspModel | None:
    """Make a grasp model that a policy can carry.

    None and a `GraspModel` are returned as they are. A grasp estimator is tabulated; if it is not fitted, a copy of it
    is first fitted to the attempts of the log.

    Raises
    ------
    ArgumentError
        `grasp` is none of these, or there are too few attempts to fit it.
    LogError
        The outcomes of the log's attempts are unknown.
    """
    if grasp is None or (isinstance(grasp, GraspModel) and not isinstance(grasp, type)):
        return grasp
    if isinstance(grasp, type) or not isinstance(grasp, GraspEstimator):
        raise ArgumentError(f"grasp is {grasp!r}; give None, BetaGrasp() or SVMGrasp(), fitted or not, or a GraspTable")
    if is_fitted(grasp):
        return grasp_table.tabulate(grasp, horizon)
    return grasp_model_by(grasp, attempts(logs, horizon), horizon)


def grasp_model_by(grasp: GraspEstimator, tried: pd.DataFrame, horizon: int) -> GraspModel:
    """Make a grasp model from a copy of an estimator, fitted to attempts; errors are those of `grasp_model_of`."""
    # The import takes longer than a decision, which does not need it.
    from sklearn.base import clone

    estimator: Any = clone(grasp)
    model = estimator.fit(tried)
    return grasp_table.tabulate(model, horizon, fit_grip_effect(model, tried))


def fit_grip_effect(model: GraspEstimator, tried: pd.DataFrame) -> GripEffect:
    """Fit the grip effect by maximum a posteriori to decided attempts, weighted by 1/Ĝ; no effect if all grips are 0.

    Raises
    ------
    ArgumentError
        A grip is not a finite number.
    PositivityError
        A weight is not identified.
    """
    decided = checked_attempts(tried)
    rows = tried.iloc[decided.row]
    return _fitted_effect(model.predict_proba(rows)[:, 1], decided, checked_covariates(rows, ["grip"])[:, 0])


def _fitted_effect(said: Rows, decided: DecidedAttempts, grip: Rows) -> GripEffect:
    """Fit the grip effect to a model's predictions of decided attempts without their grips."""
    from scipy.special import expit, logit

    if not grip.any():
        return GripEffect()
    first, kind = kinds(said, grip, decided.succeeded)
    weight = np.bincount(kind, decided.weight, len(first))
    logits, sign = logit(np.clip(said[first], SURE, 1.0 - SURE)), np.where(decided.succeeded[first], 1.0, -1.0)
    design = np.column_stack([np.ones(len(first)), grip[first]])

    def derivatives(theta: Thetas) -> Derivatives:
        margin, scaled = sign * (logits + theta @ design.T), theta / GRIP_SPREAD
        loss = np.logaddexp(0.0, -margin) @ weight + (scaled**2).sum(axis=1) / 2.0
        wrong = expit(-margin)
        bend = (weight * wrong * (1.0 - wrong))[:, :, None, None] * design[:, :, None] * design[:, None, :]
        gradient = scaled / GRIP_SPREAD - (weight * sign * wrong) @ design
        return loss, gradient, np.diag(GRIP_SPREAD**-2.0) + bend.sum(axis=1)

    shift, per_grip = minimise_each(derivatives, np.zeros((1, 2)))[0].tolist()
    return GripEffect(shift, per_grip)
