"""Windows of a picture: the pixels that parts of a model may show in, or may keep the projector from."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from itertools import product

import mujoco
import numpy as np

from halfseen.arrays import Image
from halfseen.scene.camera import Camera
from halfseen.shapes import Bool, Float

Boxes = Float[np.ndarray, "parts 8 3"]
Mask = Bool[np.ndarray, "H W"]

_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
_ROUNDING_PX = 2


def boxes_m(model: mujoco.MjModel, data: mujoco.MjData, camera: Camera, groups: Sequence[int]) -> Boxes:
    """Corners of a box around each geom of some groups, in the camera's frame [m].

    Parameters
    ----------
    model, data
        The world, and where the bodies are.
    camera
        Whose frame.
    groups
        Of the geoms.
    """
    is_asked = np.isin(model.geom_group, groups)
    middle_m, half_m = np.split(model.geom_aabb[is_asked], 2, axis=1)
    corners_m = middle_m[:, None] + half_m[:, None] * _CORNERS
    turned_m = np.einsum("pij,pcj->pci", data.geom_xmat[is_asked].reshape(-1, 3, 3), corners_m)
    world_m = data.geom_xpos[is_asked][:, None] + turned_m
    return camera.world_from_camera.apply_inverse(world_m.reshape(-1, 3)).reshape(world_m.shape)


def shown_within(boxes_m: Boxes, camera: Camera) -> Mask:
    """Pixels in which what is in some box may show; all, if one is not wholly in front of the camera.

    Parameters
    ----------
    boxes_m
        In the camera's frame [m].
    camera
        The camera.
    """
    shape = (camera.num_rows, camera.num_columns)
    if (boxes_m[..., 2] <= 0).any():
        return np.ones(shape, dtype=bool)
    mask = np.zeros(shape, dtype=bool)
    pixels = (boxes_m @ camera.intrinsics.T)[..., :2] / boxes_m[..., 2:]
    low = np.maximum(np.floor(pixels.min(axis=1)).astype(int) - _ROUNDING_PX, 0)
    high = np.maximum(np.ceil(pixels.max(axis=1)).astype(int) + _ROUNDING_PX + 1, 0)
    for (left, top), (right, bottom) in zip(low, high, strict=True):
        mask[top:bottom, left:right] = True
    return mask


def shaded_within(boxes_m: Boxes, camera: Camera, baseline_m: float, depth_m: Image) -> Mask:
    """Pixels whose points what is in some box may keep the projector from.

    Parameters
    ----------
    boxes_m
        In the camera's frame [m].
    camera
        The camera.
    baseline_m
        The projector stands this far to its right [m].
    depth_m
        Of each pixel [m].
    """
    mask = shown_within(boxes_m - [baseline_m, 0.0, 0.0], camera)
    column = projector_columns_px(camera, baseline_m, depth_m)
    is_point = np.isfinite(depth_m)
    column = np.rint(np.where(is_point, column, 0.0)).astype(int)
    inside = mask[np.arange(camera.num_rows)[:, None], np.clip(column, 0, camera.num_columns - 1)]
    # Points beyond the projector's picture count as within.
    return is_point & (inside | (column < 0))


def projector_columns_px(camera: Camera, baseline_m: float, depth_m: Image) -> Image:
    """Column at which a projector like the camera has the point of each pixel; its row is the pixel's own [px].

    Parameters
    ----------
    camera
        The camera.
    baseline_m
        The projector stands this far to its right [m].
    depth_m
        Of each pixel [m].
    """
    return np.arange(camera.num_columns) - camera.focal_px[0] * baseline_m / depth_m
