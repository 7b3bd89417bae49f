"""Grouping of sheets into objects: a vessel's outer and inner walls are two sheets, and an occluder splits a wall."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from halfseen.arrays import Points, Rows, percentiles
from halfseen.perception.objects import HIGHEST_OBJECT_M, LEFT_OUT, NO_OBJECT, Labels, pixels_of
from halfseen.perception.occlusion import covered, middle_depth_m
from halfseen.perception.plane import Plane
from halfseen.perception.range_image import PixelMask, Pixels, RangeImage
from halfseen.perception.solids import Hull, Vessel
from halfseen.perception.vessel_fits import (
    FEWEST_POINTS,
    divided,
    flat_misfit,
    lying_vessels,
    robust_cost,
    standing_vessels,
    thinned,
)
from halfseen.perception.walls import Sets

# A fit with a larger mean cost is not a vessel: residuals of 8 mm everywhere.
WORST_VESSEL_MISFIT = 3.2
# A standing vessel with a smaller misfit is accepted without further checks.
STANDING_MISFIT = 0.35
# A larger misfit may be that of a vessel lying on its handle, if that model halves the cost.
HANDLE_MISFIT, HANDLE_GAIN = 1.6, 0.5
# Two pieces are first compared by each so many of their points.
FIRST_STRIDE = 8
# Fewest points of a vessel.
FEWEST_OF_VESSEL = 8
# If a plane fits this much better than a vessel, the object is a face of a box.
FLAT_GAIN = 0.5
# Number of points of a hull; more do not change its pixels.
NUM_HULL_POINTS = 2000
# A sheet whose vessel has a larger misfit may show two vessels.
DOUBTFUL_VESSEL_MISFIT = 2.0
# A vessel with a smaller misfit may claim pieces inside it.
SURE_VESSEL_MISFIT = 1.5
# Pieces farther apart than the walls of a wide cup are never merged [m].
FARTHEST_PIECES_M = 0.12
# Two pieces are walls of one vessel if the points of each lie this close to a common wall: mean robust cost.
JOINT_MISFIT = 1.3
# ... which is fitted only if half of one piece is this close to the wall of the other [m], to save time,
SAME_WALL_M = 0.035
# ... and if at most this share of the vessel's pixels shows something behind it.
LARGEST_CONTRADICTION = 0.12
# A piece is inside a solid if this share of its points is no farther outside than the noise [m]
INSIDE_SHARE = 0.7
INSIDE_M = 0.006
# ... and this close to the wall or the bottom [m]. Points deep inside a vessel, above its bottom, are another object.
AT_WALL_M = 0.012
# The visible part of a handle starts this close to the wall, reaches this far, and is this wide at most, including
# noise [m]; it is smaller than this share of the body.
HANDLE_START_M = 0.025
HANDLE_REACH_M = 0.055
HANDLE_WIDTH_M = 0.025
HANDLE_SHARE = 0.4
# Smaller patches are flying pixels [m²]: a cup shows 4 cm² when five sixths of it are hidden.
SMALLEST_OBJECT_M2 = 3.5e-4
# Lower objects are print, cloth or cards [m].
LOWEST_TOP_M = 0.011
# An object is cut if the image border touches it along this share of its width, or of the square root of its area.
CUT_SHARE, BORDER_PX = 0.5, 3
# Largest numbers of pieces and of joint fits; crowded tables have a dozen of either. Stripes, checks and noise have
# hundreds, and fits take time.
MOST_PIECES, MOST_JOINT_FITS = 150, 100


@dataclass(frozen=True, eq=False)
class _Piece:
    """Sheets of one object; its points are in random order, so that any subsample covers all of them."""

    sheets: tuple[int, ...]
    points_m: Points
    given: Vessel | Hull | None = None

    @cached_property
    def thin_m(self) -> Points:
        """A subsample of its points."""
        return thinned(self.points_m)

    @cached_property
    def solid(self) -> Vessel | Hull:
        """Its completed shape, fitted on first use, as some pieces are merged before."""
        return completed([self.points_m])[0] if self.given is None else self.given


def objects_of_sheets(sheets: Labels, plane: Plane, image: RangeImage) -> tuple[Labels, tuple[Vessel | Hull, ...], int]:
    """Group sheets into objects and complete the shape of each.

    Parameters
    ----------
    sheets
        Sheet of each pixel, `NO_OBJECT` or `LEFT_OUT`.
    plane, image
        The table and the range image.

    Returns
    -------
    labels
        Object of each pixel, largest first; `NO_OBJECT` where there is none, `LEFT_OUT` where it is left out.
    solids
        Completed shape of each object.
    num_cut
        Number of objects that are cut; longer things that reach into the image, such as arms and walls, do not count.

    Raises
    ------
    ValueError
        There are far more sheets, or far more candidate pairs of them, than on a table of objects.
    """
    num_sheets = int(sheets.max()) + 1
    if num_sheets > MOST_PIECES:
        raise ValueError(f"they fall into {num_sheets} pieces, but a table of objects into {MOST_PIECES} at most")
    sheets, pieces = _pieces(sheets, plane, image)
    pieces = _merged(pieces, sheets, plane, image)
    of_sheet = pixels_of(sheets)
    kept, num_cut, table = [], 0, np.full(int(sheets.max()) + 3, NO_OBJECT)
    table[LEFT_OUT] = LEFT_OUT
    for piece in pieces:
        pixels = np.sort(np.concatenate([of_sheet[sheet] for sheet in piece.sheets]))
        if not _is_object(pixels, piece, image):
            continue
        if _is_cut(pixels, sheets.shape):
            table[list(piece.sheets)] = LEFT_OUT
            num_cut += bool(np.ptp(piece.points_m, axis=0).max() < HIGHEST_OBJECT_M)
        else:
            kept.append((len(pixels), piece))
    kept.sort(key=lambda pair: -pair[0])
    for index, (_, piece) in enumerate(kept):
        table[list(piece.sheets)] = index
    return table[sheets], tuple(piece.solid for _, piece in kept), num_cut


def _pieces(sheets: Labels, plane: Plane, image: RangeImage) -> tuple[Labels, list[_Piece]]:
    """Make a piece of each sheet; a sheet that is not one vessel but shows several is divided."""
    sheets, points_m, pieces = sheets.copy(), image.points_m.reshape(-1, 3), []
    of_sheet = pixels_of(sheets)
    sets = [plane.table_points(points_m[pixels]) for pixels in of_sheet]
    spread = [_spread(points) for points in sets]
    for sheet, (points, solid) in enumerate(zip(sets, completed(spread), strict=True)):
        is_doubtful = isinstance(solid, Hull) or solid.misfit > DOUBTFUL_VESSEL_MISFIT
        part = divided(points) if len(points) >= FEWEST_POINTS and is_doubtful else None
        if part is None or not np.ptp(part):
            pieces.append(_Piece((sheet,), spread[sheet], solid))
            continue
        for k in np.unique(part):
            number = sheet if k == part.min() else int(sheets.max()) + 1
            sheets.ravel()[of_sheet[sheet][part == k]] = number
            pieces.append(_Piece((number,), _spread(points[part == k])))
    return sheets, pieces


def completed(sets: Sets) -> list[Vessel | Hull]:
    """Complete the shape of each object: the vessel that fits best, or the hull if none fits.

    Parameters
    ----------
    sets
        Points of each object as (right, away, height) [m].
    """
    large = [k for k, points in enumerate(sets) if len(points) >= FEWEST_OF_VESSEL]
    vessels = dict(zip(large, standing_vessels([sets[k] for k in large]), strict=True))
    on_wall, on_handle = (
        [k for k in large if vessels[k].misfit > enough] for enough in (STANDING_MISFIT, HANDLE_MISFIT)
    )
    lying = iter(lying_vessels([sets[k] for k in on_wall + on_handle], len(on_handle)))
    for asked, enough, gain in ((on_wall, STANDING_MISFIT, 1.0), (on_handle, HANDLE_MISFIT, HANDLE_GAIN)):
        for k, vessel in zip(asked, lying, strict=False):
            if enough < vessels[k].misfit > vessel.misfit / gain and _is_low(vessel, sets[k]):
                vessels[k] = vessel
    return [
        vessels[k] if k in vessels and _is_vessel(vessels[k], points) else Hull(thinned(points, NUM_HULL_POINTS))
        for k, points in enumerate(sets)
    ]


def _is_vessel(vessel: Vessel, points_m: Points) -> bool:
    """Whether a vessel fits well and a plane does not fit much better; a good standing fit needs no further checks."""
    if vessel.is_upright and vessel.misfit < STANDING_MISFIT:
        return True
    return vessel.misfit < WORST_VESSEL_MISFIT and flat_misfit(points_m) > FLAT_GAIN * vessel.misfit


def _is_low(lying: Vessel, points_m: Points) -> bool:
    """Whether no point is too high for the lying vessel; a tall bottle is not one, however well its face fits."""
    widest = lying.radius_m + abs(lying.slope) * max(np.abs(lying.ends_m))
    return bool(percentiles(points_m[:, 2], 98)[0] < 2 * widest + HANDLE_REACH_M)


def _spread(points_m: Points) -> Points:
    """Shuffle points with a fixed seed, so that any subsample covers all of them."""
    return points_m[np.random.default_rng(0).permutation(len(points_m))]


def _merged(pieces: list[_Piece], sheets: Labels, plane: Plane, image: RangeImage) -> list[_Piece]:
    """Merge pairs until none belongs together, starting from the largest piece."""
    pieces = sorted(pieces, key=lambda piece: -len(piece.points_m))
    apart: set[tuple[_Piece, _Piece]] = set()
    i = num_fits = 0
    while i < len(pieces):
        others = [piece for piece in pieces[i + 1 :] if (pieces[i], piece) not in apart]
        for small, joint, is_sure in _candidates(pieces[i], others, MOST_JOINT_FITS - num_fits):
            num_fits += joint is not None and not is_sure
            if num_fits > MOST_JOINT_FITS:
                raise ValueError(f"they fall into {len(pieces)} pieces, too many of which may belong together")
            if joint is not None and (is_sure or _is_one(pieces[i], small, joint, sheets, plane, image)):
                pieces = [joint, *(piece for piece in pieces if piece not in (pieces[i], small))]
                pieces.sort(key=lambda piece: -len(piece.points_m))
                i = -1
                break
            apart.add((pieces[i], small))
        i += 1
    return pieces


def _candidates(large: _Piece, others: Sequence[_Piece], num_fitted: int) -> list[tuple[_Piece, _Piece | None, bool]]:
    """Join a piece with each of the others, up to the first certain match; uncertain joints are fitted in one batch."""
    pairs: list[tuple[_Piece, _Piece | None, bool]] = []
    for small in others:
        pairs.append((small, *_candidate(large, small)))
        if pairs[-1][2]:
            break
    asked = [k for k, (_, joint, is_sure) in enumerate(pairs) if joint is not None and not is_sure][:num_fitted]
    joints = [joint for k in asked if (joint := pairs[k][1]) is not None]
    for k, joint, solid in zip(asked, joints, completed([joint.points_m for joint in joints]), strict=True):
        pairs[k] = (pairs[k][0], replace(joint, given=solid), False)
    return pairs


def _candidate(large: _Piece, small: _Piece) -> tuple[_Piece | None, bool]:
    """Join two pieces, and return whether they are certainly one object; None if they are two."""
    if not _is_near(large, small):
        return None, False
    if _is_handle(small, large):
        return _joint(large, small, large.solid), True
    if _is_claimed(small, large) or _is_claimed(large, small):
        return _joint(large, small), True
    return (_joint(large, small) if _is_near_wall(small, large) or _is_near_wall(large, small) else None), False


def _joint(large: _Piece, small: _Piece, given: Vessel | Hull | None = None) -> _Piece:
    return _Piece(large.sheets + small.sheets, _spread(np.concatenate([large.points_m, small.points_m])), given)


def _is_one(large: _Piece, small: _Piece, joint: _Piece, sheets: Labels, plane: Plane, image: RangeImage) -> bool:
    """Whether two pieces are walls of one vessel, fitted to both."""
    solid = joint.solid
    if not isinstance(solid, Vessel) or solid.misfit > SURE_VESSEL_MISFIT:
        return False
    if not (_is_part(large, solid) and _is_part(small, solid)):
        return False
    return _contradiction(solid, np.isin(sheets, joint.sheets), sheets, plane, image) <= LARGEST_CONTRADICTION


def _is_near(large: _Piece, small: _Piece) -> bool:
    """Whether some points of two pieces are close together."""
    (low, high), (begin, end) = ((each.thin_m.min(axis=0), each.thin_m.max(axis=0)) for each in (large, small))
    if np.maximum(low - end, begin - high).max() > FARTHEST_PIECES_M:
        return False
    # Most near pieces are found by a few points of each.
    if cdist(large.thin_m[::FIRST_STRIDE], small.thin_m[::FIRST_STRIDE]).min() <= FARTHEST_PIECES_M:
        return True
    return bool(KDTree(large.thin_m).query(small.thin_m)[0].min() <= FARTHEST_PIECES_M)


@lru_cache(maxsize=2)
def _outside_along_m(piece: _Piece, vessel: Vessel) -> tuple[Rows, Rows]:
    """Where a piece is to a vessel; for a pair of pieces, each is asked for in turn."""
    return vessel.outside_along_m(piece.thin_m)


def _is_part(piece: _Piece, vessel: Vessel) -> bool:
    misfit = robust_cost(_outside_along_m(piece, vessel)[0])
    return misfit < JOINT_MISFIT or _is_inside(piece, vessel)


def _is_near_wall(piece: _Piece, other: _Piece) -> bool:
    vessel = other.solid
    if not isinstance(vessel, Vessel):
        return False
    return bool(np.median(np.abs(_outside_along_m(piece, vessel)[0])) < SAME_WALL_M)


def _is_claimed(piece: _Piece, other: _Piece) -> bool:
    """Whether a piece is inside the vessel of another piece, and that vessel fits well enough."""
    vessel = other.solid
    return isinstance(vessel, Vessel) and vessel.misfit < SURE_VESSEL_MISFIT and _is_inside(piece, vessel)


def _is_inside(piece: _Piece, vessel: Vessel) -> bool:
    """Whether a piece is the inner wall or an end of a vessel; solids never overlap."""
    outside, along = _outside_along_m(piece, vessel)
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
    outside, along = _outside_along_m(small, vessel)
    low, high = vessel.ends_m
    if outside.max() >= HANDLE_REACH_M or along.min() <= low + INSIDE_M or along.max() >= high + INSIDE_M:
        return False
    across = small.thin_m - vessel.centre_m - along[:, None] * vessel.axis
    way = across.mean(axis=0)
    aside = across @ np.cross(vessel.axis, way / max(float(np.linalg.norm(way)), 1e-9))
    begin, end = percentiles(aside, 5, 95)
    return bool(percentiles(np.abs(outside), 5)[0] < HANDLE_START_M and end - begin < HANDLE_WIDTH_M)


def _contradiction(vessel: Vessel, own: PixelMask, sheets: Labels, plane: Plane, image: RangeImage) -> float:
    """Share of a vessel's pixels that show something behind it, or the table instead of its wall."""
    asked = covered(vessel, plane, image)
    asked = asked[~own.ravel()[asked]]
    points_m = image.points_m.reshape(-1, 3)[asked]
    is_farther = points_m[:, 2] > middle_depth_m(vessel, plane, image, asked)
    is_room = ~is_farther & np.isfinite(points_m[:, 2]) & (sheets.ravel()[asked] == NO_OBJECT)
    is_room[is_room] = np.abs(vessel.outside_m(plane.table_points(points_m[is_room]))) > AT_WALL_M
    return float((is_farther | is_room).sum() / max(1, len(asked) + own.sum()))


def _is_object(pixels: Pixels, piece: _Piece, image: RangeImage) -> bool:
    K = image.intrinsics
    area = float(np.sum(image.depth_m.ravel()[pixels] ** 2) / (K[0, 0] * K[1, 1]))
    return area > SMALLEST_OBJECT_M2 and bool(percentiles(piece.points_m[:, 2], 98)[0] > LOWEST_TOP_M)


def _is_cut(pixels: Pixels, shape: tuple[int, int]) -> bool:
    at = np.stack(np.divmod(pixels, shape[1]))
    contact_px = ((at < BORDER_PX) | (at >= np.array(shape)[:, None] - BORDER_PX)).sum(axis=1) / BORDER_PX
    # Long things, such as arms, touch the border with their whole width.
    width_px = np.minimum(np.ptp(at, axis=1)[::-1] + 1.0, np.sqrt(len(pixels)))
    return bool((contact_px > CUT_SHARE * width_px).any())
