"""Ray casting: what a ray from one point meets first."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass

import mujoco
import numpy as np

from halfseen.shapes import Float, Int

Directions = Float[np.ndarray, "rays 3"]

CUP_GROUP, ROBOT_GROUP, FURNITURE_GROUP, UNSEEN_GROUP = 0, 2, 3, 4
"""Groups of geoms: cups, which are meshes; robots and what never moves, where a model tells them apart; and what rays
pass through."""
SEEN_GROUPS = tuple(group for group in range(mujoco.mjNGROUP) if group != UNSEEN_GROUP)


@dataclass(frozen=True)
class Hits:
    """What each ray met first.

    Parameters
    ----------
    distance_m
        Way along the ray [m]; NaN where it met nothing.
    body
        Body that was met; −1 where none was.
    normal
        Unit normal of the surface; NaN where nothing was met.
    """

    distance_m: Float[np.ndarray, " rays"]
    body: Int[np.ndarray, " rays"]
    normal: Float[np.ndarray, "rays 3"]


def cast(
    model: mujoco.MjModel,
    origin_m: Float[np.ndarray, " 3"],
    unit_directions: Directions,
    reach_m: float,
    data: mujoco.MjData | None = None,
    groups: tuple[int, ...] = SEEN_GROUPS,
) -> Hits:
    """Cast rays from one point into a model.

    Parameters
    ----------
    model
        The world; it is not changed.
    origin_m
        Where all rays start [m].
    unit_directions
        Directions of length 1.
    reach_m
        Bodies beyond this distance are left out [m].
    data
        Where the bodies are; None for where they begin.
    groups
        Of the geoms that rays meet.

    Returns
    -------
    Hits
        One entry for each ray.
    """
    if data is None:
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
    num_rays = len(unit_directions)
    geom = np.full(num_rays, -1, dtype=np.int32)
    distance_m = np.full(num_rays, -1.0)
    normal = np.zeros(3 * num_rays)
    directions = np.ascontiguousarray(unit_directions, dtype=np.float64).ravel()
    met = np.isin(np.arange(mujoco.mjNGROUP), groups).astype(np.uint8)
    mujoco.mj_multiRay(model, data, origin_m, directions, met, True, -1, geom, distance_m, normal, num_rays, reach_m)
    is_hit = geom >= 0
    body = np.where(is_hit, model.geom_bodyid[np.maximum(geom, 0)], -1).astype(np.int64)
    normal = normal.reshape(-1, 3)
    return Hits(np.where(is_hit, distance_m, np.nan), body, np.where(is_hit[:, None], normal, np.nan))
