"""Detection of the table's plane among the planes in view."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from halfseen.arrays import Image, Points, Rows
from halfseen.errors import CloudError
from halfseen.perception.clouds import DepthSensor, Vector
from halfseen.perception.range_image import PixelMask, RangeImage
from halfseen.shapes import Bool, Float, Int

# RANSAC over a subsampled image with a fixed seed, so that the result is deterministic.
RANSAC_SEED = 7
NUM_HYPOTHESES = 150
NUM_POINTS_THINNED = 3000
# Hypotheses per batch; this many fit into a cache.
AT_ONCE = 8
# Points of a hypothesis come from one neighbourhood of this radius, relative to the image's longer side: three distant
# points rarely lie on one surface.
NEIGHBOURHOOD_SHARE = 0.12
# Largest distance of an inlier: this many standard deviations, but at least the distortion of cheap lenses [m].
INLIER_SIGMAS = 2.0
SMALLEST_TOLERANCE_M = 0.005
# Points farther below a plane are not its noise [standard deviations]; half of a normal error is less than the last.
MOST_NOISE_SIGMAS, NORMAL_MEDIAN = 8.0, 0.6745
# Pixels, on a grid, of which the median tells the noise.
NUM_PIXELS_ASKED = 20_000
# Planes are removed one by one until one has less than this share of the returns.
SMALLEST_PLANE_SHARE = 0.04
MOST_PLANES = 6
# Cosine above which two planes are parallel (8°).
PARALLEL_COSINE = 0.99
# For a level or downward-looking camera, a table's normal points up in the image; walls seen from above point down.
# A normal with a smaller upward component may be a table seen from straight above, or a wall.
CLEARLY_UP = 0.2
LARGEST_DOWN = 0.15
DOUBTFUL_WEIGHT = 0.3
# Smallest visible area of a table [m²]; the top of a pitcher is 0.016.
SMALLEST_TABLE_M2 = 0.02
# A level plane less than this above another one [m], which is larger by this factor, is the top of a box on a table.
HIGHEST_BOX_M = 0.2
BOX_AREA_RATIO = 1.5


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane ``normal · x = offset_m``; the normal points towards the camera, which is up for a table.

    Parameters
    ----------
    normal
        Unit normal in the camera frame.
    offset_m
        Signed distance of the plane from the origin along the normal [m]; negative, as the camera is above it.
    """

    normal: Vector
    offset_m: float

    def height_m(self, points_m: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "..."]:
        """Height of points above the plane [m].

        Parameters
        ----------
        points_m
            Points in the camera frame [m].
        """
        return np.asarray(points_m @ self.normal - self.offset_m)

    def axes(self) -> Float[np.ndarray, "2 3"]:
        """Two unit vectors in the plane: to the camera's right, and away from the camera."""
        return self._axes

    @cached_property
    def _axes(self) -> Float[np.ndarray, "2 3"]:
        right = np.array([1.0, 0.0, 0.0]) - self.normal[0] * self.normal
        if np.linalg.norm(right) < 0.1:
            right = np.array([0.0, 0.0, 1.0]) - self.normal[2] * self.normal
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(self.normal, right)])
        axes.setflags(write=False)
        return axes

    def across_m(self, points_m: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 2"]:
        """Points as (right, away) on the plane [m].

        Parameters
        ----------
        points_m
            Points in the camera frame [m].
        """
        return points_m @ self.axes().T

    def table_points(self, points_m: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
        """Points as (right, away, height) over the plane [m].

        Parameters
        ----------
        points_m
            Points in the camera frame [m].
        """
        across = self.across_m(points_m)
        return np.concatenate([across, self.height_m(points_m)[..., None]], axis=-1)

    def camera_points(self, table_m: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
        """Inverse of `table_points`.

        Parameters
        ----------
        table_m
            Points as (right, away, height) over the plane [m].
        """
        return table_m[..., :2] @ self.axes() + (table_m[..., 2:] + self.offset_m) * self.normal


def find_table(image: RangeImage) -> Plane:
    """Find the plane of the table.

    Planes are removed one by one. The upward-facing family of parallel planes with the most returns is the horizontal
    one. Its highest member that is large enough is the table, so that a floor below with more pixels does not win.

    Parameters
    ----------
    image
        The range image.

    Raises
    ------
    CloudError
        No plane is large enough.
    """
    points = _thinned(image)
    planes = _peel(points, max(image.depth_m.shape), image.sensor)
    families = [_support(plane, planes) for plane, _ in planes]
    if not families or max(families) <= 0:
        raise CloudError(
            f"{image.name}: no table plane: no plane that faces up holds {SMALLEST_PLANE_SHARE:.0%} of the "
            f"{int(image.is_return.sum())} returns; point the camera at the table from above, and give points with x "
            "right, y down and z forward, or a viewpoint"
        )
    lead, _ = planes[int(np.argmax(families))]
    members = [
        (plane, area)
        for plane, is_inlier in planes
        if plane.normal @ lead.normal > PARALLEL_COSINE
        and (area := _area_m2(plane, points[is_inlier][:, :3])) > SMALLEST_TABLE_M2
    ]
    tables = [plane for plane, area in members if not _is_on_another(plane, area, members)]
    if not tables:
        raise CloudError(
            f"{image.name}: no table plane: the largest level plane covers less than {SMALLEST_TABLE_M2} m²; "
            "point the camera at the table from above"
        )
    returns = np.flatnonzero(image.is_return)
    highest = max(tables, key=lambda plane: plane.offset_m)
    sample = image.points_m.reshape(-1, 3)[returns[:: max(1, len(returns) // 40_000)]]
    return _fitted(sample, highest, image.sensor)


def _is_on_another(plane: Plane, area_m2: float, members: list[tuple[Plane, float]]) -> bool:
    """Whether a plane is the top of a box: a larger plane is less than a box's height below it."""
    return any(
        0 < plane.offset_m - other.offset_m < HIGHEST_BOX_M and other_area_m2 > BOX_AREA_RATIO * area_m2
        for other, other_area_m2 in members
    )


def _thinned(image: RangeImage) -> Float[np.ndarray, "n 5"]:
    """Points on a coarse pixel grid, with their column and row."""
    step = max(1, int(np.sqrt(image.is_return.sum() / NUM_POINTS_THINNED)))
    rows, columns = np.nonzero(image.is_return[::step, ::step])
    points = image.points_m[::step, ::step][rows, columns]
    return np.column_stack([points, columns * step, rows * step]).astype(np.float64)


def _peel(
    points: Float[np.ndarray, "n 5"], side_px: int, sensor: DepthSensor
) -> list[tuple[Plane, Bool[np.ndarray, " n"]]]:
    generator = np.random.default_rng(RANSAC_SEED)
    left = np.ones(len(points), dtype=bool)
    planes: list[tuple[Plane, Bool[np.ndarray, " n"]]] = []
    while len(planes) < MOST_PLANES and left.sum() > max(10, SMALLEST_PLANE_SHARE * len(points)):
        plane = _best_plane(points[left], side_px, sensor, generator)
        if plane is None:
            break
        is_inlier = left & (np.abs(plane.height_m(points[:, :3])) < _tolerance_m(sensor, points[:, 2]))
        if is_inlier.sum() < SMALLEST_PLANE_SHARE * len(points):
            break
        planes.append((plane, is_inlier))
        left &= ~is_inlier
    return planes


def _best_plane(
    points: Float[np.ndarray, "n 5"], side_px: int, sensor: DepthSensor, generator: np.random.Generator
) -> Plane | None:
    corners = points[_neighbours(points[:, 3:], NEIGHBOURHOOD_SHARE * side_px, generator), :3]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals, firsts = normals[lengths >= 1e-9] / lengths[lengths >= 1e-9, None], corners[lengths >= 1e-9, 0]
    tolerance_m = _tolerance_m(sensor, points[:, 2])
    offsets_m = np.einsum("hi,hi->h", normals, firsts)
    transposed = np.ascontiguousarray(points[:, :3].T)
    support = np.concatenate(
        [
            np.count_nonzero(np.abs(normals[k : k + AT_ONCE] @ transposed - each[:, None]) < tolerance_m, axis=1)
            for k, each in ((k, offsets_m[k : k + AT_ONCE]) for k in range(0, len(normals), AT_ONCE))
        ]
        or [np.zeros(0, dtype=int)]
    )
    if not support.any():
        return None
    best = int(support.argmax())
    return _fitted(points[:, :3], _facing(normals[best], firsts[best]), sensor)


def _neighbours(
    pixels: Float[np.ndarray, "n 2"], radius_px: float, generator: np.random.Generator
) -> Int[np.ndarray, "hypotheses 3"]:
    """Draw three neighbouring points for each hypothesis; pixels are ordered row by row."""
    first = generator.integers(len(pixels), size=NUM_HYPOTHESES)
    farthest, (column, row) = int(np.ceil(radius_px)) - 1, pixels.T.astype(np.int64)
    lines, width = np.unique(row), int(column.max()) + 2 * farthest + 2
    # In each row, the neighbours of a hypothesis are consecutive.
    order, left = row * width + column + farthest, lines * width + column[first, None]
    starts, ends = np.searchsorted(order, left), np.searchsorted(order, left + 2 * farthest + 1)
    num_near = np.where(np.abs(lines - row[first, None]) <= farthest, ends - starts, 0)
    until = num_near.cumsum(axis=1)
    drawn = generator.integers(until[:, -1:], size=(NUM_HYPOTHESES, 3))
    hypothesis, line = np.arange(NUM_HYPOTHESES)[:, None], (until[:, None] <= drawn[:, :, None]).sum(axis=2)
    return starts[hypothesis, line] + drawn - (until - num_near)[hypothesis, line]


def _facing(normal: Vector, point: Vector) -> Plane:
    sign = -1.0 if normal @ point > 0 else 1.0
    return Plane(sign * normal, float(sign * (normal @ point)))


def _tolerance_m(sensor: DepthSensor, depth_m: Rows) -> Rows:
    return np.maximum(SMALLEST_TOLERANCE_M, INLIER_SIGMAS * sensor.noise_m(depth_m))


def _fitted(points: Points, plane: Plane, sensor: DepthSensor, num_rounds: int = 3) -> Plane:
    """Refit a plane by total least squares over its inliers, weighted by the inverse noise variance."""
    across, weights = np.ascontiguousarray(points.T), 1.0 / sensor.noise_m(points[:, 2]) ** 2
    tolerance_m = _tolerance_m(sensor, points[:, 2])
    for _ in range(num_rounds):
        weight = weights * (np.abs(plane.normal @ across - plane.offset_m) < tolerance_m)
        if np.count_nonzero(weight) < 3:
            return plane
        middle = across @ weight / weight.sum()
        offset = across - middle[:, None]
        plane = _facing(np.linalg.eigh((offset * weight) @ offset.T)[1][:, 0], middle)
    return plane


def _support(plane: Plane, planes: list[tuple[Plane, Bool[np.ndarray, " n"]]]) -> float:
    up = -float(plane.normal[1])
    weight = 1.0 if up > CLEARLY_UP else DOUBTFUL_WEIGHT if up > -LARGEST_DOWN else 0.0
    return weight * sum(int(mask.sum()) for other, mask in planes if other.normal @ plane.normal > PARALLEL_COSINE)


def _area_m2(plane: Plane, points: Points) -> float:
    """Area of the plane covered by points, in cells as wide as their typical spacing [m²]."""
    cell_m = 0.02
    right, away = np.floor(plane.axes() @ points.T / cell_m).astype(np.int64)
    return len(np.unique((right - right.min()) * (np.ptp(away) + 1) + away - away.min())) * cell_m**2


def noise_factor(plane: Plane, image: RangeImage) -> float:
    """Noise of the depths on a plane, as a multiple of what the camera is said to have, by the points below it.

    Parameters
    ----------
    plane, image
        The table and the range image.
    """
    step = max(1, int(np.sqrt(image.depth_m.size / NUM_PIXELS_ASKED)))
    points_m = image.points_m[::step, ::step]
    with np.errstate(invalid="ignore"):
        error_m = plane.height_m(points_m) * points_m[..., 2] / abs(plane.offset_m)
        below = -(error_m / image.noise_m[::step, ::step])
        below = below[(below > 0) & (below < MOST_NOISE_SIGMAS)]
    return float(np.median(below) / NORMAL_MEDIAN) if len(below) else 1.0


def is_on_plane(height_m: Image, image: RangeImage) -> PixelMask:
    """Mask of the pixels whose points belong to a plane.

    Parameters
    ----------
    height_m, image
        Height of each point above the plane [m], and the range image.
    """
    with np.errstate(invalid="ignore"):
        return np.abs(height_m) < np.maximum(SMALLEST_TOLERANCE_M, INLIER_SIGMAS * image.noise_m)
