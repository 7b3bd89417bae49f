"""From a cloud to a view: the table, what stands on it, and who hides whom; and whether these are cups.

What perception and every law know are tables of tumblers and mugs that stand or lie. What counts as another thing: a
height that no cup has; and, where more than a third of the objects show it, a shape that no vessel fits, or a width
that no cup has. One such shape among cups is most likely two cups that were taken for one.

*What this cannot tell.* A can is a cup to it, and so is a bowl, a jar, a box that is partly hidden, or a thing of a
cup's size that is round: it tells what is surely something else, and passes what may be a cup.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import QhullError

from halfseen.arrays import Hides, Points
from halfseen.errors import CloudError
from halfseen.perception.clouds import XTION, Cloud, DepthSensor, Vector
from halfseen.perception.grouping import objects_of_sheets
from halfseen.perception.objects import Labels, pixels_of, sheets_on_table
from halfseen.perception.occlusion import extended, occlusions
from halfseen.perception.plane import Plane, find_table
from halfseen.perception.range_image import Pixels, RangeImage, range_image
from halfseen.perception.solids import Hull, Vessel
from halfseen.reading import reason_of
from halfseen.shapes import Bool, Float
from halfseen.world.scene import Scene

# Part of an object's height over the table that counts as its extent, from below and above [%]: single points err.
EXTENT_PERCENT = 1.0
# A shape without a vertical axis stands upright if it is higher than this times its width.
UPRIGHT_ASPECT = 1.0


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
        How high it reaches over the table [m].
    size_m
        Extent of what is seen of it: to the camera's right, away from the camera, and up [m].
    occlusion
        Share of its silhouette that is hidden behind nearer objects, in [0, 1].
    num_points
        Points of the cloud that are seen of it.
    is_upright
        False if it lies.
    pixels
        Flat indices of its pixels in the range image.
    solid
        What completes it, in coordinates of the table: right, away from the camera, height over the plane [m].
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
    """What a camera sees on a table.

    Parameters
    ----------
    table
        Plane of the table, in the frame of the cloud; its normal points up.
    objects
        What stands or lies on it, largest in the image first.
    hides
        ``hides[i, j]`` is the share of object i's silhouette that is hidden by object j alone.
    labels
        Object of each pixel of the range image; −1 where there is none.
    silhouettes
        What each object would fill of the image if it stood there alone.
    image
        The range image that all this was seen in.
    camera_from_table, cloud_from_table
        Take homogeneous points of the table (right, away, height [m]) into the frame of the image's camera, and into
        that of the cloud.
    num_cut
        Objects left out because the border of the image cuts them: nobody knows how much of them is hidden.
    name
        Where the cloud comes from.
    """

    table: Plane
    objects: tuple[SeenObject, ...]
    hides: Hides
    labels: Labels
    silhouettes: Bool[np.ndarray, "N H W"]
    image: RangeImage
    camera_from_table: Float[np.ndarray, "4 4"]
    cloud_from_table: Float[np.ndarray, "4 4"]
    num_cut: int
    name: str

    @property
    def places_m(self) -> Points:
        """Where each object is on the table: to the right of the camera's foot, away from it, and up [m]."""
        return np.array([seen.solid.middle_m for seen in self.objects], dtype=np.float64).reshape(-1, 3)

    def scene(self) -> Scene:
        """Return what the world needs to know of this view."""
        return Scene(self.hides, self.name, places_m=self.places_m[:, :2])


def perceive(cloud: Cloud, sensor: DepthSensor = XTION) -> View:
    """Find the table in a cloud, what stands on it, and who hides whom.

    Parameters
    ----------
    cloud
        What one depth camera returned.
    sensor
        Which camera: how far its depths err.

    Returns
    -------
    View
        Without objects if the table is empty. One cloud gives one view, to the last bit.

    Raises
    ------
    CloudError
        There are too few points, or no table.
    """
    try:
        return _perceived(cloud, sensor)
    except (ArithmeticError, LookupError, ValueError, np.linalg.LinAlgError, QhullError) as error:
        raise CloudError(
            f"{cloud.name}: its points make no surfaces that can be measured ({reason_of(error)}); look at the "
            "cloud, and record it again"
        ) from error


def _perceived(cloud: Cloud, sensor: DepthSensor) -> View:
    image = range_image(cloud, sensor)
    plane = find_table(image)
    labels, solids, num_cut = objects_of_sheets(sheets_on_table(image, plane), plane, image)
    solids = tuple(
        extended(i, solid, labels, plane, image) if isinstance(solid, Vessel) else solid
        for i, solid in enumerate(solids)
    )
    found = occlusions(labels, solids, plane, image)
    num_points = np.bincount(image.pixel_of_point[image.pixel_of_point >= 0], minlength=image.depth_m.size)

    def seen(i: int, solid: Vessel | Hull, pixels: Pixels) -> SeenObject:
        points = plane.table_points(image.points_m.reshape(-1, 3)[pixels])
        low, high = np.percentile(points, [EXTENT_PERCENT, 100 - EXTENT_PERCENT], axis=0)
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
        labels,
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


def most_hidden(objects: Sequence[SeenObject]) -> SeenObject:
    """Return the object that is hidden most; the first of equals.

    Parameters
    ----------
    objects
        At least one object.
    """
    return max(objects, key=lambda seen: (seen.occlusion, -seen.id))


LOWEST_M, HIGHEST_M = 0.045, 0.17
"""Heights that a cup has, standing or lying [m]: on the ten tables that come with halfseen, 0.062 to 0.149."""

WIDEST_M = 0.19
"""Longest that a cup is, across, handle included [m]: on these tables, 0.154."""

LARGEST_SHARE = 1.0 / 3.0
"""Share of objects without a cup's shape up to which they may be cups that were badly seen."""


def other_things(view: View) -> tuple[int, ...]:
    """Find the objects of a view that are surely no cups.

    Parameters
    ----------
    view
        What a camera sees, by `halfseen.perception.perceive`.

    Returns
    -------
    tuple
        Their numbers, rising; empty where all may be cups.
    """
    is_odd = {seen.id: _has_other_height(seen) or _has_other_shape(seen) for seen in view.objects}
    if sum(is_odd.values()) > LARGEST_SHARE * len(view.objects):
        return tuple(index for index, is_it in is_odd.items() if is_it)
    return tuple(seen.id for seen in view.objects if _has_other_height(seen))


def other_things_in_words(view: View) -> str:
    """Say which objects are no cups, and by what; nothing where all may be.

    Parameters
    ----------
    view
        What a camera sees.
    """
    odd = [view.objects[index] for index in other_things(view)]
    if not odd:
        return ""
    each = "; ".join(f"{seen.id} {_by(seen)}" for seen in odd)
    them = "this is no table of cups" if len(odd) == len(view.objects) else "not all on this table are cups"
    return f"{them}, and of other things nothing was learned: {each}"


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
        return "is no vessel by its shape"
    return f"is {_width_m(seen):.3f} m wide (a cup at most {WIDEST_M})"
