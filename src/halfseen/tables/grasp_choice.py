"""What tells the probability of a grasp: what is given, or what a log's own attempts speak for.

*Where nothing is said.* A table's features take a grasp to succeed with the share in sight times the rule of succession
(`halfseen.tables.features`). That needs no data, and is right where what is hidden is hard to grip. A cell in which it
is not so shows it in its own attempts. So trajectories are dealt into folds; `BetaGrasp` learns from all but one and
foretells the attempts of that one, and it is taken only where that at least halves the squared error, beyond noise. To
foretell a little better is not enough. The share in sight also says how much a look shows and how long an attempt
takes, and under the assumed laws features with the true probability of a grasp in its place earn less, though their
error is a fourth smaller; under the law of the cell, where the Beta leaves a fifth of it, they earn more.

*Where the robots of a team differ.* A Beta of each robot's own attempts is taken (`GraspByRobot`) only where it
foretells held-out attempts better than one of all, beyond noise.
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
from halfseen.tables.grasp_attempts import Decided, attempts, checked_attempts, checked_covariates, kinds
from halfseen.tables.grasp_models import Theta, fitted_thetas, predictive
from halfseen.tables.grasp_table import SURE, GraspByRobot, GraspEstimator, GraspTable, GripEffect
from halfseen.workers.threads import one_thread
from halfseen.world.log_checks import robots_in
from halfseen.world.policy import GraspModel

NUM_FOLDS = 5
WORTH = 0.5
"""Share of the rule's squared error that the Beta must take away."""
CLEARLY = 2.0
"""Standard errors by which it must take away more than that."""
FEWEST_ATTEMPTS = 30
"""Decided attempts below which there is nothing to choose by."""
GRIP_SPREAD = np.array([1.0, 0.5])
"""Standard deviations of the normal prior on shift and per_grip, about 0: few attempts say little of either."""
KEPT = "the probability of a grasp is the rule of succession’s"
BY_ROBOT = (
    "the probability of a grasp is learned from each robot’s own attempts: held out, these foretell them better than "
    "those of all"
)


class GraspChoice(NamedTuple):
    """What tells the probability of a grasp, and why.

    Parameters
    ----------
    grasp
        A Beta regression, as policies hold it; None for the rule of succession.
    sentence
        What was chosen and why.
    """

    grasp: GraspTable | GraspByRobot | None
    sentence: str


def choose_grasp(logs: Logs, horizon: int) -> GraspChoice:
    """Choose by a log; the rule of succession where it does not tell what became of its attempts."""
    try:
        return choose_by(attempts(logs, horizon), horizon, robots_in(logs))
    except HalfseenError as error:
        return GraspChoice(None, f"{KEPT}: {error}")


def choose_by(tried: pd.DataFrame, horizon: int, num_robots: int = 1) -> GraspChoice:
    """Choose by attempts.

    `tried` is as `attempts` gives it, with the robot of each if there are several.

    Raises
    ------
    PositivityError
        A weight is not identified.
    """
    num_decided = int(tried["is_finished"].sum())
    if num_decided < FEWEST_ATTEMPTS:
        return GraspChoice(None, f"{KEPT}: {num_decided} decided attempts are too few to learn it from")
    with warnings.catch_warnings(), one_thread():
        # Nobody asked for these weights, and the standard error tells how much they are worth.
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
        # What the features say: they take what shows of a grip in full.
        by_rule = (1.0 - history.occlusion) * succession(history.successes, history.failures, held.grip)
        rule, beta = held.errors(by_rule), held.errors(said[0])
    if len(said) > 1 and _is_clear(beta - held.errors(said[1 + robot, np.arange(len(robot))])):
        shared, *own = [held.table(theta[-1], mine, horizon) for theta, mine in zip(thetas, is_of, strict=True)]
        return GraspChoice(GraspByRobot(shared, stacked(own)), BY_ROBOT)
    left = f"{beta.sum() / rule.sum():.0%} of its squared error"
    if not _is_clear((1.0 - WORTH) * rule - beta):
        why = f"{KEPT}: held out, a Beta regression does not clearly halve its error (it leaves {left})"
        return GraspChoice(None, why)
    return GraspChoice(
        held.table(thetas[0, -1], is_of[0], horizon),
        "the probability of a grasp is learned from the log’s attempts: held out, a Beta regression foretells them "
        f"better than the rule of succession, with {left}",
    )


