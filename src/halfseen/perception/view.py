"""From a cloud to a view: the table, the objects on it, and who hides whom; and a check that the objects are cups.

Perception and all fitted models assume tables of standing or lying tumblers and mugs. An object is not a cup if its
height is outside the range of cups. If more than a third of the objects have a height, shape or width that no cup has,
shape and width count as well: no vessel fits the object, or it is too wide. A single such shape among cups is most
likely two cups that were merged.

*Limits.* A can, a bowl, a jar, a partly hidden box or a round object of a cup's size passes as a cup. The check reports
only objects that are certainly not cups.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import QhullError

from halfseen.arrays import Hides, Points, Transform, percentiles
from halfseen.errors import CloudError
from halfseen.perception.clouds import XTION, Cloud, DepthSensor, NoisierSensor, Vector
from halfseen.perception.grouping import objects_of_sheets
from halfseen.perception.objects import NO_OBJECT, Labels, pixels_of, sheets_on_table
from halfseen.perception.occlusion import extended, occlusions
from halfseen.perception.plane import Plane, find_table, noise_factor
from halfseen.perception.range_image import Pixels, RangeImage, range_image
from halfseen.perception.solids import Hull, Vessel
from halfseen.reading import reason_of
from halfseen.shapes import Bool
from halfseen.world.scene import Scene

# Percentile of the points, from below and above, that bounds an object's extent [%]; it excludes outliers.
EXTENT_PERCENT = 1.0
# An object that is not a vessel is upright if it is higher than this times its width.
UPRIGHT_ASPECT = 1.0
# Where the table itself shows more noise than this multiple of the camera's, the camera is taken to err as much.
LARGEST_NOISE_FACTOR = 1.5


@dataclass(frozen=True, eq=False)
class SeenObject:
    """An object on the table.

    Parameters
    ----------
    id
        Its number, from 0; row and column of `View.hides`.
    centroid_m
        Middle of its completed shape, in the frame of the cloud [m].
    height_m
        Height of its top over the table [m].
    size_m
        Extent of its visible part: to the camera's right, away from the camera, and up [m].
    occlusion
        Share of its silhouette that is hidden behind nearer objects, those included that the image border cuts or that
        are not on the table, in [0, 1].
    num_points
        Number of its points in the cloud.
    is_upright
        False if it lies.
    pixels
        Flat indices of its pixels in the range image.
    solid
        Its completed shape, in table coordinates: right, away from the camera, height over the plane [m].
    """

    id: int
    centroid_m: Vector
    height_m: float
    size_m: Vector
    occlusion: float
    num_points: int
    is_upright: bool
    pixels: np.ndarray
    solid: Vessel | Hull


@dataclass(frozen=True, eq=False)
class View:
    """The perceived objects on a table.

    Parameters
    ----------
    table
        Plane of the table, in the frame of the cloud; its normal points up.
    objects
        Objects on the table, largest in the image first.
    hides
        ``hides[i, j]`` is the share of object i's silhouette that is hidden by object j alone.
    labels
        Object of each pixel of the range image; −1 where there is none.
    silhouettes
        Pixels that each object would cover if it stood there alone.
    image
        The range image of the view.
    camera_from_table, cloud_from_table
        Transforms of homogeneous points from the table (right, away, height [m]) to the frame of the image's camera,
        and to that of the cloud.
    num_cut
        Number of objects left out because the image border cuts them; their hidden share is unknown, and what they
        hide counts in `SeenObject.occlusion` only.
    name
        Where the cloud comes from.
    """

    table: Plane
    objects: tuple[SeenObject, ...]
    hides: Hides
    labels: Labels
    silhouettes: Bool[np.ndarray, "N H W"]
    image: RangeImage
    camera_from_table: Transform
    cloud_from_table: Transform
    num_cut: int
    name: str

    @property
    def places_m(self) -> Points:
        """Position of each object on the table: to the right of the camera's foot, away from it, and up [m]."""
        return np.array([seen.solid.middle_m for seen in self.objects], dtype=np.float64).reshape(-1, 3)

    def scene(self) -> Scene:
        """Scene of this view for a world."""
        return Scene(self.hides, self.name, places_m=self.places_m[:, :2])


def perceive(cloud: Cloud, sensor: DepthSensor = XTION) -> View:
    """Find the table in a cloud, the objects on it, and who hides whom.

    Parameters
    ----------
    cloud
        Cloud of one depth camera.
    sensor
        The depth camera, for the noise of its depths; if the table shows clearly more, that counts.

    Returns
    -------
    View
        View of the table; without objects if it is empty. The result is deterministic to the last bit.

    Raises
    ------
    CloudError
        There are too few points, or there is no table.
    """
    try:
        return _perceived(cloud, sensor)
    except (ArithmeticError, LookupError, ValueError, np.linalg.LinAlgError, QhullError) as error:
        raise CloudError(
            f"{cloud.name}: its points form no measurable surfaces ({reason_of(error)}); look at the cloud, and "
            "record it again"
        ) from error


def _perceived(cloud: Cloud, sensor: DepthSensor) -> View:
    image = range_image(cloud, sensor)
    plane = find_table(image)
    if (factor := noise_factor(plane, image)) > LARGEST_NOISE_FACTOR:
        image = replace(image, sensor=NoisierSensor(sensor, factor))
        plane = find_table(image)
    labels, solids, num_cut = objects_of_sheets(sheets_on_table(image, plane), plane, image)
    solids = tuple(
        extended(i, solid, labels, plane, image) if isinstance(solid, Vessel) else solid
        for i, solid in enumerate(solids)
    )
    found = occlusions(labels, solids, plane, image)
    # Rays without return, −1, are counted first, and dropped.
    num_points = np.bincount(image.pixel_of_point + 1, minlength=image.depth_m.size + 1)[1:]

    def seen(i: int, solid: Vessel | Hull, pixels: Pixels) -> SeenObject:
        points = plane.table_points(image.points_m.reshape(-1, 3)[pixels])
        low, high = percentiles(points, EXTENT_PERCENT, 100 - EXTENT_PERCENT)
        middle = plane.camera_points(solid.middle_m[None])[0]
        return SeenObject(
            id=i,
            centroid_m=image.cloud_from_camera @ middle + cloud.eye_m,
            height_m=float(high[2]),
            size_m=np.array([high[0] - low[0], high[1] - low[1], high[2]]),
            occlusion=float(found.occlusion[i]),
            num_points=int(num_points[pixels].sum()),
            is_upright=_is_upright(solid, high - low, float(high[2])),
            pixels=pixels,
            solid=solid,
        )

    objects = tuple(map(seen, range(len(solids)), solids, pixels_of(labels)))
    normal = image.cloud_from_camera @ plane.normal
    table = Plane(normal, float(plane.offset_m + normal @ cloud.eye_m))
    from_table, from_camera = np.eye(4), np.eye(4)
    from_table[:3, :3] = np.concatenate([plane.axes(), plane.normal[None]]).T
    from_table[:3, 3] = plane.offset_m * plane.normal
    from_camera[:3, :3], from_camera[:3, 3] = image.cloud_from_camera, cloud.eye_m
    return View(
        table,
        objects,
        found.hides,
        np.maximum(labels, NO_OBJECT),
        found.silhouettes,
        image,
        from_table,
        from_camera @ from_table,
        num_cut,
        cloud.name,
    )


def _is_upright(solid: Vessel | Hull, extent_m: Vector, height_m: float) -> bool:
    if isinstance(solid, Vessel):
        return solid.is_upright
    return bool(height_m > UPRIGHT_ASPECT * max(extent_m[:2]))


SMALLEST_OTHER_SHARE = 0.02
"""Smaller hidden shares that no object of the view explains are rounding of silhouettes."""


