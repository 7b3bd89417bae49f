"""The room as MuJoCo sees it: a floor, a wall, a table, and the cups on it, free to move or fixed."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence

import mujoco

from halfseen.scene.cups import Cup, Faces, Vertices, body_mesh, handle_mesh
from halfseen.scene.poses import Pose
from halfseen.scene.rays import CUP_GROUP
from halfseen.scene.table import TABLE_SIZE_M, TABLE_TOP_M

TIMESTEP_S = 0.002
_TOP_THICKNESS_M = 0.03
_LEG_RADIUS_M = 0.025
_WALL_BEHIND_M = 1.4  # from the table's middle
_DENSITY = 2300.0  # stoneware [kg/m³]
# Sliding [-], spinning [m] and rolling [m] friction; a cup that lies must stop rolling as it does on wood.
_FRICTION = (0.6, 0.004, 0.0015)
_STIFF_CONTACT = (0.006, 1.0)  # time constant [s] and damping ratio: a cup sinks in by less than 0.1 mm


def cup_name(index: int) -> str:
    """Name of a cup's body in the model."""
    return f"cup_{index}"


def room_model(cups: Sequence[Cup], world_from_cup: Sequence[Pose], *, is_free: bool) -> mujoco.MjModel:
    """Compile the whole room.

    Parameters
    ----------
    cups, world_from_cup
        The cups and their poses.
    is_free
        True if physics may move the cups; False if they are fixed where they are.

    Returns
    -------
    mujoco.MjModel
        Body ``cup_i`` is cup i; everything else belongs to the world body.
    """
    return room_spec(cups, world_from_cup, is_free=is_free).compile()


def room_spec(cups: Sequence[Cup], world_from_cup: Sequence[Pose], *, is_free: bool) -> mujoco.MjSpec:
    """Build the whole room without compiling it, so that more can be added; parameters are those of `room_model`."""
    spec = _empty_spec()
    _add_furniture(spec)
    for index, (cup, pose) in enumerate(zip(cups, world_from_cup, strict=True)):
        _add_cup(spec, index, cup, pose, is_free=is_free)
    return spec


def lone_cup_model(cup: Cup, world_from_cup: Pose) -> mujoco.MjModel:
    """Compile a world that holds nothing but one cup, fixed.

    Parameters
    ----------
    cup, world_from_cup
        The cup and its pose.

    Returns
    -------
    mujoco.MjModel
        Body 1 is the cup.
    """
    spec = _empty_spec()
    _add_cup(spec, 0, cup, world_from_cup, is_free=False)
    return spec.compile()


def _empty_spec() -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.option.timestep = TIMESTEP_S
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    return spec


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
    """Add a cup: rays meet the hollow mesh, contacts its convex hull, which is exact while nothing is inside."""
    body = spec.worldbody.add_body(name=cup_name(index), pos=list(pose.position_m), quat=list(pose.quaternion))
    if is_free:
        body.add_freejoint()
    meshes = {"vessel": body_mesh(cup)}
    if cup.handle_m > 0:
        meshes["handle"] = handle_mesh(cup)
    for part, (vertices, faces) in meshes.items():
        name = f"{cup_name(index)}_{part}"
        _add_mesh(spec, name, vertices, faces)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            density=_DENSITY,
            friction=list(_FRICTION),
            solref=list(_STIFF_CONTACT),
            condim=6,
            group=CUP_GROUP,
        )


def _add_mesh(spec: mujoco.MjSpec, name: str, vertices: Vertices, faces: Faces) -> None:
    mesh = spec.add_mesh(name=name, uservert=vertices.ravel().tolist(), userface=faces.ravel().tolist())
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT
