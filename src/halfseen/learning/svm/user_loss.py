"""A loss of the user's own: its value, and a proximal step or a derivative; the rest is worked out from these.

::

    class LogCosh:                                   # any object will do
        def value(self, y, s): ...                   # L(y, s), convex in s, row by row
        def derivative(self, y, s): ...              # ∂L/∂s, a subgradient where there is a kink
        # or, instead of the derivative:
        def proximal(self, y, v, step): ...          # argmin_s L(y, s) + (s − v)² / (2 step)
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from halfseen.arrays import Rows
from halfseen.errors import ArgumentError
from halfseen.learning.svm.losses import ProximalLoss, SmoothLoss

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
