"""The room as a MuJoCo model, and the view of an ideal camera: depth, labels, the silhouette of each cup alone.

The room has a floor, a wall, and a table with cups, free to move or fixed.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np

from halfseen.arrays import Image
from halfseen.scene.cups import Cup, Faces, Vertices, body_mesh, handle_mesh, outline
from halfseen.scene.poses import Pose
from halfseen.scene.rays import CUP_GROUP, SEEN_GROUPS, Directions, Hits, at_rest, cast
from halfseen.scene.table import TABLE_SIZE_M, TABLE_TOP_M, Camera, Table
from halfseen.shapes import Bool, Float, Int

TIMESTEP_S = 0.002
_TOP_THICKNESS_M = 0.03
_LEG_RADIUS_M = 0.025
_WALL_BEHIND_M = 1.4  # from the table's middle
_DENSITY = 2300.0  # stoneware [kg/m³]
# Sliding [-], spinning [m] and rolling [m] friction; a lying cup must stop rolling as it does on wood.
_FRICTION = (0.6, 0.004, 0.0015)
_STIFF_CONTACT = (0.006, 1.0)  # time constant [s] and damping ratio: a cup sinks in by less than 0.1 mm


def cup_name(index: int) -> str:
    """Name of a cup's body in the model."""
    return f"cup_{index}"


