"""Sheets on the table: pixels above its plane, grouped into surfaces of continuous depth.

A gripper or an arm over the table does not stand on it, with free space below, nor does what it holds.
"""

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull
from skimage.measure import label as measure_label

from halfseen.arrays import Image, Rows, percentiles
from halfseen.errors import CloudError
from halfseen.perception.clouds import Vector
from halfseen.perception.plane import Plane, is_on_plane
from halfseen.perception.range_image import Pixels, RangeImage
from halfseen.shapes import Bool, Float, Int

# Lower points are table (cloth, lens distortion) [m]; so are points lower than this many standard deviations of noise.
LOWEST_OBJECT_M = 0.008
LOWEST_OBJECT_SIGMAS = 2.0
# Higher points are not objects on a table (lamps, people) [m]; a sheet that reaches so close to them goes on above, as
# a robot's arm does.
HIGHEST_OBJECT_M, LIMIT_REACH_M = 0.5, 0.015
# Neighbouring pixels with a larger depth step show different surfaces; a wall seen at 80° steps by 6 px widths [m].
DEPTH_STEP_M = 0.008
DEPTH_STEP_SIGMAS = 3.0
# ... and of coarse pixels, more than this many widths of a pixel.
DEPTH_STEP_PX = 2.0
# Sheets with fewer pixels are flying pixels at edges [px]; of coarse pixels, those of this area [m²] are enough, and at
# least the second number.
SMALLEST_SHEET_PX, FEWEST_COARSE_PX = 30, 8
COARSE_SHEET_M2 = 7.5e-4
# Widest pixel on the table [m]: a cup has four of them side by side.
WIDEST_PIXEL_M = 0.02
# Cell size of the table's grid [m], and the widest gap without return (shadow, gloss) within the table [cells].
TABLE_CELL_M = 0.01
TABLE_GAP_CELLS = 3
# Largest reach of a table from its middle [m]; it keeps stray pixels from enlarging the grid.
TABLE_REACH_M = 10.0
# An object may overhang the visible table by this [m]; at least this share of its pixels must be on the table.
OVERHANG_M = 0.01
SMALLEST_SHARE_ON_TABLE = 0.5

Labels = Int[np.ndarray, "H W"]
# Labels of pixels that show no thing on or before the table, and of those of a thing that is left out: it is not on the
# table, or the border of the image cuts it.
NO_OBJECT, LEFT_OUT = -1, -2


def sheets_on_table(image: RangeImage, plane: Plane) -> Labels:
    """Group the pixels above the table into sheets: surfaces over which depth is continuous.

    Parameters
    ----------
    image, plane
        The range image and the table's plane.

    Returns
    -------
    Labels
        Sheet of each pixel, from 0, largest first; `NO_OBJECT` where there is none, `LEFT_OUT` beside the table,
        above free space, or of what goes on above `HIGHEST_OBJECT_M`.

    Raises
    ------
    CloudError
        The pixels are too coarse for cups.
    """
    height_m = plane.height_m(image.points_m)
    on_table = np.flatnonzero(is_on_plane(height_m, image))
    _check_width(image, on_table)
    sheets = _off_trays(_continuous(image, _above(image, height_m)), height_m, plane, image)
    hull = _table_outline(image, plane, on_table)
    if hull is None:
        return sheets
    pixels = np.flatnonzero(sheets >= 0)
    across, sheet = plane.across_m(image.points_m.reshape(-1, 3)[pixels]), sheets.ravel()[pixels]
    right, away, is_inside = *np.ascontiguousarray(across.T), np.ones(len(across), dtype=bool)
    for a, b, c in hull:
        is_inside &= a * right + b * away + c < OVERHANG_M
    count, num_inside = np.bincount(sheet), np.bincount(sheet[is_inside], minlength=int(sheets.max()) + 1)
    is_at_limit = height_m.ravel()[pixels] > HIGHEST_OBJECT_M - LIMIT_REACH_M
    num_at_limit = np.bincount(sheet[is_at_limit], minlength=len(count))
    is_kept = (num_inside >= SMALLEST_SHARE_ON_TABLE * count) & (num_at_limit < FEWEST_COARSE_PX)
    is_kept &= ~_is_floating(pixels_of(sheets), height_m, plane, image)
    is_kept = np.append(is_kept, False)
    table = np.where(is_kept, np.cumsum(is_kept) - 1, LEFT_OUT)
    table[-1] = NO_OBJECT
    return table[sheets]


