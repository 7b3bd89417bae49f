"""Minimise ½‖g‖² + Σ_i up_i (f_i − high_i)₊ + down_i (low_i − f_i)₊, f = g + b, g = K α, where most f_i end on an edge.

Each row has two sides, s = +1 at its high edge and s = −1 at its low one. Of s (f − edge) = over − room, both ≥ 0, what
is over costs `price`, and 0 ≤ pull ≤ price is the multiplier, with left = price − pull. At the minimum

    α = −Σ_s s · pull,   pull · room = 0,   left · over = 0,   Σ_i α_i = 0 if b is free.

Interior points keep both products of all rows near one number that goes to 0, by Newton steps that predict, then
correct [Mehrotra1992]_. Ten or so do, however many rows are on an edge, while the steps of `newton` have to find out
which rows are. Each step factors K + diag ρ of all rows, 1 / ρ being how fast the pulls of a row fall as its f rises.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Float

from halfseen.arrays import Rows
from halfseen.learning.svm.newton import Point
from halfseen.learning.svm.spaces import factored

Sides = Float[np.ndarray, "2 n"]
"""A number for the high and for the low side of each row."""
Solve = Callable[[Float[np.ndarray, "n k"]], Float[np.ndarray, "n k"]]

MAX_STEPS = 50
_SHORT_OF_THE_END = 0.995
"""Share of the longest step that is taken, so that nothing becomes 0."""
SINGLE_MISSES = 1e-2
"""What a solution in single precision may miss, as a share of the right side; it is refined once."""

_SIGN = np.array([[1.0], [-1.0]])


class _State(NamedTuple):
    """A candidate, or what a step adds to one."""

    coefficients: Rows
    values: Rows
    offset: float
    positive: Float[np.ndarray, "4 2 n"]
    """Pull, left, over and room of every side."""

    def plus(self, share: float, move: "_State") -> "_State":
        return _State(
            self.coefficients + share * move.coefficients,
            self.values + share * move.values,
            self.offset + share * move.offset,
            self.positive + share * move.positive,
        )

    @property
    def products(self) -> Float[np.ndarray, "2 2 n"]:
        """Pull · room, and left · over."""
        pull, left, over, room = self.positive
        return np.stack([pull * room, left * over])


def interior_points(
    gram: Float[np.ndarray, "n n"], edges: Sides, prices: Sides, has_offset: bool, width: float
) -> Iterator[tuple[Point, Rows]]:
    """Come ever nearer to the minimum, from f = 0.

    Parameters
    ----------
    gram
        K.
    edges
        High and low edge of each row.
    prices
        Up and down, both > 0.
    has_offset
        Whether b is free.
    width
        Size of the numbers f, > 0: how far from its edges each row is first taken to be.

    Yields
    ------
    tuple
        The point, and α by the multipliers: it is the point's own in the end, and gives a bound on the way.
    """
    num_rows = len(gram)
    beyond = -_SIGN * edges
    over = np.maximum(beyond, 0.0) + width
    first = np.stack([0.5 * prices, 0.5 * prices, over, over - beyond])
    state = _State(np.zeros(num_rows), np.zeros(num_rows), 0.0, first)
    for _ in range(MAX_STEPS):
        yield Point(state.coefficients, state.values, state.offset), _alpha(state.positive[0])
        state = _next(gram, edges, state, has_offset)
        if not np.isfinite(state.positive).all():
            return


def _alpha(pulls: Sides) -> Rows:
    return pulls[1] - pulls[0]


def _next(gram: Float[np.ndarray, "n n"], edges: Sides, state: _State, has_offset: bool) -> _State:
    """Step as if all products were to be 0, then again with the size of the products that this would leave."""
    pull, left, over, room = state.positive
    fall = 1.0 / (over / left + room / pull)
    ridge = 1.0 / fall.sum(axis=0)
    solve = _solver(gram, ridge)
    of_ones = solve(np.ones((len(gram), 1)))[:, 0] if has_offset else None
    newton = _Newton(edges, state, fall, ridge, solve, of_ones)
    products = state.products
    predicted = newton.move(-products)
    mean = products.mean()
    would_be = state.plus(_longest(state, predicted), predicted).products.mean()
    d_pull, d_left, d_over, d_room = predicted.positive
    curved = np.stack([d_pull * d_room, d_left * d_over])
    move = newton.move(mean * (would_be / mean) ** 3 - products - curved)
    move = move._replace(values=gram @ move.coefficients)
    return state.plus(min(1.0, _SHORT_OF_THE_END * _longest(state, move)), move)


class _Newton(NamedTuple):
    """The equations of a step, factored."""

    edges: Sides
    state: _State
    fall: Sides
    """How fast each pull falls as s (f − edge) rises."""
    ridge: Rows
    solve: Solve
    of_ones: Rows | None
    """Solution for a right side of ones, if b is free."""

    def move(self, wanted: Float[np.ndarray, "2 2 n"]) -> _State:
        """Change the products by so much, as far as they are linear, and mend all else."""
        pull, left, over, room = self.state.positive
        missed = _SIGN * (self.state.values + self.state.offset - self.edges) - (over - room)
        of_still = self.fall * (missed + wanted[0] / pull - wanted[1] / left)
        lacking = _alpha(pull + of_still) - self.state.coefficients
        step, offset = self.solve((self.ridge * lacking)[:, None])[:, 0], 0.0
        if self.of_ones is not None:
            offset = float((step.sum() + self.state.coefficients.sum()) / self.of_ones.sum())
            step = step - offset * self.of_ones
        rise = self.ridge * (lacking - step)
        d_pull = of_still + self.fall * _SIGN * rise
        changes = [d_pull, -d_pull, (wanted[1] + over * d_pull) / left, (wanted[0] - room * d_pull) / pull]
        return _State(step, rise - offset, offset, np.stack(changes))


def _longest(state: _State, move: _State) -> float:
    """The longest step, up to 1, at which nothing becomes negative."""
    return 1.0 / max(1.0, float((-move.positive / state.positive).max()))


def _solver(gram: Float[np.ndarray, "n n"], ridge: Rows) -> Solve:
    """Solve (K + diag ρ) x = r by a factor in single precision, which takes half the time; in double if that misses."""
    return _solver_in_single(gram, ridge) or _solver_in_double(gram, ridge)


def _solver_in_single(gram: Float[np.ndarray, "n n"], ridge: Rows) -> Solve | None:
    # What is too large for it becomes infinite, and is missed.
    with np.errstate(over="ignore"):
        system = gram.astype(np.float32)
        system[np.diag_indices_from(system)] += ridge.astype(np.float32)
    # LAPACK counts by columns, and to it the rows of a symmetric matrix are as good: nothing is copied.
    (potrf,) = scipy.linalg.get_lapack_funcs(["potrf"], [system])
    factor, failed = potrf(system.T, lower=1, clean=0, overwrite_a=1)

    def once(right: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        size = np.abs(right).max() or 1.0
        solved = scipy.linalg.cho_solve((factor, True), (right / size).astype(np.float32), check_finite=False)
        return size * solved.astype(np.float64)

    def missed(right: Float[np.ndarray, "n k"], solved: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        return right - gram @ solved - ridge[:, None] * solved

    def refined(right: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        solved = once(right)
        return solved + once(missed(right, solved))

    ones = np.ones((len(gram), 1))
    if not failed and np.abs(missed(ones, once(ones))).max() <= SINGLE_MISSES:
        return refined
    return None


def _solver_in_double(gram: Float[np.ndarray, "n n"], ridge: Rows) -> Solve:
    system = gram.copy()
    system[np.diag_indices_from(system)] += ridge
    factor = factored(system)
    return lambda right: scipy.linalg.cho_solve(factor, right, check_finite=False)
