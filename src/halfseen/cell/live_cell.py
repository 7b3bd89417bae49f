"""The running cell: commands to robots, the physics that advances with them, and the conditions that stop it.

An `Activity` is a generator of robot commands. It reads the cell before each command and receives whether the last one
was executed. Every command but `Reserve` always is.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import hypot
from typing import TypeAlias, TypeVar

import mujoco
import numpy as np

from halfseen.cell.kinematics import Angles, Kinematics, Way, schedule
from halfseen.cell.model import MountedArm
from halfseen.scene.poses import Pose, pose_of
from halfseen.scene.view import cup_name
from halfseen.shapes import Float

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Move:
    """Move along a path, from rest to rest, at a fraction of the joints' maximum speeds."""

    way: Way
    speed: float = 1.0


@dataclass(frozen=True)
class Grip:
    """Open or close the hand: opening between the pads [m], negative to press, and duration [s]."""

    opening_m: float
    seconds: float = 0.5


@dataclass(frozen=True)
class Rest:
    """Wait [s]."""

    seconds: float


@dataclass(frozen=True, eq=False)
class Reserve:
    """Reserve the space of a path before moving along it; a single robot gets it at once.

    `way` holds the joint angles of all moves until the next reservation. `below_m` is how far the held object reaches
    below the hand [m]. `back` is the way home, if there is one. If the robot has to give way, that is reserved instead
    and the answer is False. A request with `is_patient` False does not wait.
    """

    way: Float[np.ndarray, "going J"]
    back: Float[np.ndarray, "returning _"] = field(default_factory=lambda: np.zeros((0, 0)))
    is_patient: bool = True
    below_m: float = 0.0


Command: TypeAlias = Move | Grip | Rest | Reserve
Activity: TypeAlias = Generator[Command, bool, Result]
"""A generator of a robot's commands that returns their result."""


NUM_STEPS = 5  # physics steps per servo command: a hundredth of a second
Watch = Callable[["LiveCell"], None]
"""Called once per servo command; an exception from it ends the motion, as an emergency stop does."""


class LiveCell:
    """A running cell; initially robots are at home with hands half open.

    Parameters
    ----------
    model
        Model from `cell_model`.
    robots
        The robots in it.

    Attributes
    ----------
    num_cups
        Number of cups.
    watches
        Functions called once per servo command.
    """

    def __init__(self, model: mujoco.MjModel, robots: Sequence[MountedArm]) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self.watches: list[Watch] = []
        # The cups are the first bodies of the model.
        self.num_cups = sum(model.body(index + 1).name == cup_name(index) for index in range(model.nbody - 1))
        self.kinematics = {robot.name: Kinematics(model, robot) for robot in robots}
        for robot in robots:
            half_open_m = 0.25 * robot.gripper.stroke_m
            parts = [*zip(robot.joint_names, robot.home_rad, strict=True)]
            for name, place in [*parts, *((name, half_open_m) for name in robot.slide_names)]:
                self.data.joint(name).qpos = self.data.actuator(name).ctrl = place
        mujoco.mj_forward(model, self.data)

    @property
    def tick_s(self) -> float:
        """Time between two servo commands [s]."""
        return NUM_STEPS * self.model.opt.timestep

    @property
    def time_s(self) -> float:
        """The cell's clock [s]."""
        return float(self.data.time)

    def angles_rad(self, robot: MountedArm) -> Angles:
        """Joint angles of a robot [rad]."""
        return np.array([self.data.joint(name).qpos[0] for name in robot.joint_names])

    def opening_m(self, robot: MountedArm) -> float:
        """Opening between a robot's pads [m]."""
        return float(sum(self.data.joint(name).qpos[0] for name in robot.slide_names))

    def cup(self, index: int) -> Pose:
        """Pose of a cup in the world."""
        body = self.data.body(cup_name(index))
        return pose_of(body.xpos, body.xquat / np.linalg.norm(body.xquat))

    def wait(self, seconds: float) -> None:
        """Advance the physics."""
        num_left = round(seconds / self.model.opt.timestep)
        while num_left > 0:
            num_steps = min(NUM_STEPS, num_left)
            mujoco.mj_step(self.model, self.data, num_steps)
            num_left -= num_steps
            for watch in self.watches:
                watch(self)

    def carry_out(self, robot: MountedArm, activity: Activity[Result]) -> Result:
        """Execute one robot's activity while all others stand still; every reservation is granted."""
        try:
            command = next(activity)
            while True:
                self.do(robot, command)
                command = activity.send(True)
        except StopIteration as ended:
            return ended.value

    def do(self, robot: MountedArm, command: Command) -> None:
        """Execute one robot's command while all others stand still."""
        match command:
            case Move():
                for _ in self.moved(robot, command):
                    self.wait(self.tick_s)
            case Grip():
                self.close(robot, command.opening_m)
                self.wait(command.seconds)
            case Rest():
                self.wait(command.seconds)

    def moved(self, robot: MountedArm, move: Move) -> Iterator[Angles]:
        """Steer a robot along a path from its current set points, and yield its servos' angles at each tick [rad]."""
        servos = [self.model.actuator(name).id for name in robot.joint_names]
        plan = schedule(self.data.ctrl[servos], move.way, move.speed * robot.arm.speeds_rad_s)
        for angles in plan.at(self.tick_s * np.arange(1, np.ceil(plan.duration_s / self.tick_s) + 1)):
            self.data.ctrl[servos] = angles
            yield angles
        self.data.ctrl[servos] = move.way[-1]

    def close(self, robot: MountedArm, opening_m: float) -> None:
        """Set the target opening of the fingers [m], within their force limit; negative values press."""
        for name in robot.slide_names:
            self.data.actuator(name).ctrl = 0.5 * opening_m


