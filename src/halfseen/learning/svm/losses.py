"""Convex losses L(y, s) of a target y and a value s = f(z), each with what the solver and its certificate need.

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

A loss is either *smooth*, with a derivative and a curvature in s, or it has a proximal step. All functions work row by
row. The conjugate is L*(y, t) = sup_s (t s − L(y, s)), and ∞ where t is no subgradient of the loss.

Of a loss of the user's own the rest is worked out from its value, and a proximal step or a derivative::

    class LogCosh:                                   # any object will do
        def value(self, y, s): ...                   # L(y, s), convex in s, row by row
        def derivative(self, y, s): ...              # ∂L/∂s, a subgradient where there is a kink
        # or, instead of the derivative:
        def proximal(self, y, v, step): ...          # argmin_s L(y, s) + (s − v)² / (2 step)
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.special import expit, xlogy

from halfseen.arrays import Rows
from halfseen.errors import ArgumentError

REGRESSION = ("squared", "absolute", "pinball", "epsilon-insensitive", "huber")
CLASSIFICATION = ("hinge", "squared-hinge", "logistic")

_ON_THE_EDGE = 1e-9
"""Subgradients that leave the domain of a conjugate by less than this are taken to lie on its edge."""


class _ConvexLoss(ABC):
    """A convex loss, row by row."""

    is_of_difference: ClassVar[bool] = False
    """Whether L(y, s) depends on y − s only."""

    @abstractmethod
    def value(self, y: Rows, s: Rows) -> Rows:
        """L(y, s)."""

    @abstractmethod
    def conjugate(self, y: Rows, t: Rows) -> Rows:
        """L*(y, t)."""


class SmoothLoss(_ConvexLoss):
    """A loss with a continuous derivative in s."""

    @abstractmethod
    def derivative(self, y: Rows, s: Rows) -> Rows:
        """∂L/∂s."""

    @abstractmethod
    def curvature(self, y: Rows, s: Rows) -> Rows:
        """∂²L/∂s², one of its one-sided values where the derivative has a kink."""


class ProximalLoss(_ConvexLoss):
    """A loss with a proximal step."""

    @abstractmethod
    def proximal(self, y: Rows, v: Rows, step: float) -> Rows:
        """argmin_s L(y, s) + (s − v)² / (2 step)."""

    @abstractmethod
    def proximal_slope(self, y: Rows, v: Rows, step: float) -> Rows:
        """∂ proximal / ∂v, in [0, 1]."""


@dataclass(frozen=True)
class Squared(SmoothLoss):
    """(y − s)²."""

    is_of_difference = True

    def value(self, y: Rows, s: Rows) -> Rows:
        return np.square(y - s)

    def derivative(self, y: Rows, s: Rows) -> Rows:
        return 2.0 * (s - y)

    def curvature(self, y: Rows, s: Rows) -> Rows:
        return np.full_like(s, 2.0)

    def conjugate(self, y: Rows, t: Rows) -> Rows:
        return t * y + 0.25 * t**2


@dataclass(frozen=True)
class Huber(SmoothLoss):
    """½ (y − s)² where |y − s| ≤ δ, and δ (|y − s| − ½ δ) beyond."""

    is_of_difference = True

    delta: float | int = 1.0

    def value(self, y: Rows, s: Rows) -> Rows:
        inner = np.clip(s - y, -self.delta, self.delta)
        return inner * (s - y - 0.5 * inner)

    def derivative(self, y: Rows, s: Rows) -> Rows:
        return np.clip(s - y, -self.delta, self.delta)

    def curvature(self, y: Rows, s: Rows) -> Rows:
        return (np.abs(s - y) <= self.delta).astype(np.float64)

    def conjugate(self, y: Rows, t: Rows) -> Rows:
        return _within(t * y + 0.5 * t**2, t, -self.delta, self.delta)


@dataclass(frozen=True)
class SquaredHinge(SmoothLoss):
    """max(1 − y s, 0)², y = ±1."""

    def value(self, y: Rows, s: Rows) -> Rows:
        return np.square(np.maximum(1.0 - y * s, 0.0))

    def derivative(self, y: Rows, s: Rows) -> Rows:
        return -2.0 * y * np.maximum(1.0 - y * s, 0.0)

    def curvature(self, y: Rows, s: Rows) -> Rows:
        return 2.0 * (y * s < 1.0)

    def conjugate(self, y: Rows, t: Rows) -> Rows:
        slope = t * y
        return _within(slope + 0.25 * slope**2, slope, -np.inf, 0.0)


@dataclass(frozen=True)
class Logistic(SmoothLoss):
    """log(1 + exp(−y s)), y = ±1."""

    def value(self, y: Rows, s: Rows) -> Rows:
        return np.logaddexp(0.0, -y * s)

    def derivative(self, y: Rows, s: Rows) -> Rows:
        return -y * expit(-y * s)

    def curvature(self, y: Rows, s: Rows) -> Rows:
        return expit(s) * expit(-s)

    def conjugate(self, y: Rows, t: Rows) -> Rows:
        p = np.clip(-t * y, 0.0, 1.0)
        return _within(xlogy(p, p) + xlogy(1.0 - p, 1.0 - p), -t * y, 0.0, 1.0)


@dataclass(frozen=True)
class DeadZone(ProximalLoss):
    """max(0, up (s − high), down (low − s)): nothing between low and high, slopes `up` and `down` outside.

    Parameters
    ----------
    up, down
        Slopes ≥ 0 above and below the dead zone.
    """

    up: float = 1.0
    down: float = 1.0

    def edges(self, y: Rows) -> tuple[Rows, Rows]:
        """Low and high end of each row's dead zone."""
        return y, y

    def value(self, y: Rows, s: Rows) -> Rows:
        low, high = self.edges(y)
        return self.up * np.maximum(s - high, 0.0) + self.down * np.maximum(low - s, 0.0)

    def proximal(self, y: Rows, v: Rows, step: float) -> Rows:
        low, high = self.edges(y)
        return v - np.clip(v - high, 0.0, step * self.up) + np.clip(low - v, 0.0, step * self.down)

    def proximal_slope(self, y: Rows, v: Rows, step: float) -> Rows:
        low, high = self.edges(y)
        is_held = ((v >= high) & (v < high + step * self.up)) | ((v <= low) & (v > low - step * self.down))
        return (~is_held).astype(np.float64)

    def conjugate(self, y: Rows, t: Rows) -> Rows:
        low, high = self.edges(y)
        # 0 · ∞ is 0 here: an edge at infinity has no slope.
        rising = np.where(t > 0, t, 0.0) * np.where(np.isfinite(high), high, 0.0)
        falling = np.where(t < 0, t, 0.0) * np.where(np.isfinite(low), low, 0.0)
        return _within(
            rising + falling, t, np.where(np.isfinite(low), -self.down, 0.0), np.where(np.isfinite(high), self.up, 0.0)
        )


