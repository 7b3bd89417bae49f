"""Batched robust fits of a few parameters to many points: damped Gauss–Newton [Marquardt1963]_.

A point's residual r has cost 2·(√(1 + r²) − 1): quadratic for small r, linear for large r. The curvature is that of the
robust cost along r [TriggsEtAl2000]_; the damping follows the ratio of actual to predicted gain [Nielsen1999]_.
Parameters stay within their bounds; one at a bound that would leave it is fixed for the step.

A cloud takes hundreds of steps with few parameters, so the number of NumPy calls dominates the run time. All fits of a
kind therefore run in one batch, and shapes are checked only by the callers.
"""

from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, no_type_check, runtime_checkable

import numpy as np

from halfseen.arrays import Rows
from halfseen.shapes import Bool, Float

# Relative changes of cost and parameters below which a fit has converged.
TOLERANCE = 1e-6
# Largest number of evaluations of the residuals.
MOST_EVALUATIONS = 60
# Initial damping relative to the curvature, and the damping beyond which a fit stops.
FIRST_DAMPING, LARGEST_DAMPING = 1.0, 1e10
SMALLEST = 1e-300

Free: TypeAlias = Float[np.ndarray, " p"]
Frees: TypeAlias = Float[np.ndarray, "k p"]
Residuals: TypeAlias = Float[np.ndarray, "k rows"]
Slopes: TypeAlias = Float[np.ndarray, "k p rows"]


@runtime_checkable
class Misses(Protocol):
    """Residuals of a batch of k fits, each with its own parameters and points."""

    def at(self, p: Frees) -> tuple[Residuals, Slopes]:
        """Residuals at these parameters and their Jacobian, in new arrays."""
        ...

    def some(self, which: Bool[np.ndarray, " k"]) -> Any:
        """Keep some of the fits."""
        ...


@dataclass(frozen=True, eq=False)
class Bounds:
    """Lower and upper bound of each parameter; infinite if there is none."""

    low: Free
    high: Free


@no_type_check
def fitted(misses: Misses, starts: Frees, bounds: Bounds) -> Frees:
    """Fit each set of parameters within the bounds.

    Parameters
    ----------
    misses
        Residuals of the fits.
    starts, bounds
        Initial parameters and their bounds.
    """
    fits = _Fits(misses, np.clip(starts, bounds.low, bounds.high), bounds)
    found = fits.p.copy()
    for _ in range(MOST_EVALUATIONS - 1):
        is_settled = fits.go_on()
        found[fits.which] = fits.p
        if is_settled.all():
            break
        if is_settled.any():
            fits.keep(~is_settled)
    return found


@no_type_check
class _Fits:
    """State of the unconverged fits: parameters, cost, gradient, curvature, and damping of the next step."""

    def __init__(self, misses: Misses, p: Frees, bounds: Bounds) -> None:
        self.misses, self.p, self.bounds, self.which = misses, p, bounds, np.arange(len(p))
        self.damping, self.growth = np.full(len(p), FIRST_DAMPING), np.full(len(p), 2.0)
        self.cost, self.curvature, self.slope = _quadratic(*misses.at(p))

    def go_on(self) -> Bool[np.ndarray, " k"]:
        """Try a step of each fit, keep those that reduce the cost, and return which fits have converged."""
        there = self.p + _step(self.p, self.curvature, self.slope, self.damping, self.bounds)
        there = np.minimum(np.maximum(there, self.bounds.low), self.bounds.high)
        step = there - self.p
        cost, curvature, slope = _quadratic(*self.misses.at(there))
        gain = self.cost - cost
        hoped = -(step * (self.slope + 0.5 * (self.curvature @ step[:, :, None])[:, :, 0])).sum(axis=1)
        is_better, is_short = gain > 0, (step * step).sum(axis=1) < TOLERANCE**2 * (self.p * self.p).sum(axis=1)
        ratio = np.minimum(np.maximum(gain / np.maximum(hoped, SMALLEST), 0.0), 1.0)
        self.damping = self.damping * np.where(is_better, np.maximum(1 / 3, 1 - (2 * ratio - 1) ** 3), self.growth)
        self.growth = np.where(is_better, 2.0, 2 * self.growth)
        is_settled = is_short | (is_better & (gain < TOLERANCE * self.cost)) | (self.damping > LARGEST_DAMPING)
        if is_better.all():
            self.p, self.cost, self.curvature, self.slope = there, cost, curvature, slope
        else:
            for old, new in zip(
                (self.p, self.cost, self.curvature, self.slope), (there, cost, curvature, slope), strict=True
            ):
                old[is_better] = new[is_better]
        return is_settled

    def keep(self, which: Bool[np.ndarray, " k"]) -> None:
        """Continue with only some of the fits."""
        self.misses = self.misses.some(which)
        for name in ("p", "which", "damping", "growth", "cost", "curvature", "slope"):
            setattr(self, name, getattr(self, name)[which])


@no_type_check
def _step(p: Frees, curvature, slope, damping, bounds: Bounds) -> Frees:
    """Damped Gauss–Newton step of each fit; damping scales the diagonal of the curvature."""
    matrix, num_free = curvature.copy(), p.shape[1]
    own = matrix.reshape(len(p), -1)[:, :: num_free + 1]
    own *= 1 + damping[:, None]
    is_held = ((p <= bounds.low) & (slope > 0)) | ((p >= bounds.high) & (slope < 0))
    if is_held.any():
        matrix[is_held] = 0.0
        matrix.transpose(0, 2, 1)[is_held] = 0.0
        own[is_held] = 1.0
        slope = np.where(is_held, 0.0, slope)
    return np.linalg.solve(matrix, -slope[:, :, None])[:, :, 0]


@no_type_check
def _quadratic(residuals: Residuals, slopes: Slopes) -> tuple[Rows, Any, Frees]:
    """Robust cost of each fit (half the sum of squares for small residuals), its curvature and gradient."""
    root = np.sqrt(1 + residuals * residuals)
    inverse = 1 / root
    cost = (root - 1).sum(axis=1)
    slope = (slopes @ (residuals * inverse)[:, :, None])[:, :, 0]
    slopes *= (inverse * np.sqrt(inverse))[:, None]
    return cost, slopes @ slopes.transpose(0, 2, 1), slope


def soft_l1(residuals: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Robust cost 2·(√(1 + r²) − 1) of residuals.

    Parameters
    ----------
    residuals
        Residuals in units of the noise.
    """
    return 2 * (np.sqrt(1 + residuals**2) - 1)
