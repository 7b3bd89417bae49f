"""The censored SVM's optimum: min over f = g + b of λ‖g‖² + Σ_i c_i L(y_i, f_i), c_i = w_i / n (paper, eqs. 1 and 2).

A smooth loss is minimised by Newton steps. Any other is smoothed by its Moreau envelope around the last multipliers,
which is the augmented Lagrangian of the constraint s = f: each round minimises a smooth function and updates the
multipliers. Only the rows near a kink carry curvature, so the linear systems stay small [LiSunToh2018]_. If λ is so
small that most rows will lie on a kink, an interior-point method comes first, which takes a fifth of the time there,
and rounds polish its result.

With u_i ∈ −∂L(y_i, f_i), the negative of a subgradient, called the *pull* of row i, the dual problem is to maximise

    −λ‖g_u‖² − Σ_i c_i L*(y_i, −u_i),   2 λ g_u = Σ_i c_i u_i k(z_i, ·),   Σ_i c_i u_i = 0 if b is free.

If λ = 0 there is no penalty, and Σ_i c_i u_i z_i = 0 as well. The difference between the two objectives, the *duality
gap*, bounds the distance of the solution's objective from the optimum.

The *interior-point method* minimises ½‖g‖² + Σ_i up_i (f_i − high_i)₊ + down_i (low_i − f_i)₊, g = K α. Each row has
two sides, s = +1 at its high edge and s = −1 at its low one. In s (f − edge) = over − room, both ≥ 0, the excess `over`
costs `price`, and 0 ≤ pull ≤ price is the multiplier, with left = price − pull. At the minimum

    α = −Σ_s s · pull,   pull · room = 0,   left · over = 0,   Σ_i α_i = 0 if b is free.

Both products of all rows are kept near one number that goes to 0, by predictor–corrector Newton steps [Mehrotra1992]_.
About ten steps suffice, however many rows are on an edge, whereas the steps of `newton.minimise` must find out which
rows are. Each step factorises K + diag ρ of all rows, where 1 / ρ is the rate at which the pulls of a row fall as its f
rises.
"""

from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import no_type_check

import numpy as np

from halfseen.arrays import Rows
from halfseen.learning.svm.losses import Loss, PiecewiseLoss
from halfseen.learning.svm.newton import Coefficients, Features, Gram, Point, Space, minimise
from halfseen.shapes import Float, Int
from halfseen.workers.threads import one_thread

SMALL = 2000
"""Rows up to which one BLAS thread is used: a second gains little, and on a busy machine the threads wait for each
other."""

MAX_ROUNDS = 60
PATIENCE = 8
"""Rounds or interior-point steps without a smaller gap after which rounding is assumed to dominate."""
SHRINK = 0.2
ENOUGH = 0.1
"""After a round that leaves less than this proportion of the gap, the step is not reduced."""
ROUNDING = 1e-15
"""Predicted decreases and gaps below this share of the loss of f = 0 are not significant."""
IMBALANCE = 1e-11
"""Pulls cancel if their sum is below this share of the sum of their absolute values."""
WEAK = 10.0
"""If rows could each pull f by this multiple of the spread of the targets, most will lie on a kink."""
ROOM = 1e-7
"""A pull that can move this far both ways is in the interior of its range."""

Sides = Float[np.ndarray, "2 n"]
"""One number for the high and one for the low side of each row."""

MOST_INTERIOR_STEPS = 50
SHORT_OF_THE_END = 0.995
"""Share of the longest feasible step that is taken, so that every variable stays positive."""

SIGN = np.array([[1.0], [-1.0]])


@dataclass(frozen=True)
class Problem:
    """The optimisation problem; omit rows of weight 0."""

    space: Space
    y: Rows
    mass: Rows
    """c_i = w_i / n, > 0."""
    loss: Loss
    reg: float
    """λ; 0 requires features of full rank."""
    has_offset: bool

    def part(self, rows: Int[np.ndarray, " r"]) -> "Problem":
        """The problem on some of the rows, with n reduced in proportion."""
        mass = self.mass[rows] * len(self.y) / len(rows)
        return replace(self, space=self.space.part(rows), y=self.y[rows], mass=mass)

    @property
    def scale(self) -> float:
        """Loss of f = 0, the scale for comparisons."""
        return float(self.mass @ np.abs(self.loss.value(self.y, np.zeros(len(self.y))))) or 1.0


