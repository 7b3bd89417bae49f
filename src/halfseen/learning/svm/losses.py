"""Convex losses L(y, s) of a target y and a value s = f(z), with the functions that the solver and its certificate use.

===========================  ==========================================================================================
``squared``                  (y − s)²
``absolute``                 |y − s|
``pinball``                  max(q (y − s), (1 − q) (s − y)), q the quantile
``epsilon-insensitive``      max(|y − s| − ε, 0)
``huber``                    ½ (y − s)² where |y − s| ≤ δ, and δ (|y − s| − ½ δ) beyond
``hinge``                    max(1 − y s, 0), y = ±1
``squared-hinge``            max(1 − y s, 0)²
``logistic``                 log(1 + exp(−y s))
===========================  ==========================================================================================

All but the last are one family (`PiecewiseLoss`). All functions work row by row. The solver uses a loss through its
Moreau envelope with step τ ≥ 0,

    e(v) = min_s L(y, s) + (s − v)² / (2 τ),

which is differentiable even where L has a kink; with τ = 0 it is L itself. *Smooth* losses are differentiable
everywhere.

=========================  ============================================================================================
``value(y, s)``            L(y, s)
``slope(y, v, step)``      e'(v), with τ = 0 for smooth losses only
``curvature(y, v, step)``  e''(v), one of its one-sided values where the slope has a kink
``conjugate(y, t)``        L*(y, t) = sup_s (t s − L(y, s)), ∞ where t is no subgradient
``is_of_difference``       whether L(y, s) depends on y − s only
=========================  ============================================================================================

For a user-defined loss the rest is computed from its value and a proximal step or a derivative::

    class LogCosh:                                   # any object will do
        def value(self, y, s): ...                   # L(y, s), convex in s, row by row
        def derivative(self, y, s): ...              # ∂L/∂s, a subgradient where there is a kink
        # or, instead of the derivative:
        def proximal(self, y, v, step): ...          # argmin_s L(y, s) + (s − v)² / (2 step)
"""

from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np
from scipy.special import expit, xlogy

from halfseen.arrays import Rows
from halfseen.errors import ArgumentError
from halfseen.estimator import is_number

REGRESSION = ("squared", "absolute", "pinball", "epsilon-insensitive", "huber")
CLASSIFICATION = ("hinge", "squared-hinge", "logistic")

ON_THE_EDGE = 1e-9
"""Subgradients outside the domain of a conjugate by less than this are moved to its edge."""


@dataclass(frozen=True)
class PiecewiseLoss:
    """0 between a low and a high edge; outside, the slope is x / softness at distance x, up to a limit.

    Its conjugate is high · t₊ − low · t₋ + ½ softness t² for −down ≤ t ≤ up. Its envelope is the same loss with the
    step added to the softness.
    """

    up: float = 1.0
    down: float = 1.0
    """Largest slopes > 0 above and below; ∞ requires positive softness."""
    softness: float = 0.0
    """≥ 0; with 0 the slopes are constant."""
    epsilon: float | int = 0.0
    """The edges are y − ε and y + ε."""
    is_of_difference: bool = True
    """Otherwise y = ±1, and the only edge is y: the loss is 0 where y s ≥ 1."""

    @property
    def is_smooth(self) -> bool:
        return self.softness > 0.0

    def edges(self, y: Rows) -> tuple[Rows, Rows]:
        """Low and high edge of each row; ∓∞ if there is none."""
        if self.is_of_difference:
            return y - self.epsilon, y + self.epsilon
        return np.where(y > 0, y, -np.inf), np.where(y > 0, np.inf, y)

    def value(self, y: Rows, s: Rows) -> Rows:
        low, high = self.edges(y)
        return self._cost(s - high, self.up) + self._cost(low - s, self.down)

    def _cost(self, distance: Rows, limit: float) -> Rows:
        beyond = np.maximum(distance, 0.0)
        if not self.is_smooth:
            return limit * beyond
        slope = np.minimum(beyond / self.softness, limit)
        return slope * (beyond - 0.5 * self.softness * slope)

    def slope(self, y: Rows, v: Rows, step: float) -> Rows:
        (low, high), softness = self.edges(y), self.softness + step
        return np.clip((v - high) / softness, 0.0, self.up) - np.clip((low - v) / softness, 0.0, self.down)

    def curvature(self, y: Rows, v: Rows, step: float) -> Rows:
        (low, high), softness = self.edges(y), self.softness + step
        is_above = (v >= high) & (v < high + softness * self.up)
        is_below = (v <= low) & (v > low - softness * self.down)
        return (is_above | is_below) / softness

    def conjugate(self, y: Rows, t: Rows) -> Rows:
        low, high = self.edges(y)
        has_low, has_high = np.isfinite(low), np.isfinite(high)
        # An infinite edge has no slope, so 0 · ∞ is 0 here.
        of_edges = np.maximum(t, 0.0) * np.where(has_high, high, 0.0) + np.minimum(t, 0.0) * np.where(has_low, low, 0.0)
        lowest, highest = np.where(has_low, -self.down, 0.0), np.where(has_high, self.up, 0.0)
        return _within(of_edges + 0.5 * self.softness * t**2, t, lowest, highest)