def hidden_by_others(view: View, seen: SeenObject) -> float:
    """Return the share of an object's silhouette that only things hide that are not among the objects of the view.

    Parameters
    ----------
    view, seen
        The view, and an object of it.
    """
    return max(0.0, seen.occlusion - float(view.hides[seen.id].sum()))


def left_out_in_words(view: View) -> str:
    """Describe what a decision on the objects of a view misses; an empty string if nothing.

    Parameters
    ----------
    view
        The view to check.
    """
    hidden = [f"{seen.id}" for seen in view.objects if hidden_by_others(view, seen) >= SMALLEST_OTHER_SHARE]
    cut = f"left out: {view.num_cut} that the image border cuts" if view.num_cut else ""
    by = f"what is cut by the image border or beside the table hides {', '.join(hidden)}, which counts as in view"
    return "; ".join([*([cut] if cut else []), *([by] if hidden else [])])


FARTHEST_TABLE_M = 3.0
"""Cups on a table that is farther from the camera are hardly seen [m]."""


def remedy_without_objects(view: View) -> str:
    """What to do about a view without objects on its table."""
    away_m = float(np.median(view.image.depth_m[view.image.is_return]))
    unit = f" (points are {away_m:.3g} m away: check that they are in metres)" if away_m > FARTHEST_TABLE_M else ""
    return f"bring the whole table with its objects into view, upright in the image{unit}"


def most_hidden(objects: Sequence[SeenObject]) -> SeenObject:
    """Return the object with the largest hidden share, the first one among equals.

    Parameters
    ----------
    objects
        At least one object.
    """
    return max(objects, key=lambda seen: (seen.occlusion, -seen.id))


LOWEST_M, HIGHEST_M = 0.045, 0.17
"""Range of a cup's height, standing or lying [m]; on the ten tables that come with halfseen, 0.062 to 0.149."""

WIDEST_M = 0.19
"""Largest width of a cup, including the handle [m]; on these tables, 0.154."""

LARGEST_SHARE = 1.0 / 3.0
"""Up to this share, objects without a cup's shape may be badly perceived cups."""


def other_things(view: View) -> tuple[int, ...]:
    """Find the objects of a view that are certainly not cups.

    Parameters
    ----------
    view
        View from `halfseen.perception.perceive`.

    Returns
    -------
    tuple
        Their numbers in increasing order; empty if all may be cups.
    """
    is_odd = {seen.id: _has_other_height(seen) or _has_other_shape(seen) for seen in view.objects}
    if sum(is_odd.values()) > LARGEST_SHARE * len(view.objects):
        return tuple(index for index, is_it in is_odd.items() if is_it)
    return tuple(seen.id for seen in view.objects if _has_other_height(seen))


def other_things_in_words(view: View) -> str:
    """Describe the objects that are not cups, with reasons; an empty string if all may be cups.

    Parameters
    ----------
    view
        The view to check.
    """
    odd = [view.objects[index] for index in other_things(view)]
    if not odd:
        return ""
    each = "; ".join(f"{seen.id} {_by(seen)}" for seen in odd)
    them = "this is not a table of cups" if len(odd) == len(view.objects) else "not all on this table are cups"
    return f"{them}, and nothing was learned about other objects: {each}"


def _has_other_height(seen: SeenObject) -> bool:
    return not LOWEST_M <= seen.height_m <= HIGHEST_M


def _has_other_shape(seen: SeenObject) -> bool:
    return isinstance(seen.solid, Hull) or _width_m(seen) > WIDEST_M


def _width_m(seen: SeenObject) -> float:
    return float(seen.size_m[:2].max())


def _by(seen: SeenObject) -> str:
    if _has_other_height(seen):
        return f"is {seen.height_m:.3f} m high (a cup {LOWEST_M} to {HIGHEST_M})"
    if isinstance(seen.solid, Hull):
        return "does not have the shape of a vessel"
    return f"is {_width_m(seen):.3f} m wide (a cup at most {WIDEST_M})"
