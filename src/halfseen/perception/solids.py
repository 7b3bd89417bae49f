"""Solids that complete the visible part of an object: a vessel (cone frustum, standing or lying), or a convex hull.

Coordinates here are those of the table: right, away from the camera, height over the plane.
"""

from dataclasses import dataclass

import numpy as np

from halfseen.arrays import Points, Rows
from halfseen.perception.clouds import Vector
from halfseen.shapes import Float

# Number of points on the outline of an end.
NUM_AROUND = 40


@dataclass(frozen=True, eq=False)
class Vessel:
    """A cone frustum on the table.

    Parameters
    ----------
    centre_m
        Point of the axis at which the radius is `radius_m`: (right, away, height) [m].
    axis
        Unit vector along the axis; up for a standing vessel, towards the wider end for a lying one.
    radius_m
        Outer radius at `centre_m` [m].
    slope
        Increase of the radius per length along the axis.
    ends_m
        Positions of both ends along the axis, from `centre_m` [m].
    misfit
        Mean robust cost of a point; about 1 for residuals of one noise unit, infinite for an invalid radius or slope.
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

    def outside_m(self, points_m: Points) -> Rows:
        """Distance of points from the wall, perpendicular to the axis [m]; negative inside."""
        return self.outside_along_m(points_m)[0]

    def outside_along_m(self, points_m: Points) -> tuple[Rows, Rows]:
        """Distance of points from the wall, and their position along the axis [m]."""
        across, along = (each[0] for each in around(points_m, self.centre_m[None], self.axis[None]))
        return across - np.maximum(self.radius_m + self.slope * along, 0.0), along

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
    """The convex hull of an object's visible points, extended down to the table.

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
        """Return the points and their projections onto the table [m]."""
        return np.concatenate([self.points_m, self.points_m * [1.0, 1.0, 0.0]])


def around(
    points_m: Points, centres_m: Float[np.ndarray, "k 3"], axes: Float[np.ndarray, "k 3"]
) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, "k n"]]:
    """Distances of points from several axes, and positions along them from a point of each axis [m].

    Parameters
    ----------
    points_m
        Points [m].
    centres_m, axes
        A point [m] and the direction of each axis.
    """
    offsets = points_m - centres_m[:, None]
    along = offsets @ axes[:, :, None]
    offsets -= along * axes[:, None]
    np.square(offsets, out=offsets)
    # The order of a sum over three elements, so that results are bitwise identical.
    return np.sqrt(offsets[..., 0] + offsets[..., 1] + offsets[..., 2]), along[..., 0]


def _square_to(axis: Vector) -> tuple[Vector, Vector]:
    aside = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    side = _cross(axis, aside)
    side /= np.linalg.norm(side)
    return side, _cross(axis, side)


def _cross(one: Vector, other: Vector) -> Vector:
    """Cross product of two vectors; for a single pair, NumPy's is ten times slower."""
    a, b = one.tolist(), other.tolist()
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
