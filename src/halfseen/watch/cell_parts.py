"""Bodies of a running cell as they are shown: of the arm, its hand, the table and the rack; not the cups."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from math import pi

import mujoco
import numpy as np

from halfseen.arrays import Points
from halfseen.cell.live_cell import LiveCell
from halfseen.scene.rays import FURNITURE_GROUP, ROBOT_GROUP
from halfseen.shapes import Float
from halfseen.watch.shapes import convex_mesh
from halfseen.watch.stage_view import Part

_NUM_AROUND, _NUM_UP = 20, 5
_ARMS, _WOOD = ((150, 158, 168), (214, 160, 96), (120, 170, 150)), (196, 170, 132)
"""Of the first arm, the second, and so on in turn; and of furniture."""
_OF_THE_ROOM_M = 1.0
"""What reaches farther from its middle is a wall or a floor, which the cloud shows [m]."""
_KINDS = mujoco.mjtGeom


class CellParts:
    """The bodies, and where they are.

    Parameters
    ----------
    cell
        The running cell.

    Attributes
    ----------
    parts
        What is shown.
    """

    def __init__(self, cell: LiveCell) -> None:
        model = cell.model
        shown = [
            geom
            for geom in range(model.ngeom)
            if model.geom_group[geom] in (FURNITURE_GROUP, ROBOT_GROUP)
            and model.geom_type[geom] != _KINDS.mjGEOM_PLANE
            and model.geom_rbound[geom] < _OF_THE_ROOM_M
        ]
        self._geoms = np.array(shown, dtype=np.int64)
        self.parts = tuple(self._part(cell, geom) for geom in shown)

    def _part(self, cell: LiveCell, geom: int) -> Part:
        solid, model = convex_mesh(_points(cell.model, geom)), cell.model
        if model.geom_group[geom] != ROBOT_GROUP:
            return Part(solid, _WOOD, is_robot=False)
        body = model.body(model.geom_bodyid[geom]).name
        (number,) = (k for k, name in enumerate(cell.kinematics) if body.startswith(f"{name}/"))
        return Part(solid, _ARMS[number % len(_ARMS)])

    def poses(self, cell: LiveCell) -> Float[np.ndarray, "parts 7"]:
        """Where they are now: place [m] and quaternion (w, x, y, z)."""
        poses = np.zeros((len(self._geoms), 7))
        for row, geom in zip(poses, self._geoms, strict=True):
            row[:3] = cell.data.geom_xpos[geom]
            mujoco.mju_mat2Quat(row[3:], cell.data.geom_xmat[geom])
        return poses


def _points(model: mujoco.MjModel, geom: int) -> Points:
    """Points whose convex hull is a geom, or holds it."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == _KINDS.mjGEOM_MESH:
        mesh = model.mesh(model.geom_dataid[geom])
        first, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
        return np.asarray(model.mesh_vert[first : first + count], dtype=np.float64)
    if kind == _KINDS.mjGEOM_BOX:
        return size * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    if kind == _KINDS.mjGEOM_CYLINDER:
        return np.concatenate([_ring(size[0], size[0], height_m) for height_m in (-size[1], size[1])])
    half_m = size[1] if kind == _KINDS.mjGEOM_CAPSULE else 0.0
    radii_m = size if kind == _KINDS.mjGEOM_ELLIPSOID else np.full(3, size[0])
    rise = 0.5 * pi * np.linspace(-1.0, 1.0, 2 * _NUM_UP)
    rings = [
        _ring(
            np.cos(angle) * radii_m[0],
            np.cos(angle) * radii_m[1],
            np.sin(angle) * radii_m[2] + np.sign(angle) * half_m,
        )
        for angle in rise
    ]
    return np.concatenate(rings)


def _ring(x_m: float, y_m: float, height_m: float) -> Points:
    angle = 2 * pi * np.arange(_NUM_AROUND) / _NUM_AROUND
    return np.stack([x_m * np.cos(angle), y_m * np.sin(angle), np.full(_NUM_AROUND, height_m)], axis=1)
