"""Sheets that do not stand on the table: a gripper or an arm over it, with free space below, and what it holds."""

import numpy as np

from halfseen.arrays import Image, Rows
from halfseen.perception.clouds import Vector
from halfseen.perception.plane import Plane
from halfseen.perception.range_image import Pixels, RangeImage
from halfseen.shapes import Bool

# A sheet that begins lower stands on the table [m]; one that begins higher is not known to reach it, whatever hides it.
LOWEST_FLOATING_M, HIGHEST_BEGIN_M = 0.05, 0.25
LOWEST_PERCENT = 2.0
# Below its lower edge one looks this far [px], past pixels that the edge blurs,
BELOW_PX = 3
# ... and sees something this much farther away [m] on most of the edge: nothing stands there that carries or hides it.
FREE_M, FREE_SHARE, FEWEST_EDGE_PX = 0.02, 0.7, 8
# A vessel that floats may show its outer wall this far before its inner one [m].
WIDEST_VESSEL_M = 0.12


def is_floating(of_sheet: list[Pixels], height_m: Image, plane: Plane, image: RangeImage) -> Bool[np.ndarray, " n"]:
    """Whether each sheet begins high over the table, and below its lower edge is free space or a floating wall.

    Parameters
    ----------
    of_sheet
        Flat indices of the pixels of each sheet.
    height_m
        Height of each pixel over the table [m].
    plane, image
        The table and the range image.
    """
    begin_m = np.array([np.percentile(height_m.ravel()[pixels], LOWEST_PERCENT) for pixels in of_sheet])
    is_floating = begin_m > HIGHEST_BEGIN_M
    asked = np.flatnonzero((begin_m > LOWEST_FLOATING_M) & ~is_floating)
    below = {k: _below(of_sheet[k], plane, image) for k in asked.tolist()}
    is_free_px = np.zeros(image.depth_m.size, dtype=bool)
    for _ in range(2):
        is_free_px[
            np.concatenate([np.empty(0, dtype=np.int64), *(of_sheet[k] for k in np.flatnonzero(is_floating))])
        ] = True
        for k, (pixels, gap_m) in below.items():
            is_free = (gap_m > FREE_M) | (is_free_px[pixels] & (gap_m > -WIDEST_VESSEL_M))
            is_floating[k] = len(pixels) >= FEWEST_EDGE_PX and is_free.mean() > FREE_SHARE
    return is_floating


def _below(pixels: Pixels, plane: Plane, image: RangeImage) -> tuple[Pixels, Rows]:
    """Pixels with a return below the lower edge of a sheet, and how much farther away each is [m]."""
    depths, shape = image.depth_m.ravel(), image.depth_m.shape
    is_own = np.zeros(depths.shape, dtype=bool)
    is_own[pixels] = True
    down = _down_px(image.points_m.reshape(-1, 3)[pixels].mean(axis=0), plane, image)
    next_px, below_px = (_moved(pixels, step * down, shape) for step in (1, BELOW_PX))
    is_edge = (below_px >= 0) & ~is_own[next_px] & ~is_own[below_px]
    below_px, gap_m = below_px[is_edge], depths[below_px[is_edge]] - depths[pixels[is_edge]]
    return below_px[np.isfinite(gap_m)], gap_m[np.isfinite(gap_m)]


def _down_px(point_m: Vector, plane: Plane, image: RangeImage) -> np.ndarray:
    """Step in rows and columns to the neighbouring pixel that is nearest to straight down at a point."""
    (x, y, z), (dx, dy, dz), K = point_m, -plane.normal, image.intrinsics
    way = np.array([K[1, 1] * (dy * z - y * dz), K[0, 0] * (dx * z - x * dz)])
    return np.where(np.abs(way) == np.abs(way).max(), np.sign(way), 0.0).astype(np.int64)


def _moved(pixels: Pixels, step: np.ndarray, shape: tuple[int, int]) -> Pixels:
    """Flat indices of pixels after a step in rows and columns; −1 outside the image."""
    row, column = (each + way for each, way in zip(np.divmod(pixels, shape[1]), step.tolist(), strict=True))
    is_inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    return np.where(is_inside, row * shape[1] + column, -1)
