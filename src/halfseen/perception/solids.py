"""Solids that complete what is seen of an object: a vessel (cone frustum, standing or lying), or a convex hull.

Coordinates of this file are those of the table: right, away from the camera, height over the plane.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from halfseen.arrays import Points, Rows
from halfseen.perception.clouds import Vector

# Residuals of a fit are counted in units of this noise across a wall [m]; larger ones (handle, bottom) count linearly.
WALL_NOISE_M = 0.003
# What is usual for a vessel, so that a narrow stripe of wall does not become a barrel: mean and spread of the radius
# [m] and of the slope of the wall.
USUAL_RADIUS_M, RADIUS_SPREAD_M = 0.040, 0.020
USUAL_SLOPE, SLOPE_SPREAD = 0.10, 0.12
SMALLEST_RADIUS_M, LARGEST_RADIUS_M = 0.008, 0.13
STEEPEST_SLOPE = 1.5
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
NUM_AROUND = 40

# Free parameters of a fit: two of place, a radius [m], a slope, and those of direction if it has one.
Free: TypeAlias = Float[np.ndarray, " p"]
# Several sets of them, and what the points miss the vessel of each by.
Frees: TypeAlias = Float[np.ndarray, "k p"]
Residuals: TypeAlias = Float[np.ndarray, "k rows"]


@dataclass(frozen=True, eq=False)
class Vessel:
    """A cone frustum on the table.

    Parameters
    ----------
    centre_m
        Point of the axis at which `radius_m` holds: (right, away, height) [m].
    axis
        Unit vector along the axis; up for a standing vessel, towards the wider end for a lying one.
    radius_m
        Outer radius at `centre_m` [m].
    slope
        Growth of the radius along the axis.
    ends_m
        Where the vessel begins and ends along the axis, from `centre_m` [m].
    misfit
        Mean robust cost of a point; 1 is a residual of one noise, infinite is a radius or slope of no vessel.
    """

    centre_m: Vector
    axis: Vector
    radius_m: float
    slope: float
    ends_m: tuple[float, float]
    misfit: float

    @property
    def is_upright(self) -> bool:
        """True if the axis is vertical."""
        return bool(self.axis[2] > 0.9)

    @property
    def middle_m(self) -> Vector:
        """Middle of the axis [m]."""
        return self.centre_m + sum(self.ends_m) / 2 * self.axis

    def axis_ends_m(self) -> Points:
        """Return the ends of the axis [m]."""
        return np.stack([self.centre_m + end * self.axis for end in self.ends_m])

    def along_m(self, points_m: Points) -> Rows:
        """Position of points along the axis [m]."""
        return (points_m - self.centre_m) @ self.axis

    def outside_m(self, points_m: Points) -> Rows:
        """Distance of points from the wall, square to the axis [m]; negative inside."""
        radius, slope = np.full((1, 1), self.radius_m), np.full((1, 1), self.slope)
        return _outside_m(points_m, self.centre_m[None], self.axis[None], radius, slope)[0]

    def outline_m(self) -> Points:
        """Points of the two end circles [m]; their hull is the vessel."""
        side, other = _square_to(self.axis)
        angle = 2 * np.pi * np.arange(NUM_AROUND) / NUM_AROUND
        ring = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other
        ends = [
            self.centre_m + end * self.axis + max(self.radius_m + self.slope * end, 0.0) * ring for end in self.ends_m
        ]
        return np.concatenate(ends)


@dataclass(frozen=True, eq=False)
class Hull:
    """The convex hull of what is seen of an object, carried down to the table.

    Parameters
    ----------
    points_m
        Points as (right, away, height) [m].
    """

    points_m: Points

    @property
    def middle_m(self) -> Vector:
        """Middle of the box around the points [m]."""
        return (self.points_m.min(axis=0) + self.points_m.max(axis=0)) / 2

    def axis_ends_m(self) -> Points:
        """Foot and top of the vertical through the middle [m]."""
        return np.stack([self.middle_m * [1.0, 1.0, 0.0], self.middle_m * [1.0, 1.0, 2.0]])

    def outline_m(self) -> Points:
        """Return the points, and their shadows on the table [m]."""
        return np.concatenate([self.points_m, self.points_m * [1.0, 1.0, 0.0]])


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
    right, away, above = points[:, 0], points[:, 1], points[:, 2] - middle_height

    def residuals(p: Frees) -> Residuals:
        wall = p[:, 2:3] + p[:, 3:4] * above
        return np.hypot(right - p[:, 0:1], away - p[:, 1:2]) - wall

    p, misfit = _solve(residuals, np.array([*middle, radius, USUAL_SLOPE]))
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
    middle = np.median(points, axis=0)
    rest_spread_m, tilt_spread_rad = WALL_REST if is_on_wall else HANDLE_REST

    def residuals(p: Frees) -> Residuals:
        axes, centres_m = _lying_places(p, middle)
        return _outside_m(points, centres_m, axes, p[:, 2:3], p[:, 3:4])

    def prior(p: Frees) -> Residuals:
        tilt = np.arctan(p[:, 3])
        height = (p[:, 1] - p[:, 2] * np.cos(tilt)) / rest_spread_m
        return np.stack([height, (p[:, 5] - tilt) / tilt_spread_rad], axis=1)

    radius = float(np.clip(points[:, 2].max() / 2, 0.015, 0.08))
    directions = 2 * np.pi * np.arange(NUM_DIRECTIONS) / NUM_DIRECTIONS
    # What is seen is the near side: the axis is half a radius behind its middle.
    starts = [np.array([radius / 2 * np.cos(way), radius, radius, USUAL_SLOPE, way, 0.0]) for way in directions]
    costs = np.abs(residuals(np.stack(starts))).mean(axis=1)
    solved = [_solve(residuals, starts[k], prior) for k in np.argsort(costs, kind="stable")[:NUM_FOLLOWED]]
    p, misfit = min(solved, key=lambda pair: pair[1])
    if p[3] < 0:
        p = np.array([-p[0], p[1], p[2], -p[3], p[4] + np.pi, -p[5]])
    (axis,), (centre,) = _lying_places(p[None], middle)
    vessel = Vessel(centre, axis, float(p[2]), float(p[3]), (0.0, 0.0), misfit)
    return replace(vessel, ends_m=_ends(vessel, points_m))


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


def _lying_places(p: Frees, middle: Vector) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    """Axes and centres of vessels of (aside, height, radius, slope, direction, tilt), beside `middle`."""
    along, across = np.cos(p[:, 4]), np.sin(p[:, 4])
    level = np.cos(p[:, 5])
    axes = np.stack([level * along, level * across, np.sin(p[:, 5])], axis=1)
    return axes, np.stack([middle[0] - p[:, 0] * across, middle[1] + p[:, 0] * along, p[:, 1]], axis=1)


def _outside_m(
    points_m: Points,
    centres_m: Float[np.ndarray, "k 3"],
    axes: Float[np.ndarray, "k 3"],
    radii_m: Float[np.ndarray, "k 1"],
    slopes: Float[np.ndarray, "k 1"],
) -> Residuals:
    """Distances of points from the walls of several vessels, square to the axis of each [m]; negative inside."""
    offsets = points_m - centres_m[:, None]
    along = offsets @ axes[:, :, None]
    offsets -= along * axes[:, None]
    np.square(offsets, out=offsets)
    # In this order, as a sum over three is: results stay the same to the last bit.
    across = np.sqrt(offsets[..., 0] + offsets[..., 1] + offsets[..., 2])
    return across - np.maximum(radii_m + slopes * along[..., 0], 0.0)


def _solve(
    residuals: Callable[[Frees], Residuals], start: Free, more_prior: Callable[[Frees], Residuals] | None = None
) -> tuple[Free, float]:
    """Parameters that fit best, of which the third is a radius and the fourth a slope, and their mean robust cost."""

    def with_prior(p: Frees) -> Residuals:
        usual = [(p[:, 2:3] - USUAL_RADIUS_M) / RADIUS_SPREAD_M, (p[:, 3:4] - USUAL_SLOPE) / SLOPE_SPREAD]
        more = [more_prior(p)] if more_prior else []
        return np.concatenate([residuals(p) / WALL_NOISE_M, *usual, *more], axis=1)

    low, high = np.full(len(start), -np.inf), np.full(len(start), np.inf)
    low[2:4], high[2:4] = (SMALLEST_RADIUS_M, -STEEPEST_SLOPE), (LARGEST_RADIUS_M, STEEPEST_SLOPE)
    inside = np.clip(start, low + 1e-6, high - 1e-6)
    found = least_squares(
        lambda p: with_prior(p[None])[0],
        inside,
        jac=lambda p: _differences(with_prior, p, low, high),  # pyright: ignore[reportArgumentType]
        bounds=(low, high),
        loss="soft_l1",
        max_nfev=30,
    )
    at_bound = bool(np.any(found.x[2:4] < low[2:4] + 1e-4) or np.any(found.x[2:4] > high[2:4] - 1e-4))
    return found.x, np.inf if at_bound else robust_cost(residuals(found.x[None])[0])


def _differences(
    residuals: Callable[[Frees], Residuals], p: Free, low: Free, high: Free
) -> Float[np.ndarray, "rows p"]:
    """Jacobian by the differences that `least_squares` takes itself, with all parameters changed in one call."""
    step = np.sqrt(np.finfo(np.float64).eps) * np.where(p >= 0, 1.0, -1.0) * np.maximum(1.0, np.abs(p))
    step = np.where((p + step < low) | (p + step > high), -step, step)
    there = p + step
    values = residuals(np.concatenate([p[None], np.where(np.eye(len(p), dtype=bool), there, p)]))
    return ((values[1:] - values[0]) / (there - p)[:, None]).T


def robust_cost(residuals_m: Rows) -> float:
    """Mean cost of residuals: square where small against the noise, linear where large.

    Parameters
    ----------
    residuals_m
        Distances from a wall [m].
    """
    return float(np.mean(2 * (np.sqrt(1 + (residuals_m / WALL_NOISE_M) ** 2) - 1)))


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


def _square_to(axis: Vector) -> tuple[Vector, Vector]:
    aside = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    side = np.cross(axis, aside)
    side /= np.linalg.norm(side)
    return side, np.cross(axis, side)
