"""Residuals of points from the walls of vessels, and their Jacobians, for least-squares fits.

Parameters of a standing vessel are its position (right, away), a radius and a slope; those of a lying one, its position
(aside, height), a radius, a slope, and the direction and tilt of its axis. The residuals of the points come first, then
those of the prior on the parameters. Many vessels are computed in one batch, each with its own points.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from halfseen.arrays import Rows
from halfseen.perception.clouds import Vector
from halfseen.perception.marquardt import Bounds, Frees, Residuals, Slopes, soft_l1
from halfseen.shapes import Bool, Float, Shaped

# Noise unit of residuals across a wall [m]; larger ones (handle, bottom) have linear cost.
WALL_NOISE_M = 0.003
# Prior mean and spread of a vessel's radius [m] and of the slope of its wall; it keeps a narrow visible strip of wall
# from being fitted as a barrel.
USUAL_RADIUS_M, RADIUS_SPREAD_M = 0.040, 0.020
USUAL_SLOPE, SLOPE_SPREAD = 0.10, 0.12
SMALLEST_RADIUS_M, LARGEST_RADIUS_M = 0.008, 0.13
STEEPEST_SLOPE = 1.5
# Smallest distance from an axis [m]; a point on an axis has no radial direction.
SMALLEST_M = 1e-12

OfPoints = Float[np.ndarray, "k n"]
Sets = Sequence[Float[np.ndarray, "_ 3"]]
"""Points of each of several objects as (right, away, height) [m]."""


def _bounds(num_free: int) -> Bounds:
    """Bounds of the parameters; only radius and slope, the third and fourth, are bounded."""
    low, high = np.full(num_free, -np.inf), np.full(num_free, np.inf)
    low[2:4], high[2:4] = (SMALLEST_RADIUS_M, -STEEPEST_SLOPE), (LARGEST_RADIUS_M, STEEPEST_SLOPE)
    return Bounds(low, high)


STANDING_BOUNDS, LYING_BOUNDS = _bounds(4), _bounds(6)


@dataclass(frozen=True, eq=False)
class Walls:
    """A batch of vessels with their points, padded to the size of the largest set.

    Parameters
    ----------
    right_m, away_m, height_m
        Points relative to the middle of each set [m]; arbitrary in the padding.
    weight_per_m
        Inverse noise of each point [1/m]; 0 in the padding.
    """

    right_m: OfPoints
    away_m: OfPoints
    height_m: OfPoints
    weight_per_m: OfPoints

    def at(self, p: Frees) -> tuple[Residuals, Slopes]:
        """Residuals of each vessel and their Jacobian."""
        raise NotImplementedError

    def misfits(self, p: Frees) -> Float[np.ndarray, " k"]:
        """Mean robust cost of a point of each vessel."""
        residuals = self.at(p)[0][:, : self.weight_per_m.shape[1]]
        return soft_l1(residuals).sum(axis=1) / np.count_nonzero(self.weight_per_m, axis=1)

    def some(self, which: Bool[np.ndarray, " k"]) -> Any:
        """Keep some of the vessels."""
        return replace(self, **{field.name: getattr(self, field.name)[which] for field in fields(self)})


def _padded(sets: Sets, middles_m: Float[np.ndarray, "k 3"]) -> dict[str, OfPoints]:
    """Padded points relative to the middles, and their weights."""
    points_m = np.ones((4, len(sets), max(map(len, sets))))
    points_m[3] = 0.0
    for k, points in enumerate(sets):
        points_m[:3, k, : len(points)] = (points - middles_m[k]).T
        points_m[3, k, : len(points)] = 1.0 / WALL_NOISE_M
    return dict(zip(("right_m", "away_m", "height_m", "weight_per_m"), points_m, strict=True))


@dataclass(frozen=True, eq=False)
class StandingWalls(Walls):
    """Walls of standing vessels with their points."""

    @classmethod
    def of(cls, sets: Sets, middle_heights_m: Sequence[float]) -> "StandingWalls":
        """Batch sets of points.

        Parameters
        ----------
        sets
            Points of each vessel as (right, away, height) [m].
        middle_heights_m
            Height at which the radius of each vessel is defined [m].
        """
        middles_m = np.zeros((len(sets), 3))
        middles_m[:, 2] = middle_heights_m
        return cls(**_padded(sets, middles_m))

    def at(self, p: Frees) -> tuple[Residuals, Slopes]:
        """Residuals of each vessel and their Jacobian."""
        right, away, weight = self.right_m - p[:, :1], self.away_m - p[:, 1:2], self.weight_per_m
        across = np.maximum(np.sqrt(right * right + away * away), SMALLEST_M)
        residuals, slopes = _rows(p, across, 2)
        np.multiply(across - p[:, 2:3] - p[:, 3:4] * self.height_m, weight, out=residuals[:, :-2])
        outward = weight / across
        for k, slope in enumerate((right * outward, away * outward, weight, self.height_m * weight)):
            np.negative(slope, out=slopes[:, k, :-2])
        _unusual(p, residuals[:, -2:], slopes[:, :, -2:])
        return residuals, slopes


@dataclass(frozen=True, eq=False)
class LyingWalls(Walls):
    """Walls of lying vessels with their points.

    Parameters
    ----------
    right_m, away_m, height_m, weight_per_m
        As for `Walls`; heights are over the table [m].
    middle_m
        Reference point of each vessel's position [m].
    rest_spread_m, tilt_spread_rad
        Prior spread of each axis about its pose with the wall on the table: height [m], tilt [rad].
    """

    middle_m: Float[np.ndarray, "k 3"]
    rest_spread_m: Float[np.ndarray, " k"]
    tilt_spread_rad: Float[np.ndarray, " k"]

    @classmethod
    def of(
        cls, sets: Sets, middles_m: Sequence[Vector], rest_spread_m: float | Rows, tilt_spread_rad: float | Rows
    ) -> "LyingWalls":
        """Batch sets of points.

        Parameters
        ----------
        sets
            Points of each vessel as (right, away, height) [m].
        middles_m, rest_spread_m, tilt_spread_rad
            As for the class; a single spread applies to all vessels.
        """
        middle_m = np.array(middles_m) * [1.0, 1.0, 0.0]
        rest, tilt = (np.full(len(sets), spread) for spread in (rest_spread_m, tilt_spread_rad))
        return cls(**_padded(sets, middle_m), middle_m=middle_m, rest_spread_m=rest, tilt_spread_rad=tilt)

    def at(self, p: Frees) -> tuple[Residuals, Slopes]:
        """Residuals of each vessel and their Jacobian."""
        # Points in the frame of each axis, and on the table along and across its direction.
        (cosine, level), (sine, steep) = np.cos(p[:, 4:]).T[..., None], np.sin(p[:, 4:]).T[..., None]
        from_middle = cosine * self.away_m - sine * self.right_m
        ahead, up = cosine * self.right_m + sine * self.away_m, self.height_m - p[:, 1:2]
        aside, over, along = from_middle - p[:, :1], level * up - steep * ahead, level * ahead + steep * up
        across = np.maximum(np.sqrt(aside * aside + over * over), SMALLEST_M)
        radius = p[:, 2:3] + p[:, 3:4] * along
        residuals, slopes = _rows(p, across, 4)
        np.multiply(across - np.maximum(radius, 0.0), self.weight_per_m, out=residuals[:, :-4])
        outward = self.weight_per_m / across
        sideward, upward = outward * aside, outward * over
        wall = self.weight_per_m if radius.min() > 0 else self.weight_per_m * (radius > 0)
        rows, wider = slopes[:, :, :-4], p[:, 3:4] * wall
        np.negative(sideward, out=rows[:, 0])
        np.subtract(steep * wider, level * upward, out=rows[:, 1])
        np.negative(wall, out=rows[:, 2])
        np.multiply(along, rows[:, 2], out=rows[:, 3])
        np.subtract(rows[:, 0] * ahead, (steep * upward + level * wider) * from_middle, out=rows[:, 4])
        np.subtract(-wider * over, upward * along, out=rows[:, 5])
        _unusual(p, residuals[:, -4:-2], slopes[:, :, -4:-2])
        self._unrested(p, residuals[:, -2:], slopes[:, :, -2:])
        return residuals, slopes

    def places(self, p: Frees) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
        """Centre and axis of each vessel."""
        along, across, level = np.cos(p[:, 4]), np.sin(p[:, 4]), np.cos(p[:, 5])
        axes, centres_m = np.empty((len(p), 3)), np.empty((len(p), 3))
        axes[:, 0], axes[:, 1], axes[:, 2] = level * along, level * across, np.sin(p[:, 5])
        centres_m[:, 0] = self.middle_m[:, 0] - p[:, 0] * across
        centres_m[:, 1] = self.middle_m[:, 1] + p[:, 0] * along
        centres_m[:, 2] = p[:, 1]
        return centres_m, axes

    def _unrested(self, p: Frees, residuals: Float[np.ndarray, "k 2"], slopes: Float[np.ndarray, "k p 2"]) -> None:
        """Prior residuals of the axis relative to its pose when the wall rests on the table."""
        radius, slope = p[:, 2], p[:, 3]
        shorter, closer, steadier = (
            1.0 / np.sqrt(1.0 + slope * slope),
            1.0 / self.rest_spread_m,
            1.0 / self.tilt_spread_rad,
        )
        residuals[:, 0] = (p[:, 1] - radius * shorter) * closer
        residuals[:, 1] = (p[:, 5] - np.arctan(slope)) * steadier
        slopes[:, 1, 0], slopes[:, 5, 1] = closer, steadier
        slopes[:, 2, 0] = -shorter * closer
        slopes[:, 3, 0] = radius * slope * shorter * shorter * shorter * closer
        slopes[:, 3, 1] = -shorter * shorter * steadier


def _rows(p: Frees, across: OfPoints, num_more: int) -> tuple[Residuals, Slopes]:
    """Allocate residuals and their Jacobian, with zeros for the last rows, which depend on few parameters."""
    num_rows = across.shape[1] + num_more
    slopes = np.empty((*p.shape, num_rows))
    slopes[:, :, -num_more:] = 0.0
    return np.empty((len(p), num_rows)), slopes


def _unusual(p: Frees, residuals: Shaped[np.ndarray, "k 2"], slopes: Shaped[np.ndarray, "k p 2"]) -> None:
    """Prior residuals of radius and slope."""
    residuals[:, 0] = (p[:, 2] - USUAL_RADIUS_M) / RADIUS_SPREAD_M
    residuals[:, 1] = (p[:, 3] - USUAL_SLOPE) / SLOPE_SPREAD
    slopes[:, 2, 0], slopes[:, 3, 1] = 1.0 / RADIUS_SPREAD_M, 1.0 / SLOPE_SPREAD