def pixels_of(labels: Labels) -> list[Pixels]:
    """Flat indices of the pixels of each label, in increasing order.

    Parameters
    ----------
    labels
        Label of each pixel; negative where there is none.
    """
    pixels = np.flatnonzero(labels >= 0)
    # Numbers of 16 bits are sorted by their digits, which is faster.
    label = labels.ravel()[pixels]
    label = label.astype(np.min_scalar_type(int(label.max(initial=0))))
    order = np.argsort(label, kind="stable")
    return np.split(pixels[order], np.cumsum(np.bincount(label))[:-1]) if len(pixels) else []


def _check_width(image: RangeImage, on_table: Pixels) -> None:
    depth_m = float(np.median(image.depth_m.ravel()[on_table[::16]])) if len(on_table) else 0.0
    width_m = depth_m / float(image.intrinsics[0, 0])
    if width_m > WIDEST_PIXEL_M:
        raise CloudError(
            f"{image.name}: its points on the table are {1000 * width_m:.0f} mm apart, but cups need "
            f"{1000 * WIDEST_PIXEL_M:.0f} mm at most; thin it less, or put the camera closer"
        )


def _above(image: RangeImage, height_m: Image) -> Pixels:
    with np.errstate(invalid="ignore"):
        pixels = np.flatnonzero((height_m > LOWEST_OBJECT_M) & (height_m < HIGHEST_OBJECT_M))
    return pixels[height_m.ravel()[pixels] > LOWEST_OBJECT_SIGMAS * image.noise_m.ravel()[pixels]]


def _continuous(image: RangeImage, above: Pixels) -> Labels:
    labels, width = np.full(image.depth_m.shape, -1), image.depth_m.shape[1]
    if not len(above):
        return labels
    depth_m = image.depth_m.ravel()[above]
    width_m = depth_m / image.intrinsics[0, 0]
    step_m = np.maximum(DEPTH_STEP_M, DEPTH_STEP_SIGMAS * image.noise_m.ravel()[above])
    step_m = np.maximum(step_m, DEPTH_STEP_PX * width_m)
    edges = []
    for next_px in (1, width):
        beside = np.minimum(np.searchsorted(above, above + next_px), len(above) - 1)
        is_joined = (above[beside] == above + next_px) & (np.abs(depth_m - depth_m[beside]) < step_m)
        if next_px == 1:
            is_joined &= above % width < width - 1
        edges.append(np.stack([np.flatnonzero(is_joined), beside[is_joined]]))
    pairs = np.concatenate(edges, axis=1)
    graph = coo_matrix((np.ones(pairs.shape[1]), (pairs[0], pairs[1])), shape=(len(above), len(above)))
    fewest_px = int(np.clip(COARSE_SHEET_M2 / np.median(width_m[::16]) ** 2, FEWEST_COARSE_PX, SMALLEST_SHEET_PX))
    labels.ravel()[above] = _largest_first(connected_components(graph, directed=False)[1], fewest_px)
    return labels


def _largest_first(labels: Int[np.ndarray, " above"], fewest_px: int) -> Int[np.ndarray, " above"]:
    """Renumber labels by size, largest first; labels with too few pixels become −1."""
    counts = np.bincount(labels)
    order = np.argsort(-counts, kind="stable")
    kept = order[counts[order] >= fewest_px]
    table = np.full(len(counts), -1)
    table[kept] = np.arange(len(kept))
    return table[labels]


# A level surface of this area [m²], at most so high over the table [m], is a tray; its points lie within this [m].
TRAY_M2, HIGHEST_TRAY_M, TRAY_BAND_M = 0.03, 0.04, 0.005


def _off_trays(sheets: Labels, height_m: Image, plane: Plane, image: RangeImage) -> Labels:
    """Separate things from the tray that they stand on: surfaces meet there, but the tray does not hide them."""
    apart = sheets.copy()
    for pixels in pixels_of(sheets):
        heights, cells = height_m.ravel()[pixels], plane.across_m(image.points_m.reshape(-1, 3)[pixels])
        if np.prod(np.ptp(cells, axis=0) + 2 * TABLE_CELL_M) < TRAY_M2:
            continue
        cells = np.floor(cells / TABLE_CELL_M).astype(np.int64) @ [1, 1 << 20]
        tops_m = np.arange(LOWEST_OBJECT_M, HIGHEST_TRAY_M, TRAY_BAND_M / 2)
        num_cells = [len(np.unique(cells[np.abs(heights - top_m) < TRAY_BAND_M])) for top_m in tops_m]
        if max(num_cells) * TABLE_CELL_M**2 >= TRAY_M2:
            on_top = _continuous(image, pixels[heights > tops_m[int(np.argmax(num_cells))] + TRAY_BAND_M])
            apart[on_top >= 0] = apart.max() + 1 + on_top[on_top >= 0]
    return apart


