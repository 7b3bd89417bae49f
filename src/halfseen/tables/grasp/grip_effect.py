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
from scipy.optimize import minimize
from scipy.special import expit, logit

from halfseen.arrays import Rows
from halfseen.tables.grasp.inputs import checked_attempts, checked_covariates
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
    grip = checked_covariates(rows, ["grip"])[:, 0]
    if not grip.any():
        return GripEffect()
    said = logit(np.clip(model.predict_proba(rows)[:, 1], SURE, 1.0 - SURE))
    design, sign = np.column_stack([np.ones_like(grip), grip]), np.where(decided.succeeded, 1.0, -1.0)

    def negative_log_posterior(theta: np.ndarray) -> tuple[float, np.ndarray]:
        margin, scaled = sign * (said + design @ theta), theta / SPREAD
        loss = decided.weight @ np.logaddexp(0.0, -margin) + scaled @ scaled / 2.0
        return float(loss), scaled / SPREAD - design.T @ (decided.weight * sign * expit(-margin))

    found = minimize(negative_log_posterior, np.zeros(2), jac=True, method="BFGS", options={"gtol": 1e-8})
    return GripEffect(*(float(value) for value in found.x))