@dataclass(frozen=True)
class DeadZoneAroundTarget(DeadZone):
    """Nothing within ε of y: |y − s|, the ``pinball``, and ``epsilon-insensitive``."""

    is_of_difference = True

    epsilon: float | int = 0.0

    def edges(self, y: Rows) -> tuple[Rows, Rows]:
        return y - self.epsilon, y + self.epsilon


@dataclass(frozen=True)
class Hinge(DeadZone):
    """max(1 − y s, 0), y = ±1."""

    def edges(self, y: Rows) -> tuple[Rows, Rows]:
        return np.where(y > 0, 1.0, -np.inf), np.where(y > 0, np.inf, -1.0)


def named_loss(
    name: str, *, epsilon: float | int = 0.1, quantile: float | int = 0.5, delta: float | int = 1.0
) -> SmoothLoss | ProximalLoss:
    """The loss of this name.

    Raises
    ------
    ArgumentError
        There is no such loss, or its parameter is out of range.
    """
    if name == "pinball" and not 0.0 < quantile < 1.0:
        raise ArgumentError(f"quantile is {quantile}; it lies in (0, 1), and 0.5 is the median")
    if name == "epsilon-insensitive" and not 0.0 <= epsilon < np.inf:
        raise ArgumentError(f"epsilon is {epsilon}; it is a distance ≥ 0 in the target's units")
    if name == "huber" and not 0.0 < delta < np.inf:
        raise ArgumentError(f"delta is {delta}; it is a distance > 0 in the target's units")
    losses: dict[str, SmoothLoss | ProximalLoss] = {
        "squared": Squared(),
        "absolute": DeadZoneAroundTarget(),
        "pinball": DeadZoneAroundTarget(up=1.0 - quantile, down=quantile),
        "epsilon-insensitive": DeadZoneAroundTarget(epsilon=epsilon),
        "huber": Huber(delta),
        "hinge": Hinge(),
        "squared-hinge": SquaredHinge(),
        "logistic": Logistic(),
    }
    if name not in losses:
        raise ArgumentError(f"there is no loss {name!r}; there are {', '.join(losses)}, or give a loss of your own")
    return losses[name]


