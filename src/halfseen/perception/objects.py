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
    hull = _table_outline(image, plane)
    if hull is None:
        return sheets
    is_sheet = sheets >= 0
    across, sheet = plane.table_points(image.points_m[is_sheet])[:, :2], sheets[is_sheet]
    is_inside = (across @ hull[:, :2].T + hull[:, 2] < OVERHANG_M).all(axis=1)
    share = np.bincount(sheet[is_inside], minlength=int(sheets.max()) + 1) / np.maximum(np.bincount(sheet), 1)
    return relabelled(sheets, np.flatnonzero(share >= SMALLEST_SHARE_ON_TABLE).tolist())


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
    above, labels = np.flatnonzero(is_above), np.full(is_above.shape, -1)
    if not len(above):
        return labels
    depth = image.depth_m.ravel()
    node = np.cumsum(is_above) - 1
    edges = []
    for next_px, is_pair in ((1, is_above[:, :-1] & is_above[:, 1:]), (len(is_above[0]), is_above[:-1] & is_above[1:])):
        row, column = np.nonzero(is_pair)
        here = row * len(is_above[0]) + column
        step = np.maximum(DEPTH_STEP_M, DEPTH_STEP_SIGMAS * image.sensor.noise_m(depth[here]))
        joined = here[np.abs(depth[here] - depth[here + next_px]) < step]
        edges.append(node[np.stack([joined, joined + next_px])])
    pairs = np.concatenate(edges, axis=1)
    graph = coo_matrix((np.ones(pairs.shape[1]), (pairs[0], pairs[1])), shape=(len(above), len(above)))
    labels.ravel()[above] = _largest_first(connected_components(graph, directed=False)[1], SMALLEST_SHEET_PX)
    return labels


def _largest_first(labels: Int[np.ndarray, " above"], fewest_px: int) -> Int[np.ndarray, " above"]:
    """Number labels from the largest on; those of fewer pixels become −1."""
    counts = np.bincount(labels)
    order = np.argsort(-counts, kind="stable")
    kept = order[counts[order] >= fewest_px]
    table = np.full(len(counts), -1)
    table[kept] = np.arange(len(kept))
    return table[labels]


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
