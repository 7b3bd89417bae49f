"""The cell as one MuJoCo model: the room with its cups, racks beside the table, and one or several arms."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, inf, pi, sin
from typing import Any, NamedTuple

import mujoco
import numpy as np

from halfseen.cell.arm import JACO_2, SerialArm
from halfseen.cell.gripper import FIRST_ROBOT, FURNITURE, OBSTACLES, Contacts, Gripper, add_walls
from halfseen.errors import SceneError
from halfseen.scene.cups import Cup
from halfseen.scene.poses import Pose
from halfseen.scene.rays import FURNITURE_GROUP
from halfseen.scene.view import cup_name, room_spec
from halfseen.shapes import Float

SLOT_M = 0.13  # side length of a cup's slot in the rack
_RACK_DEPTH_M = 0.2
_BOX = mujoco.mjtGeom.mjGEOM_BOX


@dataclass(frozen=True)
class MountedArm:
    """An arm with a gripper, and its placement.

    Parameters
    ----------
    name
        Unique name of the robot and prefix of the names of its parts.
    base_m
        Position of the arm's base [m].
    turn_rad
        Rotation of the base about the vertical [rad].
    arm, gripper
        Its arm and gripper.
    home_rad
        Joint angles at home, behind the table [rad]; `robot_of` finds those of another arm.

    Raises
    ------
    SceneError
        The number of home angles differs from the number of joints.
    """

    name: str = "arm"
    base_m: tuple[float, float, float] = (0.0, 0.42, 0.56)
    turn_rad: float = pi
    arm: SerialArm = JACO_2
    gripper: Gripper = Gripper()  # noqa: RUF009 - frozen
    home_rad: tuple[float, ...] = (-2.589, 3.486, 1.786, -2.610, -1.733, -0.487)

    def __post_init__(self) -> None:
        if len(self.home_rad) != self.arm.num_joints:
            raise SceneError(
                f"robot {self.name!r}: home_rad has {len(self.home_rad)} angles and its arm has "
                f"{self.arm.num_joints} joints; give one angle for every joint, or let `robot_of` find them"
            )

    def of(self, part: str) -> str:
        """Name of a part in the model."""
        return f"{self.name}/{part}"

    def bodies(self, model: mujoco.MjModel) -> list[int]:
        """Numbers of its bodies in the model of a cell."""
        return [body for body in range(model.nbody) if model.body(body).name.startswith(self.of(""))]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the arm's joints and of their servos, from the base on."""
        return tuple(self.of(f"joint_{index + 1}") for index in range(self.arm.num_joints))

    @property
    def slide_names(self) -> tuple[str, ...]:
        """Names of the fingers' joints and of their servos."""
        return (self.of("gripper/slide_left"), self.of("gripper/slide_right"))