def _is_clear(lead: Float[np.ndarray, " trajectories"]) -> bool:
    return bool(lead.mean() > CLEARLY * lead.std(ddof=1) / np.sqrt(len(lead)))


class _HeldOut(NamedTuple):
    """Decided attempts, whose trajectories are dealt into folds."""

    decided: Decided
    trajectory: RowIds
    grip: Rows

    @classmethod
    def of(cls, tried: pd.DataFrame) -> "_HeldOut":
        decided = checked_attempts(tried)
        trajectory = np.unique(tried["trajectory"].to_numpy(), return_inverse=True)[1][decided.row]
        return cls(decided, trajectory, tried["grip"].to_numpy(dtype=np.float64)[decided.row])

    def fitted(self, is_of: Bool[np.ndarray, "G n"]) -> Float[np.ndarray, "G V 3"]:
        """Fit to each of some groups of attempts: without the trajectories of each fold, and, last, to all."""
        is_kept = np.vstack([self.trajectory % NUM_FOLDS != np.arange(NUM_FOLDS)[:, None], np.ones_like(is_of[:1])])
        weight = (is_of[:, None] & is_kept) * self.decided.weight
        return fitted_thetas(self.decided, weight.reshape(-1, len(self.trajectory))).reshape(*weight.shape[:2], -1)

    def said(self, folds: Float[np.ndarray, "V 3"]) -> Rows:
        """What is foretold of each attempt by the fit without its fold."""
        said = np.stack([predictive(theta, self.decided.history) for theta in folds])
        return said[self.trajectory % NUM_FOLDS, np.arange(len(self.trajectory))]

    def errors(self, said: Rows) -> Float[np.ndarray, " trajectories"]:
        """Squared errors, weighted and summed over the attempts of each trajectory."""
        squared = self.decided.weight * np.square(said - self.decided.succeeded)
        return np.bincount(self.trajectory, squared, self.trajectory.max() + 1)

    def table(self, theta: Theta, mine: RowMask, horizon: int) -> GraspTable:
        """Tabulate a fit to some attempts, with what their grips count beside it."""
        own = self.decided.among(mine)
        effect = _fitted_effect(predictive(theta, own.history), own, self.grip[mine])
        return grasp_table.table_of(predictive(theta, grasp_table.every_history(horizon)), horizon, effect)


def grasp_model_of(grasp: Any, logs: Logs, horizon: int) -> GraspModel | None:
    """Make a grasp model that a policy can carry.

    None and a `GraspModel` are taken as they are. A grasp estimator is tabulated, and first fitted to the attempts
    of the log (as a copy) if it is not fitted.

    Raises
    ------
    ArgumentError
        `grasp` is none of these, or the attempts do not suffice to fit it.
    LogError
        The log does not tell what became of its attempts.
    """
    if grasp is None or (isinstance(grasp, GraspModel) and not isinstance(grasp, type)):
        return grasp
    if isinstance(grasp, type) or not isinstance(grasp, GraspEstimator):
        raise ArgumentError(
            f"grasp is {grasp!r}; it is None, BetaGrasp(), SVMGrasp(), either of them fitted, or a GraspTable"
        )
    if is_fitted(grasp):
        return grasp_table.tabulate(grasp, horizon)
    return grasp_model_by(grasp, attempts(logs, horizon), horizon)


def grasp_model_by(grasp: GraspEstimator, tried: pd.DataFrame, horizon: int) -> GraspModel:
    """Make one of an estimator, a copy of which is fitted to attempts; it raises what `grasp_model_of` does."""
    # It takes longer to import than a decision, which does not come here.
    from sklearn.base import clone

    estimator: Any = clone(grasp)
    model = estimator.fit(tried)
    return grasp_table.tabulate(model, horizon, fit_grip_effect(model, tried))


def fit_grip_effect(model: GraspEstimator, tried: pd.DataFrame) -> GripEffect:
    """Fit by maximum a posteriori to decided attempts, weighted by 1/Ĝ; no effect where no grip was ever seen.

    Raises
    ------
    ArgumentError
        A grip is no finite number.
    PositivityError
        A weight is not identified.
    """
    decided = checked_attempts(tried)
    rows = tried.iloc[decided.row]
    return _fitted_effect(model.predict_proba(rows)[:, 1], decided, checked_covariates(rows, ["grip"])[:, 0])


def _fitted_effect(said: Rows, decided: Decided, grip: Rows) -> GripEffect:
    """Fit to what a model says of decided attempts without their grips."""
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
