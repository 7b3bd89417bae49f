"""From sheets to objects: a vessel shows its outer and its inner wall as two sheets, an occluder cuts a wall in two."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int
from scipy.spatial import KDTree

from halfseen.arrays import Points
from halfseen.perception.objects import Labels
from halfseen.perception.plane import Plane
from halfseen.perception.range_image import PixelMask, RangeImage
from halfseen.perception.silhouette import covered, middle_depth_m
from halfseen.perception.solids import Hull, Vessel
from halfseen.perception.splitting import divided
from halfseen.perception.vessel_fits import fit_lying, fit_standing, flat_misfit, robust_cost, thinned

# A fit whose mean cost is worse is no vessel: residuals of 8 mm everywhere.
WORST_VESSEL_MISFIT = 3.2
# A standing vessel that fits so well leaves nothing to ask.
STANDING_MISFIT = 0.35
# A fit that is worse than this may be that of a vessel on its handle, if that halves the cost.
HANDLE_MISFIT, HANDLE_GAIN = 1.6, 0.5
# What a plane fits this much better than a vessel is the face of a box.
FLAT_GAIN = 0.5
# Points that carry a hull; more change no pixel of it.
NUM_HULL_POINTS = 2000
# A sheet whose vessel fits worse may show two.
DOUBTFUL_VESSEL_MISFIT = 2.0
# A vessel whose fit is better is sure enough to claim what lies inside it.
SURE_VESSEL_MISFIT = 1.5
# Pieces farther apart than the walls of a wide cup are not tried together [m].
FARTHEST_PIECES_M = 0.12
# Two pieces are walls of one vessel if the points of each lie this near to one common wall: mean robust cost.
JOINT_MISFIT = 1.3
# ... which is tried only if half of one is this near to the wall that the other shows [m]; a fit takes time.
SAME_WALL_M = 0.035
# ... and no more than this share of the vessel's picture shows something behind it.
LARGEST_CONTRADICTION = 0.12
# A piece is inside a solid if this share of its points is no farther outside than the noise [m].
INSIDE_SHARE = 0.7
INSIDE_M = 0.006
# ... and this near to the wall or the bottom [m]: what is deep inside a vessel, above its bottom, is another thing.
AT_WALL_M = 0.012
# What is seen of a handle starts near the wall, reaches no farther than this, and is no wider, noise included [m]; it
# is smaller than this share of the body.
HANDLE_START_M = 0.025
HANDLE_REACH_M = 0.055
HANDLE_WIDTH_M = 0.025
HANDLE_SHARE = 0.4
# Smaller patches are flying pixels [m²]: a cup shows 4 cm² when five sixths of it are hidden.
SMALLEST_OBJECT_M2 = 3.5e-4
# Lower things are print, cloth or cards [m].
LOWEST_TOP_M = 0.011
# An object whose contact with the image border is longer than this share of the root of its area is cut [1].
CUT_SHARE = 0.5
BORDER_PX = 3


@dataclass(frozen=True, eq=False)
class _Piece:
    sheets: tuple[int, ...]
    points_m: Points
    solid: Vessel | Hull


def objects_of_sheets(sheets: Labels, plane: Plane, image: RangeImage) -> tuple[Labels, tuple[Vessel | Hull, ...], int]:
    """Group sheets into objects and complete the shape of each.

    Parameters
    ----------
    sheets
        Sheet of each pixel; −1 where there is none.
    plane, image
        The table and what the camera sees.

    Returns
    -------
    labels
        Object of each pixel, largest first; −1 where there is none.
    solids
        Completed shape of each object.
    num_cut
        Objects left out because the border of the image cuts them.
    """
    sheets, pieces = _pieces(sheets, plane, image)
    pieces = _merged(pieces, sheets, plane, image)
    kept, num_cut = [], 0
    for piece in pieces:
        mask = _is_of(sheets, piece.sheets)
        if not _is_object(mask, piece, image):
            continue
        if _is_cut(mask):
            num_cut += 1
        else:
            kept.append((int(mask.sum()), piece))
    kept.sort(key=lambda pair: -pair[0])
    table = np.full(int(sheets.max()) + 2, -1)
    for index, (_, piece) in enumerate(kept):
        table[list(piece.sheets)] = index
    return table[sheets], tuple(piece.solid for _, piece in kept), num_cut


def _pieces(sheets: Labels, plane: Plane, image: RangeImage) -> tuple[Labels, list[_Piece]]:
    """Complete each sheet; one that is no vessel and shows two is divided."""
    sheets, points_m = sheets.copy(), image.points_m.reshape(-1, 3)
    pieces = []
    for sheet, pixels in enumerate(_pixels_of(sheets)):
        points = plane.table_points(points_m[pixels])
        piece = _piece((sheet,), points)
        solid, is_first = piece.solid, None
        if isinstance(solid, Hull) or solid.misfit > DOUBTFUL_VESSEL_MISFIT:
            is_first = divided(points)
        if is_first is None or is_first.all() or not is_first.any():
            pieces.append(piece)
            continue
        new = int(sheets.max()) + 1
        sheets.ravel()[pixels[~is_first]] = new
        pieces += [_piece((sheet,), points[is_first]), _piece((new,), points[~is_first])]
    return sheets, pieces


def _piece(names: tuple[int, ...], points_m: Points) -> _Piece:
    spread_m = _spread(points_m)
    return _Piece(names, spread_m, completed(spread_m))


def _pixels_of(sheets: Labels) -> list[Int[np.ndarray, " px"]]:
    """Flat indices of the pixels of each sheet, rising."""
    pixels = np.flatnonzero(sheets >= 0)
    sheet = sheets.ravel()[pixels]
    order = np.argsort(sheet, kind="stable")
    return np.split(pixels[order], np.cumsum(np.bincount(sheet))[:-1]) if len(pixels) else []


def _is_of(sheets: Labels, names: tuple[int, ...]) -> PixelMask:
    """Pixels of some sheets."""
    is_named = np.zeros(int(sheets.max()) + 2, dtype=bool)
    is_named[list(names)] = True
    return is_named[sheets]


def completed(points_m: Points) -> Vessel | Hull:
    """Complete what is seen of an object: the vessel that fits best, or the hull if none fits.

    Parameters
    ----------
    points_m
        Points of the object as (right, away, height) [m].
    """
    if len(points_m) < 8:
        return Hull(points_m)
    vessel = fit_standing(points_m)
    if vessel.misfit < STANDING_MISFIT:
        return vessel
    lying = fit_lying(points_m)
    vessel = lying if lying.misfit < vessel.misfit and _is_low(lying, points_m) else vessel
    if vessel.misfit > HANDLE_MISFIT:
        lying = fit_lying(points_m, is_on_wall=False)
        vessel = lying if lying.misfit < HANDLE_GAIN * vessel.misfit and _is_low(lying, points_m) else vessel
    is_vessel = vessel.misfit < WORST_VESSEL_MISFIT and flat_misfit(points_m) > FLAT_GAIN * vessel.misfit
    return vessel if is_vessel else Hull(thinned(points_m, NUM_HULL_POINTS))


def _is_low(lying: Vessel, points_m: Points) -> bool:
    """Whether nothing is higher than a lying vessel can be: a tall bottle is none, however well its face fits."""
    widest = lying.radius_m + abs(lying.slope) * max(np.abs(lying.ends_m))
    return bool(np.percentile(points_m[:, 2], 98) < 2 * widest + HANDLE_REACH_M)


def _spread(points_m: Points) -> Points:
    """Put points into a fixed order that spreads them, so that every thinning covers all of them."""
    return points_m[np.random.default_rng(0).permutation(len(points_m))]


def _merged(pieces: list[_Piece], sheets: Labels, plane: Plane, image: RangeImage) -> list[_Piece]:
    """Merge pairs until none belongs together; the largest pieces take first."""
    pieces = sorted(pieces, key=lambda piece: -len(piece.points_m))
    i = 0
    while i < len(pieces):
        for j in range(i + 1, len(pieces)):
            joint = _joined(pieces[i], pieces[j], sheets, plane, image)
            if joint is not None:
                pieces = [joint, *(piece for k, piece in enumerate(pieces) if k not in (i, j))]
                pieces.sort(key=lambda piece: -len(piece.points_m))
                i = -1
                break
        i += 1
    return pieces


def _joined(large: _Piece, small: _Piece, sheets: Labels, plane: Plane, image: RangeImage) -> _Piece | None:
    """Make one object of two pieces, or None if they are two objects."""
    gap, _ = KDTree(thinned(large.points_m)).query(thinned(small.points_m))
    if gap.min() > FARTHEST_PIECES_M:
        return None
    names = large.sheets + small.sheets
    points = _spread(np.concatenate([large.points_m, small.points_m]))
    if _is_handle(small, large):
        return _Piece(names, points, large.solid)
    if _is_claimed(small, large) or _is_claimed(large, small):
        return _Piece(names, points, completed(points))
    if not (_is_near_wall(small, large) or _is_near_wall(large, small)):
        return None
    solid = completed(points)
    if not isinstance(solid, Vessel) or solid.misfit > SURE_VESSEL_MISFIT:
        return None
    if not (_is_part(large, solid) and _is_part(small, solid)):
        return None
    if _contradiction(solid, _is_of(sheets, names), sheets, plane, image) > LARGEST_CONTRADICTION:
        return None
    return _Piece(names, points, solid)


def _is_part(piece: _Piece, vessel: Vessel) -> bool:
    misfit = robust_cost(vessel.outside_m(thinned(piece.points_m)))
    return misfit < JOINT_MISFIT or _is_inside(piece, vessel)


def _is_near_wall(piece: _Piece, other: _Piece) -> bool:
    vessel = other.solid
    if not isinstance(vessel, Vessel):
        return False
    return bool(np.median(np.abs(vessel.outside_m(thinned(piece.points_m)))) < SAME_WALL_M)


def _is_claimed(piece: _Piece, other: _Piece) -> bool:
    """Whether a piece is inside the vessel that another piece shows, if that is sure."""
    vessel = other.solid
    return isinstance(vessel, Vessel) and vessel.misfit < SURE_VESSEL_MISFIT and _is_inside(piece, vessel)


def _is_inside(piece: _Piece, vessel: Vessel) -> bool:
    """Whether a piece is the inner wall or an end of a vessel: solids never share room."""
    points = thinned(piece.points_m)
    outside, along = vessel.outside_m(points), vessel.along_m(points)
    low, high = vessel.ends_m
    is_between = (along > low - INSIDE_M) & (along < high + INSIDE_M)
    is_at_end = along < low + AT_WALL_M
    if not vessel.is_upright:
        is_at_end |= along > high - AT_WALL_M
    is_at_wall = (np.abs(outside) < AT_WALL_M) | is_at_end
    return bool(np.mean((outside < INSIDE_M) & is_between & is_at_wall) > INSIDE_SHARE)


def _is_handle(small: _Piece, large: _Piece) -> bool:
    """Whether a piece sticks out of a vessel's wall, in a plane through its axis."""
    vessel = large.solid
    if not isinstance(vessel, Vessel) or len(small.points_m) > HANDLE_SHARE * len(large.points_m):
        return False
    points = thinned(small.points_m)
    outside, along = vessel.outside_m(points), vessel.along_m(points)
    low, high = vessel.ends_m
    starts = np.percentile(np.abs(outside), 5) < HANDLE_START_M
    is_near = outside.max() < HANDLE_REACH_M and along.min() > low + INSIDE_M and along.max() < high + INSIDE_M
    across = points - vessel.centre_m - along[:, None] * vessel.axis
    way = across.mean(axis=0)
    aside = across @ np.cross(vessel.axis, way / max(float(np.linalg.norm(way)), 1e-9))
    return bool(starts and is_near and np.ptp(np.percentile(aside, [5, 95])) < HANDLE_WIDTH_M)


def _contradiction(vessel: Vessel, own: PixelMask, sheets: Labels, plane: Plane, image: RangeImage) -> float:
    """Share of a vessel's picture at which something behind it is seen, or the table where its wall should be."""
    is_covered = covered(vessel, plane, image) & ~own
    is_farther = image.depth_m > middle_depth_m(vessel, plane, image, is_covered)
    is_room = is_covered & ~is_farther & image.is_return & (sheets < 0)
    is_room[is_room] = np.abs(vessel.outside_m(plane.table_points(image.points_m[is_room]))) > AT_WALL_M
    return float((is_farther | is_room).sum() / max(1, (is_covered | own).sum()))


def _is_object(mask: PixelMask, piece: _Piece, image: RangeImage) -> bool:
    K = image.intrinsics
    area = float(np.sum(image.depth_m[mask] ** 2) / (K[0, 0] * K[1, 1]))
    return area > SMALLEST_OBJECT_M2 and float(np.percentile(piece.points_m[:, 2], 98)) > LOWEST_TOP_M


def _is_cut(mask: PixelMask) -> bool:
    frame = np.ones_like(mask)
    frame[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = False
    return float((mask & frame).sum()) / BORDER_PX > CUT_SHARE * float(np.sqrt(mask.sum()))
