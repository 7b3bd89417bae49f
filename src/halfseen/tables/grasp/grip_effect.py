"""What shows of a grip, beside a model of grasps that does not look at it.

A cell sees more of an object than how much of it is hidden: that it lies, that it is wide, that there is no room. Its
law makes of that the mean of the object's grip offset (`halfseen.world.state`). How much of the mean counts beside
occlusion and past attempts is learned from the attempts themselves:

    P(held | p, grip) = expit(logit p + shift + per_grip · grip),

with p what the model says without it. The offset itself varies about its mean, and that pulls log-odds together: under
a spread σ by about √(1 + 0.35 σ²) [ZegerLiangAlbert1988]_. So `per_grip` lies between 0 and 1.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.special import expit, logit

from halfseen.arrays import Rows
from halfseen.learning.newton_each import Derivatives, Thetas, minimise_each
from halfseen.tables.grasp.inputs import Decided, checked_attempts, checked_covariates, kinds
from halfseen.tables.grasp.protocol import GraspEstimator

SPREAD = np.array([1.0, 0.5])
"""Standard deviations of the normal prior on shift and per_grip, about 0: few attempts say little of either."""

SURE = 1e-9
"""A probability is taken to be no nearer than this to 0 or 1."""


class GripEffect(NamedTuple):
    """How the mean grip offset of an object moves the log-odds of a grasp.

    Parameters
    ----------
    shift
        Added whatever the grip: it stands for the mean grip of the attempts that the model was fitted to.
    per_grip
        Added for each unit of the grip.
    """

    shift: float = 0.0
    per_grip: float = 0.0

    def moved(self, probability: Rows, grip: Rows | float) -> Rows:
        """P(held) given the grip, from what a model says without it."""
        return expit(logit(np.clip(probability, SURE, 1.0 - SURE)) + self.shift + self.per_grip * grip)


IN_FULL = GripEffect(per_grip=1.0)
"""A grip counts as it is."""


def fit_grip_effect(model: GraspEstimator, tried: pd.DataFrame) -> GripEffect:
    """Fit by maximum a posteriori to decided attempts, weighted by 1/Ĝ; no effect where no grip was ever seen.

    Parameters
    ----------
    model
        Fitted.
    tried
        As `halfseen.tables.grasp.attempts.attempts` gives them.

    Raises
    ------
    ArgumentError
        A grip is no finite number.
    PositivityError
        A weight is not identified.
    """
    decided = checked_attempts(tried)
    rows = tried.iloc[decided.row]
    return fitted_effect(model.predict_proba(rows)[:, 1], decided, checked_covariates(rows, ["grip"])[:, 0])


def fitted_effect(said: Rows, decided: Decided, grip: Rows) -> GripEffect:
    """Fit as `fit_grip_effect`, to what a model says of decided attempts without their grips."""
    if not grip.any():
        return GripEffect()
    first, kind = kinds(said, grip, decided.succeeded)
    weight = np.bincount(kind, decided.weight, len(first))
    logits, sign = logit(np.clip(said[first], SURE, 1.0 - SURE)), np.where(decided.succeeded[first], 1.0, -1.0)
    design = np.column_stack([np.ones(len(first)), grip[first]])

    def derivatives(theta: Thetas) -> Derivatives:
        margin, scaled = sign * (logits + theta @ design.T), theta / SPREAD
        loss = np.logaddexp(0.0, -margin) @ weight + (scaled**2).sum(axis=1) / 2.0
        wrong = expit(-margin)
        bend = (weight * wrong * (1.0 - wrong))[:, :, None, None] * design[:, :, None] * design[:, None, :]
        gradient = scaled / SPREAD - (weight * sign * wrong) @ design
        return loss, gradient, np.diag(SPREAD**-2.0) + bend.sum(axis=1)

    shift, per_grip = minimise_each(derivatives, np.zeros((1, 2)))[0].tolist()
    return GripEffect(shift, per_grip)
