"""The censored SVM's optimum: min over f = g + b of λ‖g‖² + Σ_i c_i L(y_i, f_i), c_i = w_i / n (paper, eqs. 1 and 2).

A smooth loss is minimised by Newton steps. Any other is smoothed by its Moreau envelope around the last multipliers,
which is the augmented Lagrangian of the constraint s = f: each round minimises a smooth function and updates the
multipliers, and only the rows near a kink carry curvature, so that the linear systems stay small [LiSunToh2018]_. Where
λ is so small that most rows will lie on a kink, interior points come first, and rounds mend what those leave.

With u_i ∈ −∂L(y_i, f_i), minus a subgradient, the *pull* of row i, the dual of the problem is to maximise

    −λ‖g_u‖² − Σ_i c_i L*(y_i, −u_i),   2 λ g_u = Σ_i c_i u_i k(z_i, ·),   Σ_i c_i u_i = 0 if b is free.

Where λ = 0 nothing is penalised, and Σ_i c_i u_i z_i = 0 as well.

The distance between the two objectives, the *duality gap*, bounds how far the solution is from the optimum.
"""

from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from halfseen.arrays import RowMask, Rows
from halfseen.learning.svm.interior_point import interior_points
from halfseen.learning.svm.losses import DeadZone, ProximalLoss, SmoothLoss
from halfseen.learning.svm.newton import Point, minimise
from halfseen.learning.svm.spaces import Coefficients, FeatureSpace, GramSpace, Space
from halfseen.workers.threads import one_thread

SMALL = 2000
"""Rows up to which one BLAS thread serves: a second gains little, and on a busy machine each waits for the other."""

MAX_ROUNDS = 60
_PATIENCE = 8
"""Rounds without a smaller gap after which rounding is taken to have the last word."""
_SHRINK = 0.2
_ENOUGH = 0.1
"""A round that leaves less than this proportion of the gap needs no smaller step."""
_NEWTON_TOLERANCE = 1e-15
_ROUNDING = 1e-15
_IMBALANCE = 1e-11
"""Pulls that cancel but for this share of their sum do cancel."""
_WEAK = 10.0
"""Rows that could each pull f this many times as far as targets spread will mostly lie on a kink."""
_ROOM = 1e-7
"""A pull that can move this far either way is inside its range."""


@dataclass(frozen=True)
class Problem:
    """What is minimised; all rows count, so leave out those of weight 0."""

    space: Space
    y: Rows
    mass: Rows
    """c_i = w_i / n, > 0."""
    loss: SmoothLoss | ProximalLoss
    reg: float
    """λ; 0 needs features of full rank."""
    has_offset: bool


@dataclass(frozen=True)
class Solution:
    """A minimiser and its certificate."""

    coefficients: Coefficients
    offset: float
    pull: Rows
    """u: minus a subgradient of the loss at each row."""
    objective: float
    gap: float
    """Objective minus dual objective: the optimum is at most this far below."""
    num_steps: int
    """Newton steps taken."""
    rounding: float
    """A gap that is no larger tells nothing: some units in the last place of the loss of f = 0."""

    @property
    def relative_gap(self) -> float:
        """The gap as a share of the objective; 0 where it is no more than rounding."""
        return 0.0 if self.gap <= self.rounding else self.gap / max(abs(self.objective), np.finfo(float).tiny)


def solve(
    problem: Problem, tolerance: float = 1e-8, start: "Solution | None" = None, least_objective: float = 0.0
) -> Solution:
    """Solve to a relative duality gap of `tolerance`, or as near as rounding allows.

    Parameters
    ----------
    problem
        What is minimised.
    tolerance
        Largest gap, as a share of the objective.
    start
        The solution of a problem on the same rows, for example with another λ.
    least_objective
        An objective below this share of the loss of f = 0 is taken for that share when gaps are compared.
    """
    # With a middle target as 0, where the offset can take it up: far from 0, f is large beside its rounding.
    centre = _centre(problem)
    shifted = replace(start, offset=start.offset - centre) if start else None
    with one_thread() if len(problem.y) <= SMALL else nullcontext():
        solution = _solve(replace(problem, y=problem.y - centre), tolerance, shifted, least_objective)
    return replace(solution, offset=solution.offset + centre)


def _solve(problem: Problem, tolerance: float, start: "Solution | None", least_objective: float) -> Solution:
    if isinstance(problem.loss, SmoothLoss):
        return _solve_smooth(problem, problem.loss, _first_point(problem, start))
    goal = _Goal(tolerance, least_objective * _scale(problem))
    inside = _solve_from_inside(problem, goal)
    if inside is not None and goal.is_met(inside):
        return inside
    by_rounds = _solve_by_rounds(problem, problem.loss, inside or start, goal)
    return by_rounds if inside is None else min(inside, by_rounds, key=_preference)