@dataclass(frozen=True)
class Logistic:
    """log(1 + exp(−y s)), y = ±1; it is smooth, so it needs no envelope."""

    is_smooth: ClassVar[bool] = True
    is_of_difference: ClassVar[bool] = False

    def value(self, y: Rows, s: Rows) -> Rows:
        return np.logaddexp(0.0, -y * s)

    def slope(self, y: Rows, v: Rows, step: float) -> Rows:
        return -y * expit(-y * v)

    def curvature(self, y: Rows, v: Rows, step: float) -> Rows:
        return expit(v) * expit(-v)

    def conjugate(self, y: Rows, t: Rows) -> Rows:
        p = np.clip(-t * y, 0.0, 1.0)
        return _within(xlogy(p, p) + xlogy(1.0 - p, 1.0 - p), -t * y, 0.0, 1.0)


Loss: TypeAlias = "PiecewiseLoss | Logistic | OwnLoss"


def _within(values: Rows, t: Rows, low: Rows | float, high: Rows | float) -> Rows:
    """`values` where low ≤ t ≤ high, ∞ elsewhere."""
    return np.where((t >= low - ON_THE_EDGE) & (t <= high + ON_THE_EDGE), values, np.inf)


def named_loss(name: str, *, epsilon: float | int = 0.1, quantile: float | int = 0.5, delta: float | int = 1.0) -> Loss:
    """The loss of this name."""
    if name == "pinball" and not (is_number(quantile) and 0.0 < quantile < 1.0):
        raise ArgumentError(f"quantile is {quantile!r}; give a number in (0, 1); 0.5 is the median")
    if name == "epsilon-insensitive" and not (is_number(epsilon) and epsilon >= 0.0):
        raise ArgumentError(f"epsilon is {epsilon!r}; give a distance ≥ 0 in the target's units")
    if name == "huber" and not (is_number(delta) and delta > 0.0):
        raise ArgumentError(f"delta is {delta!r}; give a distance > 0 in the target's units")
    losses = {
        "squared": PiecewiseLoss(np.inf, np.inf, softness=0.5),
        "absolute": PiecewiseLoss(),
        "pinball": PiecewiseLoss(1.0 - quantile, float(quantile)),
        "epsilon-insensitive": PiecewiseLoss(epsilon=epsilon),
        "huber": PiecewiseLoss(float(delta), float(delta), softness=1.0),
        "hinge": PiecewiseLoss(is_of_difference=False),
        "squared-hinge": PiecewiseLoss(np.inf, np.inf, softness=0.5, is_of_difference=False),
        "logistic": Logistic(),
    }
    if name not in losses:
        raise ArgumentError(f"unknown loss {name!r}; give one of {', '.join(losses)}, or a loss of your own")
    return losses[name]


