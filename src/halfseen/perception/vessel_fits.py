"""Vessels that fit points: standing, lying on a wall, lying on a handle."""

from dataclasses import replace

import numpy as np

from halfseen.arrays import Points, Rows
from halfseen.perception.solids import Vessel, around
from halfseen.perception.trust_region import Bounds, Free, Misses, fitted, soft_l1
from halfseen.perception.walls import (
    LARGEST_RADIUS_M,
    LYING_BOUNDS,
    STANDING_BOUNDS,
    USUAL_RADIUS_M,
    USUAL_SLOPE,
    WALL_NOISE_M,
    LyingWalls,
    StandingWalls,
)
from halfseen.shapes import Float

# How far the axis of a lying vessel is from where it is when the wall touches the table: in height [m], tilt [rad].
# Neighbouring points err together, so that the spreads are given a fifth of what they are.
WALL_REST = (0.0005, 0.005)
HANDLE_REST = (0.002, 0.03)
# Points that take part in a fit: enough for noise of half a millimetre in the radius.
NUM_POINTS_FITTED = 250
# Directions from which the fit of a lying vessel starts, and how many of the best are followed.
NUM_DIRECTIONS, NUM_FOLLOWED = 8, 2
# Ends of the axis are where the outermost percents of the inliers are [%].
END_PERCENT = 2.0
# Points this near to the wall belong to the vessel [m].
INLIER_M = 0.008
# A radius or slope this near to its bound is none of a vessel's.
AT_BOUND = 1e-4


def fit_standing(points_m: Points) -> Vessel:
    """Fit a standing vessel.

    Parameters
    ----------
    points_m
        Points of its walls as (right, away, height) [m].
    """
    points = thinned(points_m)
    middle_height = float(np.median(points[:, 2]))
    middle, radius = _circle(points[:, :2])
    walls, start = StandingWalls(points, middle_height), np.array([*middle, radius, USUAL_SLOPE])
    ((p, misfit),) = _solved(walls, [start], STANDING_BOUNDS, len(points))
    centre = np.array([p[0], p[1], middle_height])
    axis = np.array([0.0, 0.0, 1.0])
    vessel = Vessel(centre, axis, float(p[2]), float(p[3]), (-middle_height, 0.0), misfit)
    return replace(vessel, ends_m=(-middle_height, _ends(vessel, points_m)[1]))


def fit_lying(points_m: Points, *, is_on_wall: bool = True) -> Vessel:
    """Fit a vessel that lies on the table.

    Parameters
    ----------
    points_m
        Points of its walls as (right, away, height) [m].
    is_on_wall
        False lets it rest on a handle, too: raised and tilted.
    """
    points = thinned(points_m)
    walls = LyingWalls(points, np.median(points, axis=0), *(WALL_REST if is_on_wall else HANDLE_REST))
    starts = _lying_starts(walls)
    p, misfit = min(_solved(walls, starts, LYING_BOUNDS, len(points)), key=lambda pair: pair[1])
    if p[3] < 0:
        p = np.array([-p[0], p[1], p[2], -p[3], p[4] + np.pi, -p[5]])
    (centre,), (axis,) = walls.places(p[None])
    vessel = Vessel(centre, axis, float(p[2]), float(p[3]), (0.0, 0.0), misfit)
    return replace(vessel, ends_m=_ends(vessel, points_m))


def _lying_starts(walls: LyingWalls) -> list[Free]:
    """Parameters to start from, those that fit best."""
    points = walls.points_m
    radius = float(np.clip(points[:, 2].max() / 2, 0.015, 0.08))
    directions = 2 * np.pi * np.arange(NUM_DIRECTIONS) / NUM_DIRECTIONS
    # What is seen is the near side: the axis is half a radius behind its middle.
    starts = [np.array([radius / 2 * np.cos(way), radius, radius, USUAL_SLOPE, way, 0.0]) for way in directions]
    across, along = around(points, *walls.places(np.stack(starts)))
    costs = np.abs(across - np.maximum(radius + USUAL_SLOPE * along, 0.0)).mean(axis=1)
    return [starts[k] for k in np.argsort(costs, kind="stable")[:NUM_FOLLOWED]]


def flat_misfit(points_m: Points) -> float:
    """Mean robust cost of the plane that fits points best, on the scale of `Vessel.misfit`.

    Parameters
    ----------
    points_m
        Points of an object [m].
    """
    points = thinned(points_m)
    offset = points - points.mean(axis=0)
    across = np.linalg.svd(offset, full_matrices=False)[2][-1]
    return robust_cost(offset @ across)


def thinned(points_m: Points, num_points: int = NUM_POINTS_FITTED) -> Float[np.ndarray, "m 3"]:
    """Every so manyth point, so that at most twice `num_points` remain.

    Parameters
    ----------
    points_m
        Points, in an order that spreads them over the surface.
    num_points
        How many to keep, about.
    """
    return points_m[:: max(1, len(points_m) // num_points)]


def robust_cost(residuals_m: Rows) -> float:
    """Mean cost of residuals: square where small against the noise, linear where large.

    Parameters
    ----------
    residuals_m
        Distances from a wall [m].
    """
    return float(np.mean(soft_l1(residuals_m / WALL_NOISE_M)))


def _solved(walls: Misses, starts: list[Free], bounds: Bounds, num_points: int) -> list[tuple[Free, float]]:
    """Parameters that fit best from each start, and the mean robust cost of a point.

    Infinite is a radius or slope of no vessel.
    """
    low, high = bounds.low, bounds.high
    places = fitted(walls, [np.clip(start, low + 1e-6, high - 1e-6) for start in starts], bounds)
    is_none = [np.any(place.p < low + AT_BOUND) or np.any(place.p > high - AT_BOUND) for place in places]
    costs = [float(np.mean(soft_l1(place.residuals[:num_points]))) for place in places]
    return [
        (place.p, np.inf if at_bound else cost) for place, cost, at_bound in zip(places, costs, is_none, strict=True)
    ]


def _circle(across_m: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, "2"], float]:
    """Centre and radius by algebraic least squares (Kåsa), held to radii of vessels."""
    middle = across_m.mean(axis=0)
    offset = across_m - middle
    design = np.column_stack([2 * offset, np.ones(len(offset))])
    solution, *_ = np.linalg.lstsq(design, (offset**2).sum(axis=1), rcond=None)
    radius = float(np.sqrt(max(solution[2] + solution[:2] @ solution[:2], 0.0)))
    if not 0.5 * USUAL_RADIUS_M < radius < LARGEST_RADIUS_M / 2:
        return middle + np.array([0.0, USUAL_RADIUS_M / 2]), USUAL_RADIUS_M
    return middle + solution[:2], radius


def _ends(vessel: Vessel, points_m: Points) -> tuple[float, float]:
    along = vessel.along_m(points_m)
    is_inlier = np.abs(vessel.outside_m(points_m)) < INLIER_M
    low, high = np.percentile(along[is_inlier] if is_inlier.sum() > 10 else along, [END_PERCENT, 100 - END_PERCENT])
    return float(low), float(high)
