"""Minimise ½‖g‖² + Σ_i up_i (f_i − high_i)₊ + down_i (low_i − f_i)₊, f = g + b, g = K α, where most f_i end on an edge.

Each row has two sides, s = +1 at its high edge and s = −1 at its low one. Of s (f − edge) = over − room, both ≥ 0, what
is over costs `price`, and 0 ≤ pull ≤ price is the multiplier, with left = price − pull. At the minimum

    α = −Σ_s s · pull,   pull · room = 0,   left · over = 0,   Σ_i α_i = 0 if b is free.

Interior points keep both products of all rows near one number that goes to 0, by Newton steps that predict, then
correct [Mehrotra1992]_. Ten or so do, however many rows are on an edge, while the steps of `newton.minimise` have to
find out which rows are. Each step factors K + diag ρ of all rows, 1 / ρ being how fast the pulls of a row fall as its f
rises.
"""

from collections.abc import Iterator

import numpy as np

from halfseen.arrays import Rows
from halfseen.learning.svm.newton import Gram, Point
from halfseen.shapes import Float

Sides = Float[np.ndarray, "2 n"]
"""A number for the high and for the low side of each row."""

MOST_INTERIOR_STEPS = 50
SHORT_OF_THE_END = 0.995
"""Share of the longest step that is taken, so that nothing becomes 0."""

SIGN = np.array([[1.0], [-1.0]])


def interior_points(
    space: Gram, edges: Sides, prices: Sides, has_offset: bool, width: float
) -> Iterator[tuple[Point, Rows]]:
    """Come ever nearer to the minimum, from f = 0.

    Parameters
    ----------
    space
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
    nothing = np.zeros(edges.shape[1])
    point = Point(nothing, nothing, 0.0)
    over = np.maximum(-SIGN * edges, 0.0) + width
    # Pull, left, over and room of every side.
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
    """Step as if all products were to be 0, then again with the size of the products that this would leave."""
    pull, left, over, room = sides
    fall = 1.0 / (over / left + room / pull)
    newton = space.newton(fall.sum(axis=0), 0.5, has_offset, negligible=0.0)
    missed = SIGN * (point.f - edges) - (over - room)

    def move(wanted: Float[np.ndarray, "2 2 n"]) -> tuple[Rows, float, Float[np.ndarray, "4 2 n"]]:
        """Change the products by so much, as far as they are linear, and mend all else."""
        of_still = fall * (missed + wanted[0] / pull - wanted[1] / left)
        net = _net(pull + of_still)
        coefficients, offset = newton(point.coefficients, net)
        # K Δα + Δb, in the form in which the pulls follow it exactly.
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
    """The longest step, up to 1, at which nothing becomes negative."""
    return 1.0 / max(1.0, float((-change / sides).max()))
