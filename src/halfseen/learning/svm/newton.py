"""Minimise λ‖g‖² + Σ_i φ_i(g_i + b) over g in H and an offset b, φ convex with a (semismooth) derivative.

Newton steps with an exact search along each: where φ is piecewise quadratic, as it is for all losses here but the
logistic one, the last step is exact and few are needed [QiSun1993]_. What a search along a step asks for thousands of
times has the shapes of the step, and is not checked again.
"""

from dataclasses import dataclass, replace
from typing import Any, no_type_check

import numpy as np

from halfseen.arrays import Rows
from halfseen.learning.svm.spaces import Coefficients, Space

MAX_STEPS = 200
_FORESEEN = 1e-12
PATIENCE = 20
"""Steps without a smaller promise after which rounding is taken to have the last word."""


@dataclass(frozen=True)
class Point:
    """A candidate: the coefficients of g, the values g_i, and the offset b."""

    coefficients: Coefficients
    values: Rows
    offset: float

    @property
    def f(self) -> Rows:
        """Values of f = g + b on the rows."""
        return self.values + self.offset


def minimise(
    space: Space, total: Any, reg: float, has_offset: bool, start: Point, tolerance: float
) -> tuple[Point, int]:
    """Minimise from `start`; stop when a Newton step promises less than `tolerance`.

    `total` tells of Σ_i φ_i(f_i) its `pull`, −∂φ_i/∂f_i: how hard each row pulls its value up, and its `curvature`.

    Returns
    -------
    tuple
        The minimiser and the number of steps taken.
    """
    point, least, in_vain = start, np.inf, 0
    for step in range(MAX_STEPS):
        pull, curvature = total.pull(point.f), total.curvature(point.f)
        if has_offset and not curvature.any():
            point = replace(point, offset=balanced_offset(total, point))
            pull, curvature = total.pull(point.f), total.curvature(point.f)
        coefficients, offset = space.newton_step(point.coefficients, pull, curvature, reg, has_offset)
        move = Point(coefficients, space.values(coefficients), offset)
        line = _Line(space, total, reg, point, move)
        promise = -line.slope(0.0)
        least, in_vain = (promise, 0) if promise < least else (least, in_vain + 1)
        if promise <= tolerance or in_vain == PATIENCE:
            return point, step
        share = line.lowest()
        point = line.at(share)
        if share == 1.0 and _was_foreseen(pull, total.pull(point.f), curvature, move):
            return point, step + 1
    return point, MAX_STEPS


def _was_foreseen(before: Rows, after: Rows, curvature: Rows, move: Point) -> bool:
    """Tell whether the pulls changed as their curvatures said, so that the step went all the way to the minimum."""
    error = np.abs(after - before + curvature * move.f).max(initial=0.0)
    return bool(error <= _FORESEEN * np.abs(before).max(initial=0.0))


def balanced_offset(total: Any, point: Point) -> float:
    """Find the offset at which the rows' pulls cancel, the other coefficients held."""

    def excess(offset: float) -> float:
        return float(total.pull(point.values + offset).sum())

    low = high = point.offset
    width = 1.0 + abs(point.offset)
    while excess(low) < 0.0 and width < 1e12:
        low, width = low - width, 2.0 * width
    while excess(high) > 0.0 and width < 1e12:
        high, width = high + width, 2.0 * width
    return _bisect(lambda offset: -excess(offset), low, high, 0.0)


@no_type_check
class _Line:
    """The objective along a move; its derivative only rises, since it is convex."""

    def __init__(self, space: Space, total: Any, reg: float, point: Point, move: Point) -> None:
        self.total, self.point, self.move, self.f, self.way = total, point, move, point.f, move.f
        self.linear = 2.0 * reg * space.inner(point.coefficients, move.coefficients, move.values)
        self.quadratic = 2.0 * reg * space.inner(move.coefficients, move.coefficients, move.values)

    def at(self, share: float) -> Point:
        return Point(
            self.point.coefficients + share * self.move.coefficients,
            self.point.values + share * self.move.values,
            self.point.offset + share * self.move.offset,
        )

    def slope(self, share: float) -> float:
        pull = self.total.pull(self.f + share * self.way)
        return self.linear + share * self.quadratic - float(pull @ self.way)

    def lowest(self) -> float:
        """The whole move unless it overshoots, then the share at which the slope is all but gone."""
        enough = 0.1 * abs(self.slope(0.0))
        return 1.0 if self.slope(1.0) <= enough else _bisect(self.slope, 0.0, 1.0, enough)


def _bisect(rising, low: float, high: float, enough: float) -> float:
    """Zero of a rising function between `low` and `high`."""
    middle = 0.5 * (low + high)
    for _ in range(100):
        value = rising(middle)
        if abs(value) <= enough or not low < middle < high:
            break
        low, high = (middle, high) if value < 0.0 else (low, middle)
        middle = 0.5 * (low + high)
    return middle
