"""Fits of vessels to points: standing, lying on a wall, lying on a handle; and two vessels in one sheet.

Cups may stand so close together that there is no depth step between them.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np

from halfseen.arrays import Points, RowMask, Rows, percentiles
from halfseen.perception.clouds import Vector
from halfseen.perception.marquardt import Bounds, Free, Frees, fitted, soft_l1
from halfseen.perception.solids import Vessel, around
from halfseen.perception.walls import (
    LARGEST_RADIUS_M,
    LYING_BOUNDS,
    STANDING_BOUNDS,
    USUAL_RADIUS_M,
    USUAL_SLOPE,
    WALL_NOISE_M,
    LyingWalls,
    Sets,
    StandingWalls,
    Walls,
)
from halfseen.shapes import Float, Int

# Prior spread of a lying vessel's axis about its pose with the wall on the table: height [m], tilt [rad]. Errors of
# neighbouring points are correlated, so the spreads are set to a fifth of their real values.
WALL_REST = (0.0005, 0.005)
HANDLE_REST = (0.002, 0.03)
# Number of points in a fit; the radius then has a standard error of half a millimetre.
NUM_POINTS_FITTED = 250
# Initial directions of the fit of a lying vessel, and how many of the best are refined.
NUM_DIRECTIONS, NUM_FOLLOWED = 8, 2
# The ends of the axis are at this percentile of the inliers and its complement [%].
END_PERCENT = 2.0
# Points this close to the wall belong to the vessel [m].
INLIER_M = 0.008
# A radius or slope this close to its bound is not that of a vessel.
AT_BOUND = 1e-4


def standing_vessels(sets: Sets) -> list[Vessel]:
    """Fit a standing vessel to each set of points.

    Parameters
    ----------
    sets
        Points of the walls of each as (right, away, height) [m].
    """
    if not sets:
        return []
    thin = [thinned(points) for points in sets]
    heights = [float(np.median(points[:, 2])) for points in thin]
    circles = [_circle(points[:, :2]) for points in thin]
    starts = np.array([[*middle, radius, USUAL_SLOPE] for middle, radius in circles])
    places, misfits = _solved(StandingWalls.of(thin, heights), starts, STANDING_BOUNDS)
    return [
        _standing(p, misfit, height, points)
        for p, misfit, height, points in zip(places, misfits, heights, sets, strict=True)
    ]


def _standing(p: Free, misfit: float, middle_height: float, points_m: Points) -> Vessel:
    centre = np.array([p[0], p[1], middle_height])
    axis = np.array([0.0, 0.0, 1.0])
    vessel = Vessel(centre, axis, float(p[2]), float(p[3]), (-middle_height, 0.0), float(misfit))
    return replace(vessel, ends_m=(-middle_height, _ends(vessel, points_m)[1]))


def lying_vessels(sets: Sets, num_on_handle: int = 0) -> list[Vessel]:
    """Fit a lying vessel to each set of points.

    Parameters
    ----------
    sets
        Points of the walls of each as (right, away, height) [m].
    num_on_handle
        Number of sets, at the end, whose vessels may rest on a handle: raised and tilted.
    """
    if not sets:
        return []
    thin = [each for each in map(thinned, sets) for _ in range(NUM_FOLLOWED)]
    middles = [middle for points in thin[::NUM_FOLLOWED] for middle in [np.median(points, axis=0)] * NUM_FOLLOWED]
    rests = np.repeat([WALL_REST, HANDLE_REST], NUM_FOLLOWED * np.array([len(sets) - num_on_handle, num_on_handle]), 0)
    walls = LyingWalls.of(thin, middles, *rests.T)
    starts = [_lying_starts(*each) for each in zip(thin[::NUM_FOLLOWED], middles[::NUM_FOLLOWED], strict=True)]
    p, misfits = _solved(walls, np.concatenate(starts), LYING_BOUNDS)
    best = np.arange(0, len(p), NUM_FOLLOWED) + misfits.reshape(-1, NUM_FOLLOWED).argmin(axis=1)
    is_turned = p[:, 3] < 0
    p[is_turned] = p[is_turned] * [-1.0, 1.0, 1.0, -1.0, 1.0, -1.0] + [0.0, 0.0, 0.0, 0.0, np.pi, 0.0]
    centres, axes = walls.places(p)
    vessels = [Vessel(centres[k], axes[k], float(p[k, 2]), float(p[k, 3]), (0.0, 0.0), float(misfits[k])) for k in best]
    return [replace(vessel, ends_m=_ends(vessel, points)) for vessel, points in zip(vessels, sets, strict=True)]


def _lying_starts(points: Points, middle: Vector) -> Frees:
    """Best initial parameters of a lying vessel."""
    radius = float(np.clip(points[:, 2].max() / 2, 0.015, 0.08))
    directions = 2 * np.pi * np.arange(NUM_DIRECTIONS) / NUM_DIRECTIONS
    # The visible part is the near side, so the axis is half a radius behind its middle.
    starts = np.array([[radius / 2 * np.cos(way), radius, radius, USUAL_SLOPE, way, 0.0] for way in directions])
    walls = LyingWalls.of([points[:0]] * NUM_DIRECTIONS, [middle] * NUM_DIRECTIONS, *WALL_REST)
    across, along = around(points, *walls.places(starts))
    costs = np.abs(across - np.maximum(radius + USUAL_SLOPE * along, 0.0)).mean(axis=1)
    return starts[np.argsort(costs, kind="stable")[:NUM_FOLLOWED]]


def flat_misfit(points_m: Points) -> float:
    """Mean robust cost of the best-fitting plane, on the scale of `Vessel.misfit`.

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
    """Subsample points by a constant stride, so that at most twice `num_points` remain.

    Parameters
    ----------
    points_m
        Points, in an order that spreads them over the surface.
    num_points
        Approximate number of points to keep.
    """
    return points_m[:: max(1, len(points_m) // num_points)]


def robust_cost(residuals_m: Rows) -> float:
    """Mean robust cost of residuals: quadratic if small against the noise, linear if large.

    Parameters
    ----------
    residuals_m
        Distances from a wall [m].
    """
    return float(np.mean(soft_l1(residuals_m / WALL_NOISE_M)))


def _solved(walls: Walls, starts: Frees, bounds: Bounds) -> tuple[Frees, Rows]:
    """Fitted parameters from each start, and the mean robust cost of a point.

    The cost is infinite for a radius or slope at its bound.
    """
    low, high = bounds.low, bounds.high
    p = fitted(walls, np.clip(starts, low + 1e-6, high - 1e-6), bounds)
    is_none = ((p < low + AT_BOUND) | (p > high - AT_BOUND)).any(axis=1)
    return p, np.where(is_none, np.inf, walls.misfits(p))


def _circle(across_m: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, "2"], float]:
    """Centre and radius by algebraic least squares (Kåsa); a default if the radius is not that of a vessel."""
    middle = across_m.mean(axis=0)
    offset = across_m - middle
    design = np.column_stack([2 * offset, np.ones(len(offset))])
    solution, *_ = np.linalg.lstsq(design, (offset**2).sum(axis=1), rcond=None)
    radius = float(np.sqrt(max(solution[2] + solution[:2] @ solution[:2], 0.0)))
    if not 0.5 * USUAL_RADIUS_M < radius < LARGEST_RADIUS_M / 2:
        return middle + np.array([0.0, USUAL_RADIUS_M / 2]), USUAL_RADIUS_M
    return middle + solution[:2], radius


def _ends(vessel: Vessel, points_m: Points) -> tuple[float, float]:
    outside, along = vessel.outside_along_m(points_m)
    is_inlier = np.abs(outside) < INLIER_M
    low, high = percentiles(along[is_inlier] if is_inlier.sum() > 10 else along, END_PERCENT, 100 - END_PERCENT)
    return float(low), float(high)


# Rounds of fitting two vessels and assigning each point to the closer one; they converge in three. A larger misfit in a
# round ends the search: most sheets that are not one vessel are not two either.
NUM_ROUNDS = 4
HOPELESS_MISFIT = 5.0
# Both vessels must fit this well, have this share of the points, and be no wider than a cup [m]: a single object that
# is not a vessel must not be split because its halves happen to be curved.
WORST_MISFIT_OF_TWO = 1.0
SMALLEST_SHARE = 0.15
WIDEST_RADIUS_M = 0.06
# Solids do not overlap: their middles are at least this share of the sum of the radii apart.
APART_SHARE = 0.8
# Fewest points that can distinguish two vessels from one.
FEWEST_POINTS = 300
# Largest number of vessels in a sheet. More than two must be cups that stand: as high and as wide [m], and of a smaller
# misfit, as small parts of boxes and tools are round, too. The largest misfit must fall by this factor in a round.
MOST_VESSELS, POINTS_OF_EACH, MOST_ROUNDS = 5, 100, 6
HEIGHT_OF_SEVERAL_M, WIDTH_OF_SEVERAL_M = (0.045, 0.17), 0.1
SMALLEST_RADIUS_OF_SEVERAL_M = 0.02
WORST_MISFIT_OF_SEVERAL, CONVERGING = 0.5, 0.9


def divided(points_m: Points) -> Int[np.ndarray, " n"] | None:
    """Divide the points of a sheet between vessels.

    Parameters
    ----------
    points_m
        Points of the sheet as (right, away, height) [m].

    Returns
    -------
    numpy.ndarray or None
        Number of the vessel of each point; None if the sheet does not show two or more.
    """
    if len(points_m) < FEWEST_POINTS:
        return None
    if (is_first := _two(points_m)) is not None:
        return np.where(is_first, 0, 1)
    *across_m, height_m = np.ptp(points_m, axis=0)
    if max(across_m) < WIDTH_OF_SEVERAL_M or not HEIGHT_OF_SEVERAL_M[0] < height_m < HEIGHT_OF_SEVERAL_M[1]:
        return None
    found = (_several(points_m, num) for num in range(3, MOST_VESSELS + 1))
    return next((each for each in found if each is not None), None)


def _several(points_m: Points, num: int) -> Int[np.ndarray, " n"] | None:
    sample, largest = thinned(np.random.default_rng(0).permutation(points_m), POINTS_OF_EACH * num), np.inf
    which = _clustered(sample[:, :2], num)
    for _ in range(MOST_ROUNDS):
        if np.bincount(which, minlength=num).min() < SMALLEST_SHARE / num * len(sample):
            return None
        vessels = standing_vessels([sample[which == k] for k in range(num)])
        before, largest = largest, max(vessel.misfit for vessel in vessels)
        if largest > max(CONVERGING * before, WORST_MISFIT_OF_SEVERAL):
            return None
        now = np.argmin([_distance_m(vessel, sample) for vessel in vessels], axis=0)
        if (now == which).all():
            break
        which = now
    is_cup = all(_is_cup(vessel) for vessel in vessels) and all(_are_two(*pair) for pair in combinations(vessels, 2))
    return np.argmin([_distance_m(vessel, points_m) for vessel in vessels], axis=0) if is_cup else None


def _is_cup(vessel: Vessel) -> bool:
    return (
        vessel.misfit < WORST_MISFIT_OF_SEVERAL
        and vessel.radius_m > SMALLEST_RADIUS_OF_SEVERAL_M
        and vessel.ends_m[1] - vessel.ends_m[0] > HEIGHT_OF_SEVERAL_M[0]
    )


def _clustered(across_m: Float[np.ndarray, "n 2"], num: int) -> Int[np.ndarray, " n"]:
    """Cluster points by k-means, from points far apart."""
    seeds = [int(np.linalg.norm(across_m - across_m.mean(axis=0), axis=1).argmax())]
    while len(seeds) < num:
        seeds.append(int(np.linalg.norm(across_m[:, None] - across_m[seeds], axis=2).min(axis=1).argmax()))
    middles = across_m[seeds]
    for _ in range(MOST_ROUNDS):
        which = np.linalg.norm(across_m[:, None] - middles, axis=2).argmin(axis=1)
        middles = np.stack([across_m[which == k].mean(axis=0) for k in range(num)])
    return which


def _two(points_m: Points) -> RowMask | None:
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
        # With the same assignment, the fit would not change.
        if (is_first == before).all():
            break
    return _distance_m(pair[0], points_m) < _distance_m(pair[1], points_m) if _are_two(*pair) else None


def _fitted(sets: Sets) -> list[Vessel]:
    """Best-fitting vessel of each set, standing or lying."""
    return [
        min(pair, key=lambda vessel: vessel.misfit)
        for pair in zip(standing_vessels(sets), lying_vessels(sets), strict=True)
    ]


def _distance_m(vessel: Vessel, points_m: Points) -> Rows:
    outside, along = vessel.outside_along_m(points_m)
    low, high = vessel.ends_m
    return np.abs(outside) + np.maximum(0.0, np.maximum(along - high, low - along))


def _are_two(one: Vessel, other: Vessel) -> bool:
    if max(one.misfit, other.misfit) > WORST_MISFIT_OF_TWO or max(one.radius_m, other.radius_m) > WIDEST_RADIUS_M:
        return False
    between: Float[np.ndarray, 2] = one.middle_m[:2] - other.middle_m[:2]
    return bool(np.linalg.norm(between) > APART_SHARE * (one.radius_m + other.radius_m))
