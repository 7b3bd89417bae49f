"""What stands on the table: pixels above the plane, grouped into sheets of continuous depth."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_closing
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull
from skimage.measure import label as measure_label

from halfseen.perception.plane import Plane, is_on_plane
from halfseen.perception.range_image import PixelMask, RangeImage

# Points lower than this over the table are table: cloth, warp of the lens [m]; farther away, so many sigmas of noise.
LOWEST_OBJECT_M = 0.008
LOWEST_OBJECT_SIGMAS = 2.0
# Higher points are no part of what stands on a table (lamps, people) [m].
HIGHEST_OBJECT_M = 0.5
# Neighbouring pixels with a larger step in depth show different surfaces: a wall seen at 80° steps by 6 px widths [m].
DEPTH_STEP_M = 0.008
DEPTH_STEP_SIGMAS = 3.0
# Sheets with fewer pixels are flying pixels at edges [px], per square metre at a distance of 1 m [m²].
SMALLEST_SHEET_PX = 30
# Cells of the table's top, and the widest stripe without return (shadow, gloss) that the table continues across [m].
TABLE_CELL_M = 0.01
TABLE_GAP_CELLS = 3
# An object may overhang the part of the table that is seen [m]; its pixels on the table must be at least this share.
OVERHANG_M = 0.01
SMALLEST_SHARE_ON_TABLE = 0.5

Labels = Int[np.ndarray, "H W"]


def sheets_on_table(image: RangeImage, plane: Plane) -> Labels:
    """Group the pixels above the table into sheets: surfaces over which depth is continuous.

    Parameters
    ----------
    image, plane
        What the camera sees and the table's plane.

    Returns
    -------
    Labels
        Sheet of each pixel, from 0, largest first; −1 where there is none.
    """
    is_above = _is_above(image, plane)
    sheets = _continuous(image, is_above)
    across = plane.table_points(image.points_m)[..., :2]
    hull = _table_outline(image, plane)
    if hull is None:
        return sheets
    is_inside = np.zeros(sheets.shape, dtype=bool)
    is_inside[is_above] = (across[is_above] @ hull[:, :2].T + hull[:, 2] < OVERHANG_M).all(axis=1)
    kept = [
        sheet for sheet in range(int(sheets.max()) + 1) if is_inside[sheets == sheet].mean() >= SMALLEST_SHARE_ON_TABLE
    ]
    return relabelled(sheets, kept)


def relabelled(labels: Labels, kept: list[int]) -> Labels:
    """Give the labels that are kept the numbers from 0, in the order given; the others become −1.

    Parameters
    ----------
    labels
        Label of each pixel; −1 where there is none.
    kept
        Labels to keep.
    """
    table = np.full(int(labels.max()) + 2, -1)
    table[kept] = np.arange(len(kept))
    return table[labels]


def _is_above(image: RangeImage, plane: Plane) -> PixelMask:
    height = plane.height_m(image.points_m)
    lowest = np.maximum(LOWEST_OBJECT_M, LOWEST_OBJECT_SIGMAS * image.sensor.noise_m(image.depth_m))
    with np.errstate(invalid="ignore"):
        return (height > lowest) & (height < HIGHEST_OBJECT_M)


def _continuous(image: RangeImage, is_above: PixelMask) -> Labels:
    depth = image.depth_m
    index = np.arange(depth.size).reshape(depth.shape)
    edges = []
    for here, there in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1, :], np.s_[1:, :])):
        step = np.maximum(DEPTH_STEP_M, DEPTH_STEP_SIGMAS * image.sensor.noise_m(depth[here]))
        with np.errstate(invalid="ignore"):
            joined = is_above[here] & is_above[there] & (np.abs(depth[here] - depth[there]) < step)
        edges.append(np.stack([index[here][joined], index[there][joined]]))
    pairs = np.concatenate(edges, axis=1)
    graph = coo_matrix((np.ones(pairs.shape[1]), (pairs[0], pairs[1])), shape=(depth.size, depth.size))
    component = connected_components(graph, directed=False)[1].reshape(depth.shape)
    return _largest_first(np.where(is_above, component, -1), SMALLEST_SHEET_PX)


def _largest_first(labels: Labels, fewest_px: int) -> Labels:
    names, counts = np.unique(labels[labels >= 0], return_counts=True)
    order = np.argsort(-counts, kind="stable")
    kept = [int(names[k]) for k in order if counts[k] >= fewest_px]
    return relabelled(labels, kept) if kept else np.full_like(labels, -1)


def _table_outline(image: RangeImage, plane: Plane) -> Float[np.ndarray, "edges 3"] | None:
    """Half-planes ``a·x + b·y + c ≤ 0`` of the convex outline of the largest connected piece of table."""
    points = plane.table_points(image.points_m[is_on_plane(plane, image)])[:, :2]
    cell = np.floor(points / TABLE_CELL_M).astype(np.int64)
    low = cell.min(axis=0) - 2 * TABLE_GAP_CELLS
    span = cell.max(axis=0) - low + 1 + 2 * TABLE_GAP_CELLS
    occupied: Bool[np.ndarray, "cells cells"] = np.zeros(span, dtype=bool)
    occupied[tuple((cell - low).T)] = True
    closed = binary_closing(occupied, np.ones((2 * TABLE_GAP_CELLS + 1,) * 2))
    pieces = np.asarray(measure_label(closed, connectivity=1))
    num_pieces = int(pieces.max())
    if not num_pieces:
        return None
    sizes = np.bincount(pieces[tuple((cell - low).T)], minlength=num_pieces + 1)
    sizes[0] = 0
    corners = np.argwhere(pieces == int(sizes.argmax())) + low
    corners = np.concatenate([corners + np.array(shift) for shift in ((0, 0), (0, 1), (1, 0), (1, 1))]) * TABLE_CELL_M
    return ConvexHull(corners).equations