@dataclass(frozen=True)
class _Goal:
    tolerance: float
    least_objective: float

    def is_met(self, found: Solution) -> bool:
        return bool(found.gap <= max(self.tolerance * max(found.objective, self.least_objective), found.rounding))


def _preference(found: Solution) -> tuple[float, float]:
    return found.gap, found.objective


def best_constant(y: Rows, weight: Rows, loss: SmoothLoss | ProximalLoss) -> float:
    """Find the constant that minimises Σ w L(y, c)."""
    nothing = FeatureSpace(np.zeros((len(y), 0)))
    return solve(Problem(nothing, y, weight / weight.sum(), loss, 1.0, True)).offset


def _centre(problem: Problem) -> float:
    """A target in the middle, if the loss looks at differences only and there is an offset; else 0."""
    if not (problem.has_offset and problem.loss.is_of_difference):
        return 0.0
    return float(np.sort(problem.y)[len(problem.y) // 2])


def _first_point(problem: Problem, start: "Solution | None") -> Point:
    if start is None:
        size = problem.space.num_coefficients
        return Point(np.zeros(size), np.zeros(len(problem.y)), 0.0)
    return Point(start.coefficients, problem.space.values(start.coefficients), start.offset)


def _solve_smooth(problem: Problem, loss: SmoothLoss, start: Point) -> Solution:
    total = _Smooth(loss, problem.y, problem.mass)
    tolerance = _NEWTON_TOLERANCE * _scale(problem)
    point, num_steps = minimise(problem.space, total, problem.reg, problem.has_offset, start, tolerance)
    return certify(problem, point, -loss.derivative(problem.y, point.f), num_steps)


def _solve_from_inside(problem: Problem, goal: _Goal) -> Solution | None:
    """Follow interior points until they come no nearer; None where few rows are foreseen to lie on a kink."""
    space, loss = problem.space, problem.loss
    if not (isinstance(space, GramSpace) and isinstance(loss, DeadZone)):
        return None
    edges, prices = np.stack(loss.edges(problem.y)[::-1]), np.outer([loss.up, loss.down], problem.mass)
    prices /= 2.0 * problem.reg
    width = float(np.std(problem.y))
    could_pull = float(np.median(space.gram.diagonal() * prices))
    if not (np.isfinite(edges).all() and prices.all() and 0.0 < _WEAK * width < could_pull):
        return None
    best, in_vain = None, 0
    # Two threads would take half the time at best, and on a busy machine they take five times as long.
    with one_thread():
        for step, (point, alpha) in enumerate(interior_points(space.gram, edges, prices, problem.has_offset, width)):
            found = certify(problem, point, 2.0 * problem.reg * alpha / problem.mass, step)
            in_vain = 0 if best is None or found.gap < best.gap else in_vain + 1
            best = found if best is None or in_vain == 0 else best
            if goal.is_met(best) or in_vain == _PATIENCE:
                break
    return best


def _solve_by_rounds(problem: Problem, loss: ProximalLoss, start: "Solution | None", goal: _Goal) -> Solution:
    scale, point = _scale(problem), _first_point(problem, start)
    pulls = start.pull if start else np.zeros(len(problem.y))
    envelope = _Envelope(loss, problem.y, problem.mass, pulls, float(np.std(problem.y)) or 1.0)
    best: Solution | None = None
    num_steps = rounds_in_vain = 0
    last = np.inf
    inner = 1e-3 * scale
    for _ in range(MAX_ROUNDS):
        point, steps = minimise(problem.space, envelope, problem.reg, problem.has_offset, point, inner)
        num_steps += steps
        found = certify(problem, point, envelope.pulls_at(point.f), num_steps)
        best = found if best is None else min(best, found, key=_preference)
        if goal.is_met(best):
            break
        rounds_in_vain = 0 if found is best else rounds_in_vain + 1
        if rounds_in_vain == _PATIENCE:
            break
        inner = max(min(0.1 * inner, 1e-2 * found.gap), _NEWTON_TOLERANCE * min(scale, best.objective))
        shrink = 1.0 if found.gap < _ENOUGH * last else _SHRINK
        envelope, last = replace(envelope, pulls=envelope.pulls_at(point.f), step=shrink * envelope.step), found.gap
    assert best is not None
    return best


def certify(problem: Problem, point: Point, pulls: Rows, num_steps: int) -> Solution:
    """Take the better of two candidates and the dual bound that the pulls give."""
    pulls = _balanced(problem, pulls)
    mass, loss, space = problem.mass, problem.loss, problem.space
    dual_coefficients = space.of_pull(mass * pulls, problem.reg)
    dual_values = space.values(dual_coefficients)
    dual_norm = space.inner(dual_coefficients, dual_coefficients, dual_values)
    dual = -problem.reg * dual_norm - float(mass @ loss.conjugate(problem.y, -pulls))
    # Pulls of 0 are balanced whatever the others are, and their bound is that no loss is below its least.
    least = -float(mass @ loss.conjugate(problem.y, np.zeros(len(pulls))))
    dual = max(dual, least) if _is_balanced(problem, pulls) else least
    norm = space.inner(point.coefficients, point.coefficients, point.values)
    objective = problem.reg * norm + float(mass @ loss.value(problem.y, point.f))
    rounding = _ROUNDING * _scale(problem)
    return Solution(point.coefficients, point.offset, pulls, objective, max(objective - dual, 0.0), num_steps, rounding)


def _balanced(problem: Problem, pulls: Rows) -> Rows:
    """Make Σ c u z exactly 0 for what costs nothing (z = 1 for the offset) by moving the pulls that have room."""
    columns = _free_columns(problem)
    if columns.shape[1] == 0:
        return pulls
    has_room = _is_subgradient(problem, pulls - _ROOM) & _is_subgradient(problem, pulls + _ROOM)
    movable = columns[has_room]
    excess = columns.T @ (problem.mass * pulls)
    moved = pulls.copy()
    system = movable.T @ (problem.mass[has_room, None] * movable)
    moved[has_room] -= movable @ np.linalg.lstsq(system, excess)[0]
    return moved if problem.reg == 0.0 else _shrunk(problem, moved)


def _shrunk(problem: Problem, pulls: Rows) -> Rows:
    """Let up and down cancel exactly, by shrinking the side that has more; smaller pulls are subgradients, too."""
    forces = problem.mass * pulls
    up, down = forces[forces > 0.0].sum(), -forces[forces < 0.0].sum()
    return np.where(pulls > 0.0, min(down / up, 1.0) if up else 1.0, min(up / down, 1.0) if down else 1.0) * pulls


def _is_balanced(problem: Problem, pulls: Rows) -> bool:
    columns = _free_columns(problem)
    forces = problem.mass * pulls
    return bool((np.abs(columns.T @ forces) <= _IMBALANCE * (np.abs(columns.T) @ np.abs(forces))).all())


def _free_columns(problem: Problem) -> Float[np.ndarray, "n k"]:
    """What f may add at no cost: 1 for the offset, and the features where λ = 0."""
    columns = problem.space.unpenalised(problem.reg)
    return np.column_stack([columns, np.ones(len(problem.y))]) if problem.has_offset else columns


def _is_subgradient(problem: Problem, pulls: Rows) -> RowMask:
    return np.isfinite(problem.loss.conjugate(problem.y, -pulls))


def _scale(problem: Problem) -> float:
    """Loss of f = 0, the size of the numbers that are compared."""
    return float(problem.mass @ np.abs(problem.loss.value(problem.y, np.zeros(len(problem.y))))) or 1.0


@no_type_check
@dataclass(frozen=True)
class _Smooth:
    """Σ c_i L(y_i, f_i)."""

    loss: SmoothLoss
    y: Rows
    mass: Rows

    def pull(self, f: Rows) -> Rows:
        return -self.mass * self.loss.derivative(self.y, f)

    def curvature(self, f: Rows) -> Rows:
        return self.mass * self.loss.curvature(self.y, f)


@dataclass(frozen=True)
class _Envelope:
    """Σ c_i min_s L(y_i, s) + (s − v_i)² / (2 step), v = f − step · u, with u the pulls of the round before."""

    loss: ProximalLoss
    y: Rows
    mass: Rows
    pulls: Rows
    step: float

    def pulls_at(self, f: Rows) -> Rows:
        """(s − v) / step: minus a subgradient of L at s, whatever v."""
        v = f - self.step * self.pulls
        return (self.loss.proximal(self.y, v, self.step) - v) / self.step

    def pull(self, f: Rows) -> Rows:
        return self.mass * self.pulls_at(f)

    def curvature(self, f: Rows) -> Rows:
        v = f - self.step * self.pulls
        return self.mass * (1.0 - self.loss.proximal_slope(self.y, v, self.step)) / self.step
