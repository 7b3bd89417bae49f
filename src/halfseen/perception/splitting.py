"""Two vessels in one sheet: cups so near to one another that no step in depth lies between them."""

from collections.abc import Sequence

import numpy as np

from halfseen.arrays import Points, RowMask, Rows
from halfseen.perception.solids import Vessel
from halfseen.perception.vessel_fits import lying_vessels, standing_vessels, thinned
from halfseen.shapes import Float

# Rounds of fitting two vessels and giving each point to the nearer one; they settle in three. A misfit that is worse
# after the first is given up: most sheets that are no vessel are no two either.
NUM_ROUNDS = 4
HOPELESS_MISFIT = 5.0
# Both vessels must fit this well, hold this share of the points, and be no wider than a cup [m]: a lone object that
# is no vessel must never be split because its halves might be bent.
WORST_MISFIT = 1.0
SMALLEST_SHARE = 0.15
LARGEST_RADIUS_M = 0.06
# Solids share no room: middles are at least this share of the sum of the radii apart.
APART_SHARE = 0.8
# Fewer points do not tell two vessels from one.
FEWEST_POINTS = 300


def divided(points_m: Points) -> RowMask | None:
    """Divide the points of a sheet between two vessels.

    Parameters
    ----------
    points_m
        Points of the sheet as (right, away, height) [m].

    Returns
    -------
    RowMask or None
        True for the points of the first vessel; None if the sheet does not show two.
    """
    if len(points_m) < FEWEST_POINTS:
        return None
    sample = thinned(np.random.default_rng(0).permutation(points_m), 500)
    across = sample[:, :2] - sample[:, :2].mean(axis=0)
    is_first = across @ np.linalg.svd(across, full_matrices=False)[2][0] > 0
    for _ in range(NUM_ROUNDS):
        if not SMALLEST_SHARE < is_first.mean() < 1 - SMALLEST_SHARE:
            return None
        pair = _fitted([sample[is_first], sample[~is_first]])
        if max(vessel.misfit for vessel in pair) > HOPELESS_MISFIT:
            return None
        before, is_first = is_first, _distance_m(pair[0], sample) < _distance_m(pair[1], sample)
        # What is settled would be fitted again, to the same.
        if (is_first == before).all():
            break
    return _distance_m(pair[0], points_m) < _distance_m(pair[1], points_m) if _are_two(*pair) else None


def _fitted(sets: Sequence[Float[np.ndarray, "_ 3"]]) -> list[Vessel]:
    """Vessel that fits each set best, standing or lying."""
    return [
        min(pair, key=lambda vessel: vessel.misfit)
        for pair in zip(standing_vessels(sets), lying_vessels(sets), strict=True)
    ]


def _distance_m(vessel: Vessel, points_m: Points) -> Rows:
    along = vessel.along_m(points_m)
    low, high = vessel.ends_m
    return np.abs(vessel.outside_m(points_m)) + np.maximum(0.0, np.maximum(along - high, low - along))


def _are_two(one: Vessel, other: Vessel) -> bool:
    if max(one.misfit, other.misfit) > WORST_MISFIT or max(one.radius_m, other.radius_m) > LARGEST_RADIUS_M:
        return False
    between: Float[np.ndarray, 2] = one.middle_m[:2] - other.middle_m[:2]
    return bool(np.linalg.norm(between) > APART_SHARE * (one.radius_m + other.radius_m))
