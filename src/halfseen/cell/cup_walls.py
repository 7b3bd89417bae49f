"""Walls by which a robot holds a hollow cup: boxes around it that only robots touch, and that cameras do not see.

A cup meets tables and other cups by its convex hull, which no finger could reach into.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from itertools import pairwise
from math import pi
from typing import Any

import mujoco
import numpy as np

from halfseen.cell.contacts import WALLS, Contacts
from halfseen.scene.cups import Cup, handle_bow
from halfseen.scene.rays import UNSEEN_GROUP

NUM_WALLS = 16
_NUM_HANDLE_PARTS = 5


def add_walls(body: mujoco.MjsBody, cup: Cup, contacts: Contacts, friction: float | None = None) -> None:
    """Add walls, a bottom and a handle to the body of a cup; they weigh nothing.

    Parameters
    ----------
    body
        Of the cup, in its frame.
    cup
        Its dimensions.
    contacts
        How pads meet it.
    friction
        Sliding friction on pads [-]; None for that of `contacts`.
    """
    shared: dict[str, Any] = {
        "mass": 0,
        "contype": WALLS,
        "conaffinity": 0,
        "group": UNSEEN_GROUP,
        "priority": 2,
        **contacts.of_pad(friction),
    }
    for angle_rad in 2 * pi * (np.arange(NUM_WALLS) + 0.5) / NUM_WALLS:
        _add_wall(body, cup, angle_rad, shared)
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[cup.base_radius_m, 0.5 * cup.bottom_m, 0],
        pos=[0, 0, 0.5 * cup.bottom_m],
        **shared,
    )
    if cup.handle_m > 0:
        _add_handle(body, cup, shared)


def _add_wall(body: mujoco.MjsBody, cup: Cup, angle_rad: float, shared: dict[str, Any]) -> None:
    """A box as wide as its share of the circumference, leaning as the cup widens."""
    radial = np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
    around = np.array([-np.sin(angle_rad), np.cos(angle_rad), 0.0])
    up = (cup.rim_radius_m - cup.base_radius_m) / cup.height_m * radial + [0.0, 0.0, 1.0]
    up /= np.linalg.norm(up)
    out, middle_m = np.cross(around, up), cup.radius_at(0.5 * cup.height_m)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.stack([out, around, up], axis=1).ravel())
    length_m = np.hypot(cup.height_m, cup.rim_radius_m - cup.base_radius_m)
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[0.5 * cup.wall_m, middle_m * np.tan(pi / NUM_WALLS), 0.5 * length_m],
        pos=list(radial * middle_m + [0.0, 0.0, 0.5 * cup.height_m] - 0.5 * cup.wall_m * out),
        quat=list(quaternion),
        **shared,
    )


def _add_handle(body: mujoco.MjsBody, cup: Cup, shared: dict[str, Any]) -> None:
    bow_m, radius_m = handle_bow(cup, _NUM_HANDLE_PARTS + 1)
    for begin_m, end_m in pairwise(bow_m):
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[*begin_m, *end_m], size=[radius_m, 0, 0], **shared)
