"""An arm from a user's MJCF file: its links and hinges, with our own servos.

The file is compiled unchanged, and the arm is rebuilt from the compiled model: bodies with their inertia, hinges, and
collision shapes. Everything else is dropped: its hand, other robots, surroundings, keyframes, motors, sensors,
equalities and tendons. The arm therefore fits into any cell, from any folder. Nothing in the file is run or downloaded.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

import hashlib
from dataclasses import dataclass
from functools import cached_property
from math import pi
from pathlib import Path

import mujoco
import numpy as np

from halfseen.cell.chain import Chain, find_chain
from halfseen.cell.gripper import ROBOT, add_servo
from halfseen.errors import SceneError
from halfseen.scene.poses import Pose, from_matrix
from halfseen.scene.view import add_mesh, mesh_of
from halfseen.shapes import Float

_ARMATURE_KGM2 = 0.2  # minimum: a light wrist must hold a cup
_RATE_PER_S = 70.0  # response rate of the servos: that of the arm with which the cell was tuned
_NUM_DRAWN = 64
_LEAST_KG, _LEAST_KGM2 = 1e-3, 1e-6  # a moving body needs mass, even after its hand is removed
_MESHES = (int(mujoco.mjtGeom.mjGEOM_MESH), int(mujoco.mjtGeom.mjGEOM_SDF))
_SOLID = range(int(mujoco.mjtGeom.mjGEOM_SPHERE), _MESHES[0])
_FLAT_M = 1e-5


@dataclass(frozen=True)
class ArmFile:
    """An arm from an MJCF or URDF file.

    Parameters
    ----------
    path
        Path of the file.
    base
        Name of the body to place at the robot's base, with its orientation from the file; None for the world's child
        that carries the arm.
    flange
        Name of the site or body where a hand is mounted; None for the one that `halfseen.cell.chain` finds. Bodies
        attached to it are dropped, as is its own shape if it is a body fixed to the last link.
    joints
        Names of its hinges, from the base on; other joints are fixed as in the file. None for all joints up to the
        flange, or to where the arm branches into fingers.
    speed_rad_s
        Largest speed, one for all joints or one for each [rad/s].
    flange_from_hand
        Pose of the hand in the flange: z points out of the arm, y is the closing axis.

    Raises
    ------
    SceneError
        The file cannot be read, lacks a given name, or has no arm that can orient a hand; or a speed is not positive.
    """

    path: str | Path
    base: str | None = None
    flange: str | None = None
    joints: tuple[str, ...] | None = None
    speed_rad_s: float | tuple[float, ...] = 1.0
    flange_from_hand: Pose = Pose((0.0, 0.0, 0.0))  # noqa: RUF009 - frozen

    def __post_init__(self) -> None:
        speeds = np.atleast_1d(self.speed_rad_s)
        if not all(0 < speed < np.inf for speed in speeds):
            raise SceneError(f"{self.name}: speed_rad_s is {self.speed_rad_s}; give a positive number")
        if len(speeds) not in (1, self.num_joints):
            raise SceneError(
                f"{self.name}: the arm has {self.num_joints} joints and {len(speeds)} speeds; give one, or one for each"
            )

    @property
    def name(self) -> str:
        """Path of the file."""
        return str(self.path)

    @property
    def num_joints(self) -> int:
        """Number of joints."""
        return len(self._chain.joints)

    @property
    def digest(self) -> str:
        """Hash of the arm as built, with its meshes; it does not depend on the location of the file."""
        model = self.spec().compile()
        numbers = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
        mujoco.mj_saveModel(model, None, numbers)
        return hashlib.sha256(numbers.tobytes()).hexdigest()[:16]

    @property
    def speeds_rad_s(self) -> Float[np.ndarray, " J"]:
        """Largest speed of each joint [rad/s]."""
        return np.broadcast_to(np.asarray(self.speed_rad_s, dtype=np.float64), self.num_joints).copy()

    @property
    def search_rad(self) -> Float[np.ndarray, "J 2"]:
        """The limits of each joint; if they span more than one turn, one turn about their middle [rad]."""
        model, joints = self._model, list(self._chain.joints)
        limits = np.where(model.jnt_limited[joints, None], model.jnt_range[joints], (-pi, pi))
        middle, half = limits.mean(axis=1), np.minimum(0.5 * np.diff(limits, axis=1)[:, 0], pi)
        return np.stack([middle - half, middle + half], axis=1)

    def spec(self) -> mujoco.MjSpec:
        """Build the arm alone, as `SerialArm` requires."""
        spec, model, chain = mujoco.MjSpec(), self._model, self._chain
        spec.compiler.degree = False
        made = {}
        for body in chain.bodies:
            parent = made.get(model.body_parentid[body]) if made else spec.worldbody
            made[body] = self._add_body(parent, body)
            if body != chain.flange.body or not chain.flange.is_of_hand:
                self._add_shapes(spec, made[body], body)
        for index, joint in enumerate(chain.joints):
            self._add_joint(spec, made[model.jnt_bodyid[joint]], index)
        pose = from_matrix(chain.flange.pose.matrix @ self.flange_from_hand.matrix)
        made[chain.flange.body].add_site(name="flange", pos=list(pose.position_m), quat=list(pose.quaternion))
        return spec

    @cached_property
    def _model(self) -> mujoco.MjModel:
        return _compiled(Path(self.path))

    @cached_property
    def _chain(self) -> Chain:
        return find_chain(self._model, self.name, self.base, self.flange, self.joints)

    @cached_property
    def _carried_kgm2(self) -> Float[np.ndarray, " J"]:
        """Largest inertia that each joint moves over random arm angles, including its armature [kg·m²]."""
        model, joints, data = self._model, list(self._chain.joints), mujoco.MjData(self._model)
        dofs, inertia, largest = model.jnt_dofadr[joints], np.zeros((model.nv, model.nv)), np.zeros(len(joints))
        for angles in np.random.default_rng(0).uniform(*self.search_rad.T, size=(_NUM_DRAWN, len(joints))):
            data.qpos[model.jnt_qposadr[joints]] = angles
            for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_crb):
                stage(model, data)
            mujoco.mj_fullM(model, data, inertia)
            largest = np.maximum(largest, inertia.diagonal()[dofs])
        return largest - model.dof_armature[dofs] + self._armature_kgm2

    @property
    def _armature_kgm2(self) -> Float[np.ndarray, " J"]:
        joints = list(self._chain.joints)
        return np.maximum(_ARMATURE_KGM2, self._model.dof_armature[self._model.jnt_dofadr[joints]])

    def _add_body(self, parent: mujoco.MjsBody, number: int) -> mujoco.MjsBody:
        model, is_base = self._model, number == self._chain.bodies[0]
        position_m = np.zeros(3) if is_base else model.body_pos[number]
        quaternion = _standing(model, number) if is_base else model.body_quat[number]
        body = parent.add_body(name=f"body_{number}", pos=position_m, quat=quaternion, gravcomp=1.0)
        if not number:
            return body
        body.explicitinertial, body.ipos, body.iquat = True, model.body_ipos[number], model.body_iquat[number]
        body.mass, body.inertia = model.body_mass[number], model.body_inertia[number]
        if body.mass < _LEAST_KG:
            body.mass, body.inertia = _LEAST_KG, np.full(3, _LEAST_KGM2)
        return body

    def _add_joint(self, spec: mujoco.MjSpec, body: mujoco.MjsBody, index: int) -> None:
        model, number, name = self._model, self._chain.joints[index], f"joint_{index + 1}"
        hinge = body.add_joint(name=name, axis=model.jnt_axis[number], pos=model.jnt_pos[number])
        hinge.armature, hinge.ref = self._armature_kgm2[index], model.qpos0[model.jnt_qposadr[number]]
        hinge.limited, hinge.range = bool(model.jnt_limited[number]), model.jnt_range[number]
        carried_kgm2 = self._carried_kgm2[index]
        add_servo(spec, name, carried_kgm2 * _RATE_PER_S**2, 2.0 * carried_kgm2 * _RATE_PER_S)

    def _add_shapes(self, spec: mujoco.MjSpec, body: mujoco.MjsBody, number: int) -> None:
        model = self._model
        for geom in _shapes(model, number):
            shape = {"type": model.geom_type[geom], "size": model.geom_size[geom]}
            if model.geom_type[geom] in _MESHES:
                shape = {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": _add_mesh(spec, model, geom)}
            body.add_geom(pos=model.geom_pos[geom], quat=model.geom_quat[geom], mass=0.0, **shape, **ROBOT)


def _compiled(path: Path) -> mujoco.MjModel:
    if not path.is_file():
        raise SceneError(f"{path}: no such file; give the path of an arm's MJCF file")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        # Bodies must keep their names, and a link may have only visual shapes.
        spec.compiler.fusestatic = spec.compiler.discardvisual = False
        return spec.compile()
    except ValueError as error:
        raise SceneError(
            f"{path}: MuJoCo cannot read it: {' '.join(str(error).split())}; give an arm's MJCF file, with its "
            "meshes and textures at the paths it names"
        ) from error


def _standing(model: mujoco.MjModel, body: int) -> Float[np.ndarray, " 4"]:
    """Orientation of a body in the file's world, as a unit quaternion."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data.xquat[body]


def _shapes(model: mujoco.MjModel, body: int) -> list[int]:
    """Collision shapes of a body, or all its solid shapes if it has none; nothing for the world body."""
    begin = model.body_geomadr[body]
    solid = [geom for geom in range(begin, begin + model.body_geomnum[body]) if _is_solid(model, geom)]
    touching = [geom for geom in solid if model.geom_contype[geom] or model.geom_conaffinity[geom]]
    return (touching or solid) if body else []


def _is_solid(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a shape can collide; a flat mesh, such as a label, has no convex hull."""
    if model.geom_type[geom] not in _MESHES:
        return model.geom_type[geom] in _SOLID
    return bool((np.ptp(mesh_of(model, int(model.geom_dataid[geom]))[0], axis=0) > _FLAT_M).all())


def _add_mesh(spec: mujoco.MjSpec, model: mujoco.MjModel, geom: int) -> str:
    """Add a shape's mesh once and return its name."""
    number = int(model.geom_dataid[geom])
    name = f"mesh_{number}"
    if spec.mesh(name) is None:
        mesh = add_mesh(spec, name, *mesh_of(model, number))
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    return name
