"""Physics: let cups drop onto the table and wait until they rest."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence

import mujoco
import numpy as np

from halfseen.errors import SceneError
from halfseen.scene.cups import Cup
from halfseen.scene.poses import Pose
from halfseen.scene.room import TIMESTEP_S, cup_name, room_model

REST_SPEED = 2e-3  # largest speed of a cup at rest [m/s, rad/s]
_QUIET_S = 0.2  # how long a cup must have been that slow: a cup that turns back while rocking is slow for an instant
_PATIENCE_S = 4.0


def settle(cups: Sequence[Cup], world_from_cup: Sequence[Pose]) -> tuple[Pose, ...] | None:
    """Let the cups fall and find where they come to rest.

    Parameters
    ----------
    cups
        The cups.
    world_from_cup
        Where they are let go, at rest.

    Returns
    -------
    tuple of Pose, or None
        Poses at rest; None if some cup still moves after 4 s.
    """
    model = room_model(cups, world_from_cup, is_free=True)
    data = mujoco.MjData(model)
    num_quiet = 0
    for _ in range(round(_PATIENCE_S / TIMESTEP_S)):
        mujoco.mj_step(model, data)
        num_quiet = num_quiet + 1 if np.max(np.abs(data.qvel)) < REST_SPEED else 0
        if num_quiet * TIMESTEP_S >= _QUIET_S:
            return tuple(_pose_of(data, index) for index in range(len(cups)))
    return None


def smallest_gap_m(cups: Sequence[Cup], world_from_cup: Sequence[Pose], beyond_m: float = 0.1) -> float:
    """Smallest distance between the convex hulls of any two cups [m].

    Parameters
    ----------
    cups, world_from_cup
        The cups and their poses.
    beyond_m
        Gaps larger than this are not measured [m].

    Returns
    -------
    float
        The smallest gap, or `beyond_m` if it is larger; negative where cups are inside one another.
    """
    if beyond_m <= 0:
        raise SceneError(f"smallest gap: beyond_m is {beyond_m}; give a positive length")
    model = room_model(cups, world_from_cup, is_free=False)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geoms = [np.flatnonzero(model.geom_bodyid == model.body(cup_name(index)).id) for index in range(len(cups))]
    gap_m = beyond_m
    for i in range(len(cups)):
        for j in range(i):
            for one in geoms[i]:
                for other in geoms[j]:
                    gap_m = min(gap_m, mujoco.mj_geomDistance(model, data, int(one), int(other), beyond_m, None))
    return float(gap_m)


def _pose_of(data: mujoco.MjData, index: int) -> Pose:
    body = data.body(cup_name(index))
    x_m, y_m, z_m = (float(value) for value in body.xpos)
    w, x, y, z = (float(value) for value in body.xquat)
    return Pose((x_m, y_m, z_m), (w, x, y, z)).rounded()
