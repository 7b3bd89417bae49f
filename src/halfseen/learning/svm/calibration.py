"""From values f to probabilities: a sigmoid fitted to rows that were held out [Platt1999]_."""

from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logit

from halfseen.arrays import Rows
from halfseen.learning.svm.losses import Logistic
from halfseen.learning.svm.solver import Problem, solve
from halfseen.learning.svm.spaces import FeatureSpace

_REG = 1e-6


@dataclass(frozen=True)
class Sigmoid:
    """P(second class | f) = 1 / (1 + exp(−(slope · f + offset)))."""

    slope: float
    offset: float

    def probability(self, f: Rows) -> Rows:
        """P(second class) at values of f."""
        return expit(self.slope * f + self.offset)


def fit_sigmoid(f: Rows, y: Rows, weight: Rows) -> Sigmoid:
    """Fit by weighted maximum likelihood, with Platt's targets in place of certainty.

    Parameters
    ----------
    f
        Values by fits that did not see the row; NaN rows are left out.
    y
        ±1.
    weight
        w > 0.
    """
    held = ~np.isnan(f)
    f, y, weight = f[held], y[held], weight[held]
    spread = float(np.sqrt(weight @ np.square(f) / weight.sum())) or 1.0
    # A row of class ±1 counts as that class with the probability by the rule of succession, else as the other.
    sample_size = weight.sum() ** 2 / np.square(weight).sum()
    proportion_second = weight[y > 0].sum() / weight.sum()
    num_of = sample_size * np.where(y > 0, proportion_second, 1.0 - proportion_second)
    sure = (num_of + 1.0) / (num_of + 2.0)
    twice = np.concatenate([f, f])[:, None] / spread
    mass = np.concatenate([weight * sure, weight * (1.0 - sure)]) / weight.sum()
    problem = Problem(FeatureSpace(twice), np.concatenate([y, -y]), mass, Logistic(), _REG, True)
    solution = solve(problem)
    slope = float(solution.coefficients[0]) / spread
    # Held-out values that speak for the wrong class tell nothing but how common the classes are.
    return Sigmoid(slope, solution.offset) if slope > 0.0 else Sigmoid(0.0, float(logit(proportion_second)))