@dataclass(frozen=True)
class Solution:
    """A minimiser and its certificate."""

    coefficients: Coefficients
    offset: float
    pull: Rows
    """u: the negative of a subgradient of the loss at each row."""
    objective: float
    gap: float
    """Objective minus dual objective: the optimum is at most this much lower."""
    rounding: float
    """A gap up to this is not significant: some units in the last place of the loss of f = 0."""

    @property
    def relative_gap(self) -> float:
        """The gap as a share of the objective; 0 if it is only rounding."""
        return 0.0 if self.gap <= self.rounding else self.gap / max(abs(self.objective), np.finfo(float).tiny)

    def meets(self, tolerance: float, least_objective: float) -> bool:
        """Whether the gap is a small enough share of the objective."""
        return bool(self.gap <= max(tolerance * max(self.objective, least_objective), self.rounding))


def solve(
    problem: Problem, tolerance: float = 1e-8, start: Solution | None = None, least_objective: float = 0.0
) -> Solution:
    """Solve to a relative duality gap of `tolerance`, or as close as rounding allows.

    Parameters
    ----------
    problem
        The problem.
    tolerance
        Largest relative duality gap.
    start
        The solution of a problem on the same rows, for example with another λ.
    least_objective
        When gaps are compared, the objective counts as at least this share of the loss of f = 0.
    """
    # Shift a central target to 0 if the offset can absorb it: far from 0, f is large relative to its rounding.
    can_move = problem.has_offset and problem.loss.is_of_difference
    centre = float(np.sort(problem.y)[len(problem.y) // 2]) if can_move else 0.0
    start = replace(start, offset=start.offset - centre) if start else None
    problem = replace(problem, y=problem.y - centre)
    goal = tolerance, least_objective * problem.scale
    with one_thread() if len(problem.y) <= SMALL else nullcontext():
        inside = _from_inside(problem, goal)
        found = inside if inside and inside.meets(*goal) else _by_rounds(problem, inside or start, goal)
    found = min(inside or found, found, key=_preference)
    return replace(found, offset=found.offset + centre)


def best_constant(y: Rows, weight: Rows, loss: Loss) -> float:
    """Find the constant that minimises Σ w L(y, c)."""
    return solve(Problem(Features(np.zeros((len(y), 0))), y, weight / weight.sum(), loss, 1.0, True)).offset


def _preference(found: Solution) -> tuple[float, float]:
    return found.gap, found.objective


def _from_inside(problem: Problem, goal: tuple[float, float]) -> Solution | None:
    """Run the interior-point method until it stops improving; None if few rows are expected on a kink."""
    space, loss = problem.space, problem.loss
    if not (isinstance(space, Gram) and isinstance(loss, PiecewiseLoss)) or loss.is_smooth:
        return None
    edges, prices = np.stack(loss.edges(problem.y)[::-1]), np.outer([loss.up, loss.down], problem.mass)
    prices /= 2.0 * problem.reg
    width, could_pull = float(np.std(problem.y)), float(np.median(space.matrix.diagonal() * prices))
    if not (np.isfinite(edges).all() and prices.all() and 0.0 < WEAK * width < could_pull):
        return None
    best, in_vain = None, 0
    # Two threads take half the time at best, and five times as long on a busy machine.
    with one_thread():
        for point, alpha in interior_points(space, edges, prices, problem.has_offset, width):
            found = certify(problem, point, 2.0 * problem.reg * alpha / problem.mass)
            in_vain = 0 if best is None or found.gap < best.gap else in_vain + 1
            best = found if in_vain == 0 else best
            if found.meets(*goal) or in_vain == PATIENCE:
                break
    return best


def _by_rounds(problem: Problem, start: Solution | None, goal: tuple[float, float]) -> Solution:
    """Minimise envelopes with decreasing steps, each around the previous pulls; a smooth loss is its own envelope."""
    loss, scale, num_rows = problem.loss, problem.scale, len(problem.y)
    point = Point(np.zeros(problem.space.matrix.shape[1]), np.zeros(num_rows), 0.0)
    if start:
        point = Point(start.coefficients, problem.space.matrix @ start.coefficients, start.offset)
    step = 0.0 if loss.is_smooth else float(np.std(problem.y)) or 1.0
    pulls = np.zeros(num_rows) if start is None or loss.is_smooth else start.pull
    tolerance = ROUNDING * scale if loss.is_smooth else 1e-3 * scale
    best, in_vain, last = None, 0, np.inf
    for _ in range(1 if loss.is_smooth else MAX_ROUNDS):
        envelope = _Envelope(loss, problem.y, problem.mass, pulls, step)
        point = minimise(problem.space, envelope, problem.reg, problem.has_offset, point, tolerance)
        pulls = envelope.pulls_at(point.f)
        found = certify(problem, point, pulls)
        best = found if best is None else min(best, found, key=_preference)
        in_vain = 0 if found is best else in_vain + 1
        if best.meets(*goal) or in_vain == PATIENCE:
            break
        tolerance = max(min(0.1 * tolerance, 1e-2 * found.gap), ROUNDING * min(scale, best.objective))
        step, last = step * (1.0 if found.gap < ENOUGH * last else SHRINK), found.gap
    assert best is not None
    return best


@no_type_check
@dataclass(frozen=True)
class _Envelope:
    """Σ c_i min_s L(y_i, s) + (s − v_i)² / (2 step), v = f − step · u, with u the pulls of the previous round."""

    loss: Loss
    y: Rows
    mass: Rows
    pulls: Rows
    step: float

    def pulls_at(self, f: Rows) -> Rows:
        """The negative of a subgradient of L at the minimising s of each row."""
        return -self.loss.slope(self.y, f - self.step * self.pulls, self.step)

    def pull(self, f: Rows) -> Rows:
        return self.mass * self.pulls_at(f)

    def curvature(self, f: Rows) -> Rows:
        return self.mass * self.loss.curvature(self.y, f - self.step * self.pulls, self.step)


def certify(problem: Problem, point: Point, pulls: Rows) -> Solution:
    """Certify a candidate by the better of two dual bounds: that of the pulls, and that of pulls of 0."""
    pulls = _balanced(problem, pulls)
    dual = max(_dual(problem, pulls), _dual(problem, np.zeros(len(pulls))))
    norm = problem.space.inner(point.coefficients, point.coefficients, point.values)
    objective = problem.reg * norm + float(problem.mass @ problem.loss.value(problem.y, point.f))
    gap = max(objective - dual, 0.0)
    return Solution(point.coefficients, point.offset, pulls, objective, gap, ROUNDING * problem.scale)


def _dual(problem: Problem, pulls: Rows) -> float:
    norm = problem.space.squared_norm(problem.mass * pulls) / (4.0 * problem.reg) if problem.reg > 0.0 else 0.0
    return -norm - float(problem.mass @ problem.loss.conjugate(problem.y, -pulls))


def _balanced(problem: Problem, pulls: Rows) -> Rows:
    """Make Σ c u z = 0 for unpenalised z: the constant for the offset, and the features if λ = 0; else pulls of 0."""
    if problem.reg == 0.0:
        return _orthogonal(problem, pulls)
    if not problem.has_offset:
        return pulls
    # Shrink the larger side: smaller pulls are subgradients, too.
    forces = problem.mass * pulls
    up, down = forces[forces > 0.0].sum(), -forces[forces < 0.0].sum()
    return np.where(pulls > 0.0, min(down / up, 1.0) if up else 1.0, min(up / down, 1.0) if down else 1.0) * pulls


def _orthogonal(problem: Problem, pulls: Rows) -> Rows:
    """Move interior pulls so that the forces are orthogonal to every column of f; pulls of 0 if that fails."""
    columns = np.column_stack([problem.space.matrix, np.ones((len(pulls), int(problem.has_offset)))])
    has_room = np.isfinite([problem.loss.conjugate(problem.y, way - pulls) for way in (ROOM, -ROOM)]).all(axis=0)
    movable, moved = columns[has_room], pulls.copy()
    system = movable.T @ (problem.mass[has_room, None] * movable)
    moved[has_room] -= movable @ np.linalg.lstsq(system, columns.T @ (problem.mass * pulls))[0]
    forces = problem.mass * moved
    cancels = np.abs(columns.T @ forces) <= IMBALANCE * (np.abs(columns.T) @ np.abs(forces))
    return moved if cancels.all() else np.zeros(len(pulls))


def interior_points(
    space: Gram, edges: Sides, prices: Sides, has_offset: bool, width: float
) -> Iterator[tuple[Point, Rows]]:
    """Iterate towards the minimum, from f = 0.

    Parameters
    ----------
    space
        K.
    edges
        High and low edge of each row.
    prices
        Up and down prices, both > 0.
    has_offset
        Whether b is free.
    width
        Scale of f, > 0: initial distance of each row from its edges.

    Yields
    ------
    tuple
        The point, and α by the multipliers, which gives a bound at every step and converges to the point's own.
    """
    nothing = np.zeros(edges.shape[1])
    point = Point(nothing, nothing, 0.0)
    over = np.maximum(-SIGN * edges, 0.0) + width
    # Pull, left, over and room of each side.
    sides = np.stack([0.5 * prices, 0.5 * prices, over, over + SIGN * edges])
    for _ in range(MOST_INTERIOR_STEPS):
        yield point, _net(sides[0])
        move, change = _step(space, edges, point, sides, has_offset)
        share = min(1.0, SHORT_OF_THE_END * _longest(sides, change))
        point, sides = point.plus(share, move), sides + share * change
        if not np.isfinite(sides).all():
            return


def _step(
    space: Gram, edges: Sides, point: Point, sides: Float[np.ndarray, "4 2 n"], has_offset: bool
) -> tuple[Point, Float[np.ndarray, "4 2 n"]]:
    """Predict a step to products of 0, then correct it to the size of the products that it would leave."""
    pull, left, over, room = sides
    fall = 1.0 / (over / left + room / pull)
    newton = space.newton(fall.sum(axis=0), 0.5, has_offset, negligible=0.0)
    missed = SIGN * (point.f - edges) - (over - room)

    def move(wanted: Float[np.ndarray, "2 2 n"]) -> tuple[Rows, float, Float[np.ndarray, "4 2 n"]]:
        """Step that changes the products by `wanted`, to first order, and removes all other residuals."""
        of_still = fall * (missed + wanted[0] / pull - wanted[1] / left)
        net = _net(pull + of_still)
        coefficients, offset = newton(point.coefficients, net)
        # K Δα + Δb, in a form that is exactly consistent with the pulls.
        rise = (net - point.coefficients - coefficients) / fall.sum(axis=0)
        d_pull = of_still + fall * SIGN * rise
        change = np.stack([d_pull, -d_pull, (wanted[1] + over * d_pull) / left, (wanted[0] - room * d_pull) / pull])
        return coefficients, offset, change

    products = _products(sides)
    *_, ahead = move(-products)
    mean, would_be = products.mean(), _products(sides + _longest(sides, ahead) * ahead).mean()
    coefficients, offset, change = move(mean * (would_be / mean) ** 3 - products - _products(ahead))
    return Point(coefficients, space.matrix @ coefficients, offset), change


def _products(sides: Float[np.ndarray, "4 2 n"]) -> Float[np.ndarray, "2 2 n"]:
    """Pull · room, and left · over."""
    return np.stack([sides[0] * sides[3], sides[1] * sides[2]])


def _net(pulls: Sides) -> Rows:
    return pulls[1] - pulls[0]


def _longest(sides: Float[np.ndarray, "4 2 n"], change: Float[np.ndarray, "4 2 n"]) -> float:
    """The longest step, up to 1, at which no variable becomes negative."""
    return 1.0 / max(1.0, float((-change / sides).max()))