BISECTIONS = 80
ASCENTS = 60
NUDGE = 1e-6


@dataclass(frozen=True)
class OwnLoss:
    """A user-defined loss with all functions that the solver and its certificate need."""

    own: Any
    """An object with ``value(y, s)`` and ``proximal(y, v, step)`` or ``derivative(y, s)``."""
    is_smooth: ClassVar[bool] = False
    is_of_difference: ClassVar[bool] = False

    def value(self, y: Rows, s: Rows) -> Rows:
        return np.asarray(self.own.value(y, s), dtype=np.float64)

    def slope(self, y: Rows, v: Rows, step: float) -> Rows:
        return (v - self.proximal(y, v, step)) / step

    def curvature(self, y: Rows, v: Rows, step: float) -> Rows:
        nudge = NUDGE * (1.0 + np.abs(v))
        rise = self.proximal(y, v + nudge, step) - self.proximal(y, v - nudge, step)
        return (1.0 - np.clip(rise / (2.0 * nudge), 0.0, 1.0)) / step

    def conjugate(self, y: Rows, t: Rows) -> Rows:
        # sup_s t s − L(y, s), by proximal steps of doubling size; they diverge if the supremum is infinite.
        s, step = np.zeros_like(t), 1.0
        # A user's exponentials may overflow there.
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(ASCENTS):
                s, step = self.proximal(y, s + step * t, step), min(2.0 * step, 1e8)
            gain = t * s - self.value(y, s)
        return np.where(np.abs(s) < 1e6 * (1.0 + np.abs(y)), gain, np.inf)

    def proximal(self, y: Rows, v: Rows, step: float) -> Rows:
        """argmin_s L(y, s) + (s − v)² / (2 step).

        With a derivative it is the solution of s + step · L'(y, s) = v: the left side is increasing, and s is between v
        and v − step · L'(y, v).
        """
        if hasattr(self.own, "proximal"):
            return np.asarray(self.own.proximal(y, v, step), dtype=np.float64)
        reach = v - step * np.asarray(self.own.derivative(y, v), dtype=np.float64)
        low, high = np.minimum(v, reach), np.maximum(v, reach)
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            is_low = middle + step * np.asarray(self.own.derivative(y, middle), dtype=np.float64) < v
            low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
        return 0.5 * (low + high)


def own_loss(own: Any, y: Rows) -> Loss:
    """Return a loss of the library unchanged, and a user-defined one after a test on the targets."""
    if isinstance(own, PiecewiseLoss | Logistic):
        return own
    if not hasattr(own, "value") or not (hasattr(own, "proximal") or hasattr(own, "derivative")):
        raise ArgumentError(
            f"loss is {own!r}, without value(y, s) and proximal(y, v, step) or derivative(y, s); give an object that "
            "has them, or the name of a loss"
        )
    shifts = (float(np.std(y)) or 1.0) * np.linspace(-3.0, 3.0, 13)
    values = np.array([_tried(own, y, y + shift) for shift in shifts])
    bend = values[:-2] + values[2:] - 2.0 * values[1:-1]
    wrong = np.argwhere(bend < -1e-9 * (1.0 + np.abs(values[1:-1])))
    if len(wrong):
        k, row = wrong[0]
        raise ArgumentError(
            f"loss is {own!r}, which is not convex at y = {y[row]:g}, s = {y[row] + shifts[k + 1]:g}; give one "
            "that is convex in s"
        )
    return OwnLoss(own)


def _tried(own: Any, y: Rows, s: Rows) -> Rows:
    values = np.asarray(own.value(y, s), dtype=np.float64)
    if values.shape != y.shape or not np.isfinite(values).all():
        raise ArgumentError(
            f"loss is {own!r}, whose value(y, s) gives shape {values.shape} for {len(y)} rows, or numbers that are not "
            "finite; return one finite number a row"
        )
    return values