def room_spec(
    cups: Sequence[Cup], world_from_cup: Sequence[Pose], *, is_free: bool, is_furnished: bool = True
) -> mujoco.MjSpec:
    """Build the whole room, or only its cups; physics moves the cups if they are free, otherwise they are fixed.

    Body ``cup_i`` is cup i; everything else belongs to the world body.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = TIMESTEP_S
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    if is_furnished:
        _add_furniture(spec)
    for index, (cup, pose) in enumerate(zip(cups, world_from_cup, strict=True)):
        _add_cup(spec, index, cup, pose, is_free=is_free)
    return spec


def lone_cup_model(cup: Cup, world_from_cup: Pose) -> mujoco.MjModel:
    """Compile a world with one fixed cup and nothing else; body 1 is the cup."""
    return room_spec([cup], [world_from_cup], is_free=False, is_furnished=False).compile()


def _add_furniture(spec: mujoco.MjSpec) -> None:
    half_x_m, half_y_m = TABLE_SIZE_M[0] / 2, TABLE_SIZE_M[1] / 2
    box, cylinder = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
    world = spec.worldbody
    world.add_geom(type=box, pos=[0, 0, -0.05], size=[4, 4, 0.05])
    world.add_geom(type=box, pos=[0, _WALL_BEHIND_M + 0.05, 1.5], size=[4, 0.05, 1.5])
    world.add_geom(
        type=box,
        pos=[0, 0, TABLE_TOP_M - _TOP_THICKNESS_M / 2],
        size=[half_x_m, half_y_m, _TOP_THICKNESS_M / 2],
        friction=list(_FRICTION),
        solref=list(_STIFF_CONTACT),
        condim=6,
    )
    leg_m = (TABLE_TOP_M - _TOP_THICKNESS_M) / 2
    for x_m in (-half_x_m + 0.05, half_x_m - 0.05):
        for y_m in (-half_y_m + 0.05, half_y_m - 0.05):
            world.add_geom(type=cylinder, pos=[x_m, y_m, leg_m], size=[_LEG_RADIUS_M, leg_m, 0])


def _add_cup(spec: mujoco.MjSpec, index: int, cup: Cup, pose: Pose, *, is_free: bool) -> None:
    """Add a cup: rays hit the hollow mesh; contacts use its convex hull, which is exact while the cup is empty."""
    body = spec.worldbody.add_body(name=cup_name(index), pos=list(pose.position_m), quat=list(pose.quaternion))
    if is_free:
        body.add_freejoint()
    meshes = {"vessel": body_mesh(cup)}
    if cup.handle_m > 0:
        meshes["handle"] = handle_mesh(cup)
    for part, (vertices, faces) in meshes.items():
        mesh = add_mesh(spec, f"{cup_name(index)}_{part}", vertices, faces)
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=mesh.name,
            density=_DENSITY,
            friction=list(_FRICTION),
            solref=list(_STIFF_CONTACT),
            condim=6,
            group=CUP_GROUP,
        )


def add_mesh(spec: mujoco.MjSpec, name: str, vertices: Vertices, faces: Faces) -> mujoco.MjsMesh:
    """Add a mesh with vertices [m] and triangles to a model."""
    return spec.add_mesh(name=name, uservert=vertices.ravel().tolist(), userface=faces.ravel().tolist())


def mesh_of(model: mujoco.MjModel, mesh: int) -> tuple[Vertices, Faces]:
    """Vertices [m] and triangles of a mesh of a compiled model, along its principal axes."""
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    return vertices, model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]


LIT_TOLERANCE_M = 0.002
"""A ray from the projector lights a point even if it ends this much before it [m]."""
_REACH_M = 8.0


@dataclass(frozen=True)
class IdealView:
    """A view without noise.

    Parameters
    ----------
    depth_m
        Depth along the camera's z axis [m]; NaN without a hit.
    body
        Body of each pixel: 0 is the room, i + 1 is cup i, −1 is nothing; other bodies of the model follow the cups.
    incidence_cosine
        Cosine of the angle between ray and surface normal; NaN without a hit.
    is_lit
        True where a projector beside the camera reaches the point that the camera sees.
    """

    depth_m: Image
    body: Int[np.ndarray, "H W"]
    incidence_cosine: Image
    is_lit: Bool[np.ndarray, "H W"]

    @property
    def labels(self) -> Int[np.ndarray, "H W"]:
        """Cup of each pixel; −1 for none."""
        return np.where(self.body > 0, self.body - 1, -1)


@dataclass(frozen=True)
class Sight:
    """A camera and a projector among bodies.

    Parameters
    ----------
    data
        The bodies, in their poses.
    camera
        The camera.
    baseline_m
        Distance of the projector to the camera's right [m].
    """

    data: mujoco.MjData
    camera: Camera
    baseline_m: float

    @property
    def projector_m(self) -> Float[np.ndarray, " 3"]:
        """Position of the projector in the world [m]."""
        pose = self.camera.world_from_camera
        return np.asarray(pose.position_m) + self.baseline_m * pose.rotation[:, 0]


def ideal_view(sight: Sight, groups: tuple[int, ...] = SEEN_GROUPS) -> IdealView:
    """View bodies with an ideal camera; `groups` are the visible geoms."""
    depth_m, hits, directions = pixel_hits(sight.data, sight.camera, groups=groups)
    points_m = np.asarray(sight.camera.world_from_camera.position_m) + hits.distance_m[:, None] * directions
    return IdealView(
        depth_m=depth_m,
        body=hits.body.reshape(depth_m.shape),
        incidence_cosine=np.abs(np.sum(hits.normal * directions, axis=1)).reshape(depth_m.shape),
        is_lit=is_reached(sight, points_m, groups).reshape(depth_m.shape),
    )


@lru_cache(maxsize=1)
def table_view(table: Table, baseline_m: float) -> IdealView:
    """View a table with its own camera; the last view is cached, because a drawn table is usually viewed again.

    The projector is `baseline_m` to the camera's right [m]. Arrays are read-only.
    """
    room = room_spec(table.cups, table.world_from_cup, is_free=False).compile()
    view = ideal_view(Sight(at_rest(room), table.camera, baseline_m))
    for image in (view.depth_m, view.body, view.incidence_cosine, view.is_lit):
        image.flags.writeable = False
    return view


@lru_cache(maxsize=1)
def lone_depths_m(table: Table) -> Float[np.ndarray, "N H W"]:
    """Depth image of every cup alone in the world; the result for the last table is cached.

    Rays are cast only inside the bounding box of the cup's outline, so that ten cups cost less than one full picture.
    Depths [m] are infinite outside the cup, and read-only.
    """
    depths_m = np.full((table.num_cups, table.camera.num_rows, table.camera.num_columns), np.inf)
    for index, (cup, pose) in enumerate(zip(table.cups, table.world_from_cup, strict=True)):
        window = _window(table.camera, cup, pose)
        depth_m, _, _ = pixel_hits(at_rest(lone_cup_model(cup, pose)), table.camera, window)
        depths_m[index][window] = np.where(np.isnan(depth_m), np.inf, depth_m)
    depths_m.flags.writeable = False
    return depths_m


def is_whole_in_picture(table: Table, margin_px: float = 8.0) -> bool:
    """Whether every cup lies inside the picture, at least `margin_px` from its border [px]."""
    size_px = np.array([table.camera.num_columns, table.camera.num_rows]) - 1.0
    for cup, pose in zip(table.cups, table.world_from_cup, strict=True):
        pixels = table.camera.project(pose.apply(outline(cup)))
        if np.any(pixels < margin_px) or np.any(pixels > size_px - margin_px):
            return False
    return True


def pixel_hits(
    data: mujoco.MjData,
    camera: Camera,
    window: tuple[slice, slice] | Bool[np.ndarray, "H W"] = np.s_[:, :],
    groups: tuple[int, ...] = SEEN_GROUPS,
) -> tuple[Float[np.ndarray, "*px"], Hits, Directions]:
    """Cast the rays of the pixels of a window among bodies; `groups` are the visible geoms.

    Returns the depth of each pixel, NaN without a hit [m], the hits, and the direction of each ray in the world.
    """
    rays = camera.pixel_rays()[window]
    lengths = np.linalg.norm(rays, axis=-1)
    directions = (rays / lengths[..., None]).reshape(-1, 3) @ camera.world_from_camera.rotation.T
    hits = cast(data, np.asarray(camera.world_from_camera.position_m), directions, _REACH_M, groups)
    return hits.distance_m.reshape(lengths.shape) / lengths, hits, directions


def is_reached(
    sight: Sight, points_m: Float[np.ndarray, "n 3"], groups: tuple[int, ...] = SEEN_GROUPS
) -> Bool[np.ndarray, " n"]:
    """Whether the projector reaches each point past some groups of geoms: the first hit on the way is the point itself.

    Points are in world coordinates [m]; a NaN is never reached.
    """
    projector_m = sight.projector_m
    is_point = np.isfinite(points_m[:, 0])
    ways_m = points_m[is_point] - projector_m
    lengths_m = np.linalg.norm(ways_m, axis=1)
    first = cast(sight.data, projector_m, ways_m / lengths_m[:, None], _REACH_M + 1.0, groups)
    # A ray without a hit passed the edge of the surface at which it was aimed: the point is lit.
    reached = np.isnan(first.distance_m) | (first.distance_m >= lengths_m - LIT_TOLERANCE_M)
    is_lit = np.zeros(len(points_m), dtype=bool)
    is_lit[is_point] = reached
    return is_lit


def _window(camera: Camera, cup: Cup, world_from_cup: Pose) -> tuple[slice, slice]:
    """Rows and columns of the bounding box of a cup's outline, within the picture."""
    pixels = camera.project(world_from_cup.apply(outline(cup)))
    low = np.floor(pixels.min(axis=0)).astype(int)
    high = np.ceil(pixels.max(axis=0)).astype(int) + 1
    columns = slice(max(int(low[0]), 0), min(int(high[0]), camera.num_columns))
    rows = slice(max(int(low[1]), 0), min(int(high[1]), camera.num_rows))
    return rows, columns
