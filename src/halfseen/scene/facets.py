"""The meshes of a model as facets, and where they are."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from halfseen.scene.poses import Pose
from halfseen.shapes import Float, Int


@dataclass(frozen=True)
class Facets:
    """Facets of meshes, each in the frame of its geom.

    Parameters
    ----------
    corners_m
        Counterclockwise as seen from outside [m].
    geom, body
        To which each belongs.
    """

    corners_m: Float[np.ndarray, "facets 3 3"]
    geom: Int[np.ndarray, " facets"]
    body: Int[np.ndarray, " facets"]

    def seen_from(self, data: mujoco.MjData, world_from_camera: Pose) -> Float[np.ndarray, "facets 3 3"]:
        """Corners where the bodies are now, in a camera's frame [m]."""
        turns = data.geom_xmat.reshape(-1, 3, 3)[self.geom]
        world_m = np.einsum("fij,fcj->fci", turns, self.corners_m) + data.geom_xpos[self.geom, None]
        return world_from_camera.apply_inverse(world_m.reshape(-1, 3)).reshape(world_m.shape)


def mesh_facets(model: mujoco.MjModel, groups: Sequence[int]) -> Facets:
    """List the facets of all meshes of some groups.

    Parameters
    ----------
    model
        A compiled model.
    groups
        Of the geoms; those that are no meshes are passed over.
    """
    geoms = np.flatnonzero((model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & np.isin(model.geom_group, groups))
    corners_m = [_corners_m(model, int(model.geom_dataid[geom])) for geom in geoms]
    geom = np.repeat(geoms, [len(each) for each in corners_m])
    return Facets(np.concatenate([np.zeros((0, 3, 3)), *corners_m]), geom, model.geom_bodyid[geom].astype(np.int64))


def _corners_m(model: mujoco.MjModel, mesh: int) -> Float[np.ndarray, "facets 3 3"]:
    first_vertex, first_face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    faces = model.mesh_face[first_face : first_face + model.mesh_facenum[mesh]]
    return model.mesh_vert[first_vertex + faces].astype(np.float64)


def normals(corners_m: Float[np.ndarray, "facets 3 3"]) -> Float[np.ndarray, "facets 3"]:
    """Unit normals of facets, outward.

    Parameters
    ----------
    corners_m
        Counterclockwise as seen from outside [m].
    """
    first, second, third = np.moveaxis(corners_m, 1, 0)
    across = np.cross(second - first, third - first)
    return across / np.linalg.norm(across, axis=1, keepdims=True)
