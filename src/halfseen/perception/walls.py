"""By how much points miss the wall of a vessel, and how that changes with where it is: what a fit makes small.

Parameters of a standing vessel are its place (right, away), a radius and a slope; of a lying one, its place (aside,
height), a radius, a slope, and the direction and tilt of its axis. Residuals are those of the points, then how far
parameters are from what is usual. How they change is told by small differences; radius and slope move no axis.
"""

from dataclasses import dataclass

import numpy as np

from halfseen.arrays import Points
from halfseen.perception.clouds import Vector
from halfseen.perception.solids import around
from halfseen.perception.trust_region import Bounds, Frees
from halfseen.shapes import Float

# Residuals of a fit are counted in units of this noise across a wall [m]; larger ones (handle, bottom) count linearly.
WALL_NOISE_M = 0.003
# What is usual for a vessel, so that a narrow stripe of wall does not become a barrel: mean and spread of the radius
# [m] and of the slope of the wall.
USUAL_RADIUS_M, RADIUS_SPREAD_M = 0.040, 0.020
USUAL_SLOPE, SLOPE_SPREAD = 0.10, 0.12
SMALLEST_RADIUS_M, LARGEST_RADIUS_M = 0.008, 0.13
STEEPEST_SLOPE = 1.5
# Step of a difference, relative to a parameter or to 1.
DIFFERENCE = float(np.sqrt(np.finfo(np.float64).eps))

Residuals = Float[np.ndarray, "k rows"]
Slopes = Float[np.ndarray, "k p rows"]


def _bounds(num_free: int) -> Bounds:
    """Bounds of radius and slope, the third and the fourth parameter."""
    low, high = np.full(num_free, -np.inf), np.full(num_free, np.inf)
    low[2:4], high[2:4] = (SMALLEST_RADIUS_M, -STEEPEST_SLOPE), (LARGEST_RADIUS_M, STEEPEST_SLOPE)
    return Bounds(low, high)


STANDING_BOUNDS, LYING_BOUNDS = _bounds(4), _bounds(6)


@dataclass(frozen=True, eq=False)
class StandingWalls:
    """Walls of standing vessels beside points.

    Parameters
    ----------
    points_m
        Points as (right, away, height) [m].
    middle_height_m
        Where the radius holds [m].
    """

    points_m: Points
    middle_height_m: float

    def at(self, p: Frees) -> tuple[Residuals, Slopes]:
        """Residuals of several, and how each parameter changes them."""
        right, away, height = self.points_m.T
        each, step = _each_changed(p, STANDING_BOUNDS)
        across = np.hypot(right - each[:, :3, :1], away - each[:, :3, 1:2])
        radius = each[:, [0, 3, 4], 2:3] + each[:, [0, 3, 4], 3:4] * (height - self.middle_height_m)
        rows = np.empty((*each.shape[:2], len(right) + 2))
        np.subtract(across, radius[:, :1], out=rows[:, :3, :-2])
        np.subtract(across[:, :1], radius[:, 1:], out=rows[:, 3:, :-2])
        rows[..., :-2] /= WALL_NOISE_M
        _unusual(each, rows[..., -2:])
        return _differences(rows, step)


@dataclass(frozen=True, eq=False)
class LyingWalls:
    """Walls of lying vessels beside points.

    Parameters
    ----------
    points_m
        Points as (right, away, height) [m].
    middle_m
        Beside which the places are [m].
    rest_spread_m, tilt_spread_rad
        How far the axis is from where it is when the wall touches the table: in height [m], tilt [rad].
    """

    points_m: Points
    middle_m: Vector
    rest_spread_m: float
    tilt_spread_rad: float

    def at(self, p: Frees) -> tuple[Residuals, Slopes]:
        """Residuals of several, and how each parameter changes them."""
        each, step = _each_changed(p, LYING_BOUNDS)
        placed, walls = each[:, [0, 1, 2, 5, 6]], each[:, [3, 4]]
        across, along = around(self.points_m, *self.places(placed.reshape(-1, 6)))
        across, along = (values.reshape(len(p), 5, -1) for values in (across, along))
        rows = np.empty((*each.shape[:2], across.shape[-1] + 4))
        outside = across - np.maximum(placed[..., 2:3] + placed[..., 3:4] * along, 0.0)
        rows[:, :3, :-4], rows[:, 5:, :-4] = outside[:, :3], outside[:, 3:]
        radius = np.maximum(walls[..., 2:3] + walls[..., 3:4] * along[:, :1], 0.0)
        np.subtract(across[:, :1], radius, out=rows[:, 3:5, :-4])
        rows[..., :-4] /= WALL_NOISE_M
        _unusual(each, rows[..., -4:-2])
        self._unrested(each, rows[..., -2:])
        return _differences(rows, step)

    def places(self, p: Frees) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
        """Centres and axes of several."""
        along, across, level = np.cos(p[:, 4]), np.sin(p[:, 4]), np.cos(p[:, 5])
        axes, centres_m = np.empty((len(p), 3)), np.empty((len(p), 3))
        axes[:, 0], axes[:, 1], axes[:, 2] = level * along, level * across, np.sin(p[:, 5])
        centres_m[:, 0] = self.middle_m[0] - p[:, 0] * across
        centres_m[:, 1] = self.middle_m[1] + p[:, 0] * along
        centres_m[:, 2] = p[:, 1]
        return centres_m, axes

    def _unrested(self, p: Float[np.ndarray, "k each 6"], out: Float[np.ndarray, "k each 2"]) -> None:
        """How far the axis is from where it is when the vessel rests on the table."""
        tilt = np.arctan(p[..., 3])
        out[..., 0] = (p[..., 1] - p[..., 2] * np.cos(tilt)) / self.rest_spread_m
        out[..., 1] = (p[..., 5] - tilt) / self.tilt_spread_rad


def _each_changed(p: Frees, bounds: Bounds) -> tuple[Float[np.ndarray, "k each p"], Frees]:
    """Parameters, then the same with one of them changed, each in turn; and by how much.

    They step away from zero, or towards it where a bound is in the way.
    """
    step = DIFFERENCE * np.where(p >= 0, 1.0, -1.0) * np.maximum(1.0, np.abs(p))
    there = p + step
    there = np.where((there < bounds.low) | (there > bounds.high), p - step, there)
    each, which = np.repeat(p[:, None], 1 + p.shape[1], axis=1), np.arange(p.shape[1])
    each[:, 1 + which, which] = there
    return each, there - p


def _unusual(p: Float[np.ndarray, "k each p"], out: Float[np.ndarray, "k each 2"]) -> None:
    """How far radius and slope are from what is usual."""
    out[..., 0] = (p[..., 2] - USUAL_RADIUS_M) / RADIUS_SPREAD_M
    out[..., 1] = (p[..., 3] - USUAL_SLOPE) / SLOPE_SPREAD


def _differences(rows: Float[np.ndarray, "k each rows"], step: Frees) -> tuple[Residuals, Slopes]:
    slopes = rows[:, 1:] - rows[:, :1]
    slopes /= step[:, :, None]
    return np.ascontiguousarray(rows[:, 0]), slopes
