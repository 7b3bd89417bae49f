"""Minimise λ‖g‖² + Σ_i φ_i(g_i + b) over g in H and an offset b, φ convex with a (semismooth) derivative.

Newton steps with an exact line search: if φ is piecewise quadratic, as for all losses here but the logistic one, the
last step is exact and few are needed [QiSun1993]_. Rows are represented in one of two ways: `Gram`, by the kernel
values between them, g = K α, or `Features`, g = Φ θ and ‖g‖² = θᵀθ. From Σ φ_i(f_i) they need the *pull* of each row,
−∂φ_i/∂f_i, which is the force that raises its value, and the curvature ∂²φ_i/∂f_i².
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, TypeAlias, no_type_check

import numpy as np
import scipy.linalg

from halfseen.arrays import Rows
from halfseen.shapes import Float, Int

Coefficients = Float[np.ndarray, " c"]
Step: TypeAlias = Callable[[Coefficients, Rows], tuple[Coefficients, float]]
"""Takes coefficients and pulls, returns the change of the coefficients and of the offset."""

MAX_STEPS = 200
PATIENCE = 20
"""Steps without a smaller predicted decrease after which rounding is assumed to dominate."""
FORESEEN = 1e-12
NEGLIGIBLE = 1e-12
"""Curvatures below this share of the largest count as zero."""
JITTER = 1e-13
FEATURES_AT_ONCE = 2**22
SINGLE_FROM = 300
"""Rows from which a system is factorised in single precision, which takes half the time."""
REFINED, MOST_REFINEMENTS = 1e-6, 4
"""Largest relative residual of a solution in single precision, and the most refinements to reach it."""


@dataclass(frozen=True)
class Gram:
    """g = Σ_i α_i k(z_i, ·), λ > 0; K need not be of full rank.

    The optimality condition 2 λ α = p is kept in this form, without a factor K. Rows without curvature are solved
    directly, α_i = p_i / 2λ; the others, A, solve (K_AA + 2 λ D_A⁻¹) Δα_A + Δb = …, a system only as large as A.
    """

    matrix: Float[np.ndarray, "n n"]

    def part(self, rows: Int[np.ndarray, " r"]) -> "Gram":
        """The space spanned by some of the rows."""
        return Gram(self.between(rows, rows))

    def between(self, rows: Int[np.ndarray, " r"], fitted: Int[np.ndarray, " s"]) -> Float[np.ndarray, "r c"]:
        """The matrix that maps coefficients in the `part` of some rows to the values of g at others."""
        return self.matrix[np.ix_(rows, fitted)]

    def inner(self, coefficients: Coefficients, others: Coefficients, other_values: Rows) -> float:
        """⟨g, g'⟩ in H, where `other_values` are the values of g'."""
        return float(coefficients @ other_values)

    def squared_norm(self, forces: Rows) -> float:
        """‖Σ_i forces_i k(z_i, ·)‖²."""
        return float(forces @ self.matrix @ forces)

    def newton(self, curvature: Rows, reg: float, has_offset: bool, negligible: float = NEGLIGIBLE) -> Step:
        """Factorise the equations of a step."""
        curved = np.flatnonzero(curvature > negligible * curvature.max(initial=0.0))
        ridge = 2.0 * reg / curvature[curved]
        is_whole = len(curved) == len(self.matrix)
        solve = _solver(self.matrix if is_whole else self.matrix[np.ix_(curved, curved)], ridge)
        of_ones = solve(np.ones(len(curved)))

        def step(coefficients: Coefficients, pull: Rows) -> tuple[Coefficients, float]:
            change = pull / (2.0 * reg) - coefficients
            wanted = ridge * change[curved]
            change[curved] = 0.0
            if not is_whole:
                wanted -= (self.matrix @ change)[curved]
            change[curved] = solve(wanted)
            if not has_offset or len(curved) == 0:
                return change, 0.0
            # Σ α = 0 is the optimality condition of the offset.
            offset = float((change.sum() + coefficients.sum()) / of_ones.sum())
            change[curved] -= offset * of_ones
            return change, offset

        return step


@dataclass(frozen=True)
class Features:
    """g = Φ θ; its methods are those of `Gram`."""

    matrix: Float[np.ndarray, "n c"]

    def part(self, rows: Int[np.ndarray, " r"]) -> "Features":
        return Features(self.matrix[rows])

    def between(self, rows: Int[np.ndarray, " r"], fitted: Int[np.ndarray, " s"]) -> Float[np.ndarray, "r c"]:
        return self.matrix[rows]

    def inner(self, coefficients: Coefficients, others: Coefficients, other_values: Rows) -> float:
        return float(coefficients @ others)

    def squared_norm(self, forces: Rows) -> float:
        return float(np.sum(np.square(self.matrix.T @ forces)))

    def newton(self, curvature: Rows, reg: float, has_offset: bool) -> Step:
        size = self.matrix.shape[1]
        curved = np.flatnonzero(curvature > NEGLIGIBLE * curvature.max(initial=0.0))
        system = np.diag(np.repeat([2.0 * reg, 0.0], [size, 1]))
        for rows in np.array_split(curved, 1 + len(curved) * size // FEATURES_AT_ONCE):
            weighted = np.column_stack([self.matrix[rows], np.ones(len(rows))])
            weighted *= np.sqrt(curvature[rows])[:, None]
            system += weighted.T @ weighted
        used = size + bool(has_offset and len(curved))
        system = system[:used, :used]
        factor = factored(system) if system.diagonal().max(initial=0.0) > 0.0 else None

        def step(coefficients: Coefficients, pull: Rows) -> tuple[Coefficients, float]:
            change = np.zeros(size + 1)
            if factor is not None:
                gradient = np.append(self.matrix.T @ pull - 2.0 * reg * coefficients, pull.sum())
                change[:used] = scipy.linalg.cho_solve(factor, gradient[:used], check_finite=False)
            return change[:size], float(change[size])

        return step


Space: TypeAlias = Gram | Features


def _solver(matrix: Float[np.ndarray, "k k"], ridge: Rows) -> Callable[[Rows], Rows]:
    """Solve (K + diag ρ) x = r, by a factor in single precision with refinement in double if that converges."""
    system = matrix.copy()
    system[np.diag_indices_from(system)] += ridge
    single = None
    if len(ridge) >= SINGLE_FROM:
        # Values too large for single precision become infinite, so the residual test fails.
        with np.errstate(over="ignore"), suppress(np.linalg.LinAlgError):
            # LAPACK is column-major; the transpose of a symmetric matrix avoids a copy.
            columns = system.astype(np.float32).T
            single = scipy.linalg.cho_factor(columns, lower=True, overwrite_a=True, check_finite=False)
    double = cache(lambda: factored(system))

    def solve(right: Rows) -> Rows:
        nonlocal single
        size, rate = np.abs(right).max(initial=0.0) or 1.0, 1.0
        solved, missed = np.zeros(len(right)), right / size
        for _ in range(MOST_REFINEMENTS if single is not None else 0):
            solved += scipy.linalg.cho_solve(single, missed.astype(np.float32), check_finite=False)
            # The residual shrinks at a constant rate, so this correction needs no check.
            if rate * np.abs(missed).max() <= REFINED:
                return size * solved
            missed = right / size - system @ solved
            rate = min(rate, np.abs(missed).max())
        single = None
        return scipy.linalg.cho_solve(double(), right, check_finite=False)

    return solve


def factored(system: Float[np.ndarray, "k k"]) -> tuple[Float[np.ndarray, "k k"], bool]:
    """Factorise a positive semidefinite system in place, for `scipy.linalg.cho_solve`.

    Directions of zero curvature get curvature of the size of rounding.
    """
    jitter = JITTER * system.diagonal().max(initial=0.0)
    while True:
        try:
            return scipy.linalg.cho_factor(system, lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            system[np.diag_indices_from(system)] += jitter
            jitter *= 100.0


@dataclass(frozen=True)
class Point:
    """A candidate or a step: the coefficients of g, the values g_i, and the offset b."""

    coefficients: Coefficients
    values: Rows
    offset: float

    @property
    def f(self) -> Rows:
        """Values of f = g + b at the rows."""
        return self.values + self.offset

    def plus(self, share: float, move: "Point") -> "Point":
        """The point plus a fraction of a step."""
        return Point(
            self.coefficients + share * move.coefficients,
            self.values + share * move.values,
            self.offset + share * move.offset,
        )


@no_type_check
def minimise(space: Space, total: Any, reg: float, has_offset: bool, point: Point, tolerance: float) -> Point:
    """Minimise from a starting point; stop when a Newton step predicts a decrease below `tolerance`.

    `total` provides ``pull(f)`` and ``curvature(f)`` of Σ φ_i(f_i).
    """
    least, in_vain = np.inf, 0
    for _ in range(MAX_STEPS):
        pull, curvature = total.pull(point.f), total.curvature(point.f)
        if has_offset and not curvature.any():
            point = _with_balanced_offset(total, point)
            pull, curvature = total.pull(point.f), total.curvature(point.f)
        coefficients, offset = space.newton(curvature, reg, has_offset)(point.coefficients, pull)
        move = Point(coefficients, space.matrix @ coefficients, offset)
        slope = _slope_along(space, total, reg, point, move)
        promise = -slope(0.0)
        least, in_vain = (promise, 0) if promise < least else (least, in_vain + 1)
        if promise <= tolerance or in_vain == PATIENCE:
            break
        share = _lowest(slope, 1.0, 0.1 * promise)
        point = point.plus(share, move)
        # A full step along which the pulls changed exactly as the curvatures predicted has reached the minimum.
        error = np.abs(total.pull(point.f) - pull + curvature * move.f).max(initial=0.0)
        if share == 1.0 and error <= FORESEEN * np.abs(pull).max(initial=0.0):
            break
    return point


@no_type_check
def _slope_along(space: Space, total: Any, reg: float, point: Point, move: Point) -> Callable[[float], float]:
    """The derivative of the objective along a step, which is increasing."""
    linear = 2.0 * reg * space.inner(point.coefficients, move.coefficients, move.values)
    quadratic = 2.0 * reg * space.inner(move.coefficients, move.coefficients, move.values)
    start, way = point.f, move.f
    return lambda share: linear + share * quadratic - float(total.pull(start + share * way) @ way)


@no_type_check
def _with_balanced_offset(total: Any, point: Point) -> Point:
    """Change only the offset, to where the pulls of the rows cancel."""
    start, way = point.f, np.sign(total.pull(point.f).sum())

    def slope(distance):
        return -way * float(total.pull(start + distance * way).sum())

    farthest = 1.0 + abs(point.offset)
    while slope(farthest) < 0.0 and farthest < 1e12:
        farthest *= 2.0
    return replace(point, offset=point.offset + way * _lowest(slope, farthest, 0.0))


@no_type_check
def _lowest(slope: Callable[[float], float], high: float, enough: float) -> float:
    """Root of an increasing slope within `enough`, by bisection from 0 to `high`; `high` if there is none."""
    if slope(high) <= enough:
        return high
    low, middle = 0.0, 0.5 * high
    for _ in range(100):
        value = slope(middle)
        if abs(value) <= enough or not low < middle < high:
            break
        low, high = (middle, high) if value < 0.0 else (low, middle)
        middle = 0.5 * (low + high)
    return middle