@dataclass(frozen=True)
class Rack:
    """The rack for washed cups: a low open box.

    Parameters
    ----------
    middle_m
        Middle of its floor [m].
    size_m
        Size along x and y, and height of its rim [m].
    """

    middle_m: tuple[float, float, float] = (0.42, 0.63, 0.55)
    size_m: tuple[float, float, float] = (0.40, 0.53, 0.06)

    @property
    def slots_m(self) -> Float[np.ndarray, "n 3"]:
        """Middles of the slots on its floor, the farthest from the table first [m]."""
        x_m, y_m, z_m = self.middle_m
        columns, rows = (int(size // SLOT_M) for size in self.size_m[:2])
        along_x = x_m + self.size_m[0] / columns * (np.arange(columns) - 0.5 * (columns - 1))
        along_y = y_m + self.size_m[1] / rows * (np.arange(rows) - 0.5 * (rows - 1))
        return np.array([[x, y, z_m] for y in along_y[::-1] for x in along_x[::-1]])

    def holds(self, point_m: Float[np.ndarray, " 3"]) -> bool:
        """Whether a point is in the rack."""
        away_m = np.abs(point_m - self.middle_m)
        return bool((away_m[:2] < 0.5 * np.array(self.size_m[:2])).all() and away_m[2] < _RACK_DEPTH_M)


class Station(NamedTuple):
    """A robot, its own rack, and the largest distance from its base at which it is asked to grasp [m]."""

    robot: MountedArm = MountedArm()
    rack: Rack = Rack()
    reach_m: float = inf


def cell_model(
    cups: Sequence[Cup],
    world_from_cup: Sequence[Pose],
    robots: Sequence[MountedArm] = (MountedArm(),),
    racks: Sequence[Rack] = (Rack(),),
    contacts: Contacts = Contacts(),  # noqa: B008 - frozen
    frictions: Sequence[float] | None = None,
    paint: Callable[[mujoco.MjSpec], None] = lambda _: None,
) -> mujoco.MjModel:
    """Compile the cell.

    Parameters
    ----------
    cups, world_from_cup
        The cups, and the pose of each.
    robots
        The robots; none for a room that is only viewed.
    racks
        The racks for washed cups.
    frictions
        Friction of each cup on the pads [-]; None for that of `contacts`.
    paint
        Changes the looks before the model is compiled.

    Raises
    ------
    SceneError
        Two robots have the same name, or the number of poses or given frictions differs from that of cups.
    """
    _check(cups, world_from_cup, robots, frictions)
    spec = room_spec(cups, world_from_cup, is_free=True)
    contacts.solve(spec)
    for index, cup in enumerate(cups):
        add_walls(spec.body(cup_name(index)), cup, contacts, None if frictions is None else frictions[index])
    for rack in racks:
        _add_rack(spec, rack)
    for geom in spec.worldbody.geoms:
        geom.contype |= OBSTACLES
        geom.group = FURNITURE_GROUP
    for robot in robots:
        _add_robot(spec, robot, contacts)
    if len(robots) > 1:
        _let_robots_meet(spec, robots)
    paint(spec)
    return spec.compile()


def _let_robots_meet(spec: mujoco.MjSpec, robots: Sequence[MountedArm]) -> None:
    """Let parts of each robot collide with those of every other, but not with its own."""
    for number, robot in enumerate(robots):
        own = FIRST_ROBOT << number
        others = sum(FIRST_ROBOT << other for other in range(len(robots)) if other != number)
        for body in spec.bodies:
            if body.name.startswith(robot.of("")):
                for geom in body.geoms:
                    geom.contype |= own
                    geom.conaffinity |= others


def _check(
    cups: Sequence[Cup], world_from_cup: Sequence[Pose], robots: Sequence[MountedArm], frictions: Sequence[float] | None
) -> None:
    for what, given in (("poses", world_from_cup), ("frictions", cups if frictions is None else frictions)):
        if len(given) != len(cups):
            raise SceneError(f"the cell has {len(cups)} cups and {len(given)} {what}; give one for every cup")
    names = [robot.name for robot in robots]
    for name in names:
        if names.count(name) > 1:
            raise SceneError(f"{names.count(name)} robots are called {name!r}; give each a name of its own")


def _add_robot(spec: mujoco.MjSpec, robot: MountedArm, contacts: Contacts) -> None:
    arm = robot.arm.spec()
    arm.attach(robot.gripper.spec(contacts), site=arm.site("flange"), prefix="gripper/")
    turn = [cos(0.5 * robot.turn_rad), 0, 0, sin(0.5 * robot.turn_rad)]
    spec.attach(arm, frame=spec.worldbody.add_frame(pos=list(robot.base_m), quat=turn), prefix=robot.of(""))
    x_m, y_m, z_m = robot.base_m
    spec.worldbody.add_geom(
        name=robot.of("pedestal"),
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=[x_m, y_m, 0.5 * z_m],
        size=[0.05, 0.5 * z_m, 0],
        contype=0,
        conaffinity=0,
        group=FURNITURE_GROUP,
    )


def _add_rack(spec: mujoco.MjSpec, rack: Rack) -> None:
    x_m, y_m, z_m = rack.middle_m
    half_x_m, half_y_m, half_m = (0.5 * size for size in rack.size_m)
    look: dict[str, Any] = {
        "contype": FURNITURE,
        "conaffinity": FURNITURE,
        "condim": 6,
        "friction": [0.8, 0.01, 0.005],
        "solref": [0.006, 1.0],
    }
    world = spec.worldbody
    world.add_geom(type=_BOX, pos=[x_m, y_m, z_m - 0.005], size=[half_x_m, half_y_m, 0.005], **look)
    for sign in (-1, 1):
        along_x, along_y = [x_m + sign * half_x_m, y_m, z_m + half_m], [x_m, y_m + sign * half_y_m, z_m + half_m]
        world.add_geom(type=_BOX, pos=along_x, size=[0.003, half_y_m, half_m], **look)
        world.add_geom(type=_BOX, pos=along_y, size=[half_x_m, 0.003, half_m], **look)


_BASE_M, _RACK_M, _RACK_SIZE_M = (0.55, 0.05, 0.68), (0.45, 0.56, 0.55), (0.40, 0.40, 0.06)
_REACH_M = 0.68  # farthest distance at which the arm can descend from above and lift straight up
_RIGHT_HOME_RAD = (-1.622, 3.547, 1.463, -2.797, -1.244, 1.864)
_LEFT_HOME_RAD = (-1.520, 2.736, 4.820, 2.797, 1.244, -1.864)


def _station(name: str, side: float, home_rad: tuple[float, ...]) -> Station:
    (x_m, *base_m), (rack_x_m, *rack_m) = _BASE_M, _RACK_M
    turn_rad = 0.0 if side < 0 else np.pi
    robot = MountedArm(name, (side * x_m, base_m[0], base_m[1]), float(turn_rad), home_rad=home_rad)
    return Station(robot, Rack((side * rack_x_m, rack_m[0], rack_m[1]), _RACK_SIZE_M), _REACH_M)


PAIR = (_station("left", -1.0, _LEFT_HOME_RAD), _station("right", 1.0, _RIGHT_HOME_RAD))
"""Two mirrored arms at the two ends of the table, left and right in the camera's view.

The camera looks along the table's short side, so neither arm occludes the table. Each arm waits over its own rack, out
of the other's way, and reaches slightly more than its own half of the table.
"""
