"""A view's objects as they are shown: solids, shadows, and what a LIFT would reveal."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from halfseen.arrays import Points
from halfseen.perception.clouds import Cloud, Colours, Vector
from halfseen.perception.solids import Hull, Vessel
from halfseen.perception.view import View
from halfseen.shapes import Float
from halfseen.watch.shapes import Mesh, convex_mesh, moved, revealed_by, shadow
from halfseen.watch.stage_view import Shown

Transform = Float[np.ndarray, "4 4"]

_DARKEST, _LIGHTEST = 70, 200
_SPREAD_PERCENT = 2.0


class Known(NamedTuple):
    """What is known of an object, seen now or not."""

    number: int
    """By which decisions call it."""
    is_dirty: float
    """P(DIRTY)."""
    occlusion: float
    """Hidden share."""
    middle_m: Vector
    """Where it was last seen, in coordinates of the table [m]."""
    solid: Vessel | Hull | None
    """In coordinates of the table; None where it is not in view."""


def shown_objects(known: Sequence[Known], eye_m: Vector, frame_from_table: Transform) -> tuple[Shown, ...]:
    """Give objects the shapes in which they are shown.

    Parameters
    ----------
    known
        The objects.
    eye_m
        Where the camera is, in coordinates of the table [m].
    frame_from_table
        Takes homogeneous points of the table to where they are shown.
    """
    solids = [None if each.solid is None else convex_mesh(each.solid.outline_m()) for each in known]
    there = [solid for solid in solids if solid is not None]
    return tuple(_shown(each, solid, there, eye_m, frame_from_table) for each, solid in zip(known, solids, strict=True))


def _shown(known: Known, solid: Mesh | None, there: list[Mesh], eye_m: Vector, placed: Transform) -> Shown:
    middle_m = moved(np.asarray(known.middle_m, dtype=np.float64)[None], placed)[0]
    if solid is None:
        return Shown(known.number, known.is_dirty, known.occlusion, middle_m, None, None, np.zeros((0, 3)))
    index = next(k for k, each in enumerate(there) if each is solid)
    revealed_m = moved(revealed_by(index, there, eye_m), placed)
    behind = shadow(solid, eye_m).moved(placed)
    return Shown(known.number, known.is_dirty, known.occlusion, middle_m, solid.moved(placed), behind, revealed_m)


def eye_over_table(view: View, cloud: Cloud) -> Vector:
    """Where the camera is, in coordinates of the table [m]."""
    return moved(np.asarray(cloud.eye_m, dtype=np.float64)[None], np.linalg.inv(view.cloud_from_table))[0]


def coloured_points(cloud: Cloud, frame_from_cloud: Transform) -> tuple[Points, Colours]:
    """Give what returned, and its colours; grey by height where the cloud has none.

    Parameters
    ----------
    cloud
        What the camera returned.
    frame_from_cloud
        Takes homogeneous points of the cloud to where they are shown.
    """
    is_return = np.isfinite(cloud.points_m).all(axis=1)
    points_m = moved(cloud.points_m[is_return], frame_from_cloud).astype(np.float32)
    if cloud.colours is not None:
        return points_m, cloud.colours[is_return]
    low_m, high_m = np.percentile(points_m[:, 2], [_SPREAD_PERCENT, 100 - _SPREAD_PERCENT])
    share = np.clip((points_m[:, 2] - low_m) / max(high_m - low_m, 1e-6), 0.0, 1.0)
    grey = (_DARKEST + share * (_LIGHTEST - _DARKEST)).astype(np.uint8)
    return points_m, np.repeat(grey[:, None], 3, axis=1)