def _within(values: Rows, t: Rows, low: Rows | float, high: Rows | float) -> Rows:
    """`values` where low ≤ t ≤ high, ∞ elsewhere."""
    return np.where((t >= low - _ON_THE_EDGE) & (t <= high + _ON_THE_EDGE), values, np.inf)


_BISECTIONS = 80
_ASCENTS = 60
_SLOPE_STEP = 1e-6


@dataclass(frozen=True)
class UserLoss(ProximalLoss):
    """A user's loss with all that the solver and its certificate need.

    Parameters
    ----------
    own
        An object with ``value(y, s)`` and ``proximal(y, v, step)`` or ``derivative(y, s)``.
    """

    own: Any

    def value(self, y: Rows, s: Rows) -> Rows:
        return np.asarray(self.own.value(y, s), dtype=np.float64)

    def proximal(self, y: Rows, v: Rows, step: float) -> Rows:
        if hasattr(self.own, "proximal"):
            return np.asarray(self.own.proximal(y, v, step), dtype=np.float64)
        return self._proximal_by_bisection(y, v, step)

    def proximal_slope(self, y: Rows, v: Rows, step: float) -> Rows:
        nudge = _SLOPE_STEP * (1.0 + np.abs(v))
        rise = self.proximal(y, v + nudge, step) - self.proximal(y, v - nudge, step)
        return np.clip(rise / (2.0 * nudge), 0.0, 1.0)

    def conjugate(self, y: Rows, t: Rows) -> Rows:
        # sup_s t s − L(y, s), by proximal steps that double: they run off where there is no finite one.
        s, step = np.zeros_like(t), 1.0
        # Out there a user's exponentials may overflow.
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(_ASCENTS):
                s, step = self.proximal(y, s + step * t, step), min(2.0 * step, 1e8)
            gain = t * s - self.value(y, s)
        return np.where(np.abs(s) < 1e6 * (1.0 + np.abs(y)), gain, np.inf)

    def _proximal_by_bisection(self, y: Rows, v: Rows, step: float) -> Rows:
        """Solve s + step · L'(y, s) = v: the left side rises, and s lies between v and v − step · L'(y, v)."""
        reach = v - step * np.asarray(self.own.derivative(y, v), dtype=np.float64)
        low, high = np.minimum(v, reach), np.maximum(v, reach)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            is_low = middle + step * np.asarray(self.own.derivative(y, middle), dtype=np.float64) < v
            low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
        return 0.5 * (low + high)


def own_loss(own: Any, y: Rows) -> SmoothLoss | ProximalLoss:
    """Take a loss of the library as it is, and a user's after a trial on the targets.

    Raises
    ------
    ArgumentError
        The object lacks a method, returns something else than one finite number a row, or is not convex.
    """
    if isinstance(own, SmoothLoss | ProximalLoss):
        return own
    if not hasattr(own, "value") or not (hasattr(own, "proximal") or hasattr(own, "derivative")):
        raise ArgumentError(
            f"loss is {own!r}, without value(y, s) and proximal(y, v, step) or derivative(y, s); give an object that "
            "has them, or the name of a loss"
        )
    loss = UserLoss(own)
    _check_convex(loss, y)
    return loss


def _check_convex(loss: UserLoss, y: Rows) -> None:
    spread = float(np.std(y)) or 1.0
    shifts = spread * np.linspace(-3.0, 3.0, 13)
    values = np.array([_checked(loss, y, y + shift) for shift in shifts])
    bend = values[:-2] + values[2:] - 2.0 * values[1:-1]
    wrong = np.argwhere(bend < -1e-9 * (1.0 + np.abs(values[1:-1])))
    if len(wrong):
        k, row = wrong[0]
        raise ArgumentError(
            f"loss is {loss.own!r}, which bends down at y = {y[row]:g}, s = {y[row] + shifts[k + 1]:g}; give one "
            "that is convex in s"
        )


def _checked(loss: UserLoss, y: Rows, s: Rows) -> Rows:
    values = np.asarray(loss.own.value(y, s), dtype=np.float64)
    if values.shape != y.shape or not np.isfinite(values).all():
        raise ArgumentError(
            f"loss is {loss.own!r}, whose value(y, s) gives shape {values.shape} for {len(y)} rows, or numbers that "
            "are not finite; return one finite number a row"
        )
    return values
