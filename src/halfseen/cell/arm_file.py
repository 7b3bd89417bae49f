"""An arm from a user's MJCF file: its links and hinges as they are there, moved by servos of ours.

The file is compiled as it stands, and from what came out the arm is built again: bodies with their inertia, hinges, and
shapes that can be touched. Nothing else comes along: not its hand, other robots, what stands about, keyframes, motors,
sensors, equalities or tendons. So it fits into any cell, from any folder. Nothing in it is run or downloaded.
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
from halfseen.cell.gripper import ROBOT
from halfseen.errors import SceneError
from halfseen.scene.poses import Pose, from_matrix
from halfseen.shapes import Float

_ARMATURE_KGM2 = 0.2  # at least, behind a gear: a light wrist must hold a cup
_RATE_PER_S = 70.0  # at which servos follow: that of the arm that the cell's values were found with
_NUM_DRAWN = 64
_LEAST_KG, _LEAST_KGM2 = 1e-3, 1e-6  # what turns must weigh something, once its hand is taken off
_MESHES = (int(mujoco.mjtGeom.mjGEOM_MESH), int(mujoco.mjtGeom.mjGEOM_SDF))
_SOLID = range(int(mujoco.mjtGeom.mjGEOM_SPHERE), _MESHES[0])
_FLAT_M = 1e-5


@dataclass(frozen=True)
class ArmFile:
    """An arm of an MJCF file, or a URDF file.

    Parameters
    ----------
    path
        Of the file.
    base
        Name of the body that stands where the robot's base is, turned as it is in the file; None for the body of the
        world that carries the arm.
    flange
        Name of the site or body where a hand is mounted; None for the one that `halfseen.cell.chain` finds. What hangs
        on it is left out; so is its own shape where it is a body fixed to the last link.
    joints
        Names of its hinges, from the base on; others stay as they are in the file. None for all up to the flange, or to
        where the arm forks into fingers.
    speed_rad_s
        Largest speed of every joint, or of each [rad/s].
    flange_from_hand
        How the hand is mounted: its z points out of the arm, y is the closing axis.

    Raises
    ------
    SceneError
        The file cannot be read, has no such names, or holds no arm that could point a hand; or a speed is not positive.
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
        """The file."""
        return str(self.path)

    @property
    def num_joints(self) -> int:
        """Number of joints."""
        return len(self._chain.joints)

    @property
    def digest(self) -> str:
        """Of the arm as it is built, with its meshes: another arm has another, wherever its file lies."""
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
        """The limits of each joint, or one turn about their middle where they are farther apart [rad]."""
        model, joints = self._model, list(self._chain.joints)
        limits = np.where(model.jnt_limited[joints, None], model.jnt_range[joints], (-pi, pi))
        middle, half = limits.mean(axis=1), np.minimum(0.5 * np.diff(limits, axis=1)[:, 0], pi)
        return np.stack([middle - half, middle + half], axis=1)

    def spec(self) -> mujoco.MjSpec:
        """Build the arm alone, as `SerialArm` asks for."""
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
        """What each joint turns, with the inertia behind its gear: the largest of many angles of the arm."""
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
        servo, carried_kgm2 = spec.add_actuator(name=name, target=name), self._carried_kgm2[index]
        servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
        servo.set_to_position(kp=carried_kgm2 * _RATE_PER_S**2, kv=2.0 * carried_kgm2 * _RATE_PER_S)

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
        # Bodies keep their names, and shapes that are only seen may be all that a link has.
        spec.compiler.fusestatic = spec.compiler.discardvisual = False
        return spec.compile()
    except ValueError as error:
        raise SceneError(
            f"{path}: MuJoCo cannot read it: {' '.join(str(error).split())}; give an arm's MJCF file, with meshes and "
            "textures where it says"
        ) from error


def _standing(model: mujoco.MjModel, body: int) -> Float[np.ndarray, " 4"]:
    """How a body is turned in the file's world: a unit quaternion."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data.xquat[body]


def _shapes(model: mujoco.MjModel, body: int) -> list[int]:
    """Shapes of a body that touch others, or all if none does; none of the world, which is no part of an arm."""
    begin = model.body_geomadr[body]
    solid = [geom for geom in range(begin, begin + model.body_geomnum[body]) if _is_solid(model, geom)]
    touching = [geom for geom in solid if model.geom_contype[geom] or model.geom_conaffinity[geom]]
    return (touching or solid) if body else []


def _is_solid(model: mujoco.MjModel, geom: int) -> bool:
    """Whether it can be touched: not a mesh as flat as a label, which has no hull."""
    if model.geom_type[geom] not in _MESHES:
        return model.geom_type[geom] in _SOLID
    # A compiled mesh lies along its principal axes.
    return bool((np.ptp(_vertices_m(model, int(model.geom_dataid[geom])), axis=0) > _FLAT_M).all())


def _vertices_m(model: mujoco.MjModel, mesh: int) -> Float[np.ndarray, "vertices 3"]:
    return model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]


def _add_mesh(spec: mujoco.MjSpec, model: mujoco.MjModel, geom: int) -> str:
    """Add a shape's mesh, once; its name."""
    number = int(model.geom_dataid[geom])
    name = f"mesh_{number}"
    if spec.mesh(name) is None:
        faces = model.mesh_face[model.mesh_faceadr[number] :][: model.mesh_facenum[number]]
        mesh = spec.add_mesh(
            name=name, uservert=_vertices_m(model, number).ravel().tolist(), userface=faces.ravel().tolist()
        )
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    return name