def _table_outline(image: RangeImage, plane: Plane, on_table: Pixels) -> Float[np.ndarray, "edges 3"] | None:
    """Half-planes ``a·x + b·y + c ≤ 0`` of the convex outline of the largest connected piece of table."""
    points_m = image.points_m.reshape(-1, 3).take(on_table, axis=0)
    right_m, away_m = _near(np.ascontiguousarray(plane.across_m(points_m).T))
    right, num_right, low_right = _cells(right_m)
    away, num_away, low_away = _cells(away_m)
    shape, low = (num_right, num_away), np.array([low_right, low_away])
    num_points = np.bincount(right * num_away + away, minlength=num_right * num_away).reshape(shape)
    size = 2 * TABLE_GAP_CELLS + 1
    closed = minimum_filter(maximum_filter(num_points > 0, size), size)
    pieces = np.asarray(measure_label(closed, connectivity=1))
    if not pieces.any():
        return None
    sizes = np.bincount(pieces.ravel(), weights=num_points.ravel())
    sizes[0] = 0
    cells = _ends_of_rows(pieces == int(sizes.argmax())) + low
    corners = np.concatenate([cells + np.array(shift) for shift in ((0, 0), (0, 1), (1, 0), (1, 1))]) * TABLE_CELL_M
    return ConvexHull(corners).equations


def _near(across_m: Float[np.ndarray, "2 n"]) -> Float[np.ndarray, "2 k"]:
    """Drop points far from the middle; return the input if no two points are that far apart."""
    if not across_m.size or np.ptp(across_m, axis=1).max() < TABLE_REACH_M:
        return across_m
    return across_m[:, (np.abs(across_m - np.median(across_m, axis=1, keepdims=True)) < TABLE_REACH_M).all(axis=0)]


def _cells(place_m: Rows) -> tuple[Int[np.ndarray, " n"], int, int]:
    """Cell of each position along one axis, the number of cells including a margin, and the offset of the first."""
    cell = np.floor(place_m / TABLE_CELL_M).astype(np.int64)
    margin = 2 * TABLE_GAP_CELLS
    low = int(cell.min()) - margin
    return cell - low, int(cell.max()) - low + 1 + margin, low


def _ends_of_rows(mask: Bool[np.ndarray, "rows columns"]) -> Int[np.ndarray, "ends 2"]:
    """First and last pixel of each row; the others do not affect a convex hull."""
    rows = np.flatnonzero(mask.any(axis=1))
    first, last = mask[rows].argmax(axis=1), mask.shape[1] - 1 - mask[rows, ::-1].argmax(axis=1)
    return np.concatenate([np.stack([rows, first], axis=1), np.stack([rows, last], axis=1)])


# A sheet that begins lower stands on the table [m]; one that begins higher is not known to reach it, whatever hides it.
LOWEST_FLOATING_M, HIGHEST_BEGIN_M = 0.05, 0.25
LOWEST_PERCENT = 2.0
# Below its lower edge one looks this far [px], past pixels that the edge blurs,
BELOW_PX = 3
# ... and sees something this much farther away [m] on most of the edge: nothing stands there that carries or hides it.
FREE_M, FREE_SHARE, FEWEST_EDGE_PX = 0.02, 0.7, 8
# A vessel that floats may show its outer wall this far before its inner one [m].
WIDEST_VESSEL_M = 0.12


def _is_floating(of_sheet: list[Pixels], height_m: Image, plane: Plane, image: RangeImage) -> Bool[np.ndarray, " n"]:
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
    begin_m = np.array([percentiles(height_m.ravel()[pixels], LOWEST_PERCENT)[0] for pixels in of_sheet])
    is_floating = begin_m > HIGHEST_BEGIN_M
    asked = np.flatnonzero((begin_m > LOWEST_FLOATING_M) & ~is_floating)
    below = {k: _below(of_sheet[k], plane, image) for k in asked.tolist()}
    is_free_px = np.zeros(image.depth_m.size, dtype=bool)
    for _ in range(2):
        for k in np.flatnonzero(is_floating):
            is_free_px[of_sheet[k]] = True
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