TIME_OUT, EMERGENCY_STOP, SENSOR_LOST = "time-out", "emergency-stop", "sensor-lost"


class StoppedError(Exception):
    """The cell was stopped; its argument is the cause."""


@dataclass(frozen=True)
class Stops:
    """Conditions that stop the cell.

    Parameters
    ----------
    limit_s
        Longest duration of an attempt, until its outcome is known [s].
    force_n
        Largest contact force on a robot [N].
    camera_lost_per_s
        Rate of camera failures [1/s].
    """

    limit_s: float = 9.5
    force_n: float = 100.0
    camera_lost_per_s: float = 1 / 400


class Guard:
    """Watches a running cell and stops it; `rng` draws the time of the camera failure after `now_s` [s]."""

    def __init__(self, stops: Stops, now_s: float, rng: np.random.Generator) -> None:
        self.stops = stops
        self._begun_s: list[float] = []
        self._lost_s = now_s + float(rng.exponential()) / stops.camera_lost_per_s if stops.camera_lost_per_s else np.inf

    @contextmanager
    def timing(self, begun_s: float) -> Iterator[None]:
        """Time an attempt that began at `begun_s` [s]; several robots may be timed at once."""
        self._begun_s.append(begun_s)
        yield
        self._begun_s.remove(begun_s)

    def __call__(self, cell: LiveCell) -> None:
        """Stop the cell if a condition is met.

        Raises
        ------
        StoppedError
            A condition is met; the argument is the cause.
        """
        if cell.time_s > self._lost_s:
            raise StoppedError(SENSOR_LOST)
        if any(cell.time_s - begun_s > self.stops.limit_s for begun_s in self._begun_s):
            raise StoppedError(TIME_OUT)
        if largest_force_n(cell) > self.stops.force_n:
            raise StoppedError(EMERGENCY_STOP)


def largest_force_n(cell: LiveCell) -> float:
    """Largest contact force of a robot with a cup, furniture, or another robot [N]."""
    model, data = cell.model, cell.data
    if not data.ncon:
        return 0.0
    first, second = (model.geom_bodyid[data.contact.geom] > cell.num_cups).T
    force, largest = np.zeros(6), 0.0
    for contact in np.flatnonzero(first | second).tolist():
        mujoco.mj_contactForce(model, data, contact, force)
        largest = max(largest, hypot(*force[:3].tolist()))
    return largest
