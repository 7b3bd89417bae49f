"""The robots at a table: where each stands, how far it reaches, how fast it works; and how scenes stand before them."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from halfseen.errors import ArgumentError, HalfseenWarning, SceneError
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import GraspingByRobot, GraspLaw, check_law
from halfseen.world.number import is_finite, is_number, is_wrong
from halfseen.world.scene import Scene
from halfseen.world.state import Layout, Workspace, pad_scenes

CLEARANCE_M = 0.12
"""Distance below which two objects are too near for two robots at once [m]: two open grippers side by side."""


@dataclass(frozen=True)
class Robot:
    """One robot at the table.

    Parameters
    ----------
    base_m
        Where it stands, (x, y), in the frame of `Scene.places_m`: right of the camera's foot, and away from it [m].
    reach_m
        How far from there it can grasp [m].
    speed
        What takes the law of the world so many seconds takes it that, divided by its speed.
    name
        What it is called in messages.
    drop_out_rate
        Hazard that it drops out (battery, e-stop), by the table's clock [1/s].
    grasping
        How its attempts go; None for the law of the world.

    Raises
    ------
    ArgumentError
        `base_m` is not two finite numbers, `name` no text, `grasping` no law, or another is no finite number, reach or
        speed not above 0, or the hazard below it.
    """

    base_m: Sequence[float | int]
    reach_m: float | int
    speed: float | int = 1.0
    name: str = "robot"
    drop_out_rate: float | int = 0.0
    grasping: GraspLaw | None = None

    def __post_init__(self) -> None:
        check_robot(vars(self))
        object.__setattr__(self, "base_m", tuple(map(float, self.base_m)))


_NUMBERS: Mapping[str, tuple[Callable[[float], bool], str]] = {
    "reach_m": (lambda value: value > 0, "a finite number above 0 [m]"),
    "speed": (lambda value: value > 0, "a finite number above 0"),
    "drop_out_rate": (lambda value: value >= 0, "a finite hazard, 0 or above [1/s]"),
    "clearance_m": (lambda value: value >= 0, "a finite distance, 0 or above [m]"),
    "reward_per_s": (lambda value: value <= 0, "a finite price, 0 or below [1/s]"),
}
"""What the numbers of a robot and of a team can be, and what to give where they are not."""


def check_robot(told: Mapping[str, Any]) -> None:
    """Refuse what no robot is: see `Robot`.

    Parameters
    ----------
    told
        Its parameters; those that have a default may be left out, but for the name.

    Raises
    ------
    ArgumentError
        As above.
    """
    base, name = told["base_m"], told["name"]
    if not (isinstance(name, str) and name.strip()):
        raise ArgumentError(f"the robot at {base!r}: name is {name!r}; give a text")
    is_pair = isinstance(base, list | tuple | np.ndarray) and len(base) == 2
    if not (is_pair and all(is_number(each) and is_finite(each) for each in base)):
        raise ArgumentError(f"{name}: base_m is {base!r}; give two finite numbers, x and y [m]")
    check_numbers(told, f"{name}: ")
    if told.get("grasping") is not None:
        check_law(told["grasping"], f"{name}: grasping")


def check_numbers(told: Mapping[str, Any], where: str = "") -> None:
    """Refuse numbers of a robot or a team that are none that they can be.

    Parameters
    ----------
    told
        Them, by name; what is no such number is not looked at.
    where
        What to put before the name in the message.

    Raises
    ------
    ArgumentError
        As above.
    """
    for what, value in told.items():
        is_right, wanted = _NUMBERS.get(what, (None, ""))
        if is_right is not None and (not is_number(value) or is_wrong(value, is_right)):
            raise ArgumentError(f"{where}{what} is {value!r}; give {wanted}")


def workspace_of(
    robots: Sequence[Robot],
    places_m: Float[np.ndarray, "N 2"],
    clearance_m: float | int = CLEARANCE_M,
    name: str = "table",
) -> Workspace:
    """Tell what each robot reaches, and which objects are too near one another for two robots at once.

    An object that nobody reaches is warned of: it will be left.

    Parameters
    ----------
    robots
        The team, robot 0 first.
    places_m
        Where each object stands, (x, y) in the frame of the table [m].
    clearance_m
        Objects nearer than that are too near [m].
    name
        Of the table, for messages.

    Raises
    ------
    ArgumentError
        There is no robot, a place is not finite, or the clearance is below 0.
    """
    if not robots:
        raise ArgumentError("robots is empty: give at least one Robot")
    if not np.isfinite(places_m).all():
        k = int(np.argmin(np.isfinite(places_m).all(axis=1)))
        raise ArgumentError(f"{name}: object {k} stands at {places_m[k]}; give a finite place [m]")
    check_numbers({"clearance_m": clearance_m})
    bases = np.array([robot.base_m for robot in robots], dtype=np.float64)
    reaches = np.array([robot.reach_m for robot in robots], dtype=np.float64)
    is_in_reach = np.linalg.norm(places_m[None] - bases[:, None], axis=-1) <= reaches[:, None]
    for k in np.flatnonzero(~is_in_reach.any(axis=0)):
        x, y = places_m[k]
        message = f"{name}: object {k} at ({x:.3g}, {y:.3g}) m is in no robot's reach, so it counts as left"
        warnings.warn(f"{message}; move a base, or leave it out", HalfseenWarning, stacklevel=2)
    apart_m = np.linalg.norm(places_m[:, None] - places_m[None], axis=-1)
    is_near = (apart_m < clearance_m) | np.eye(len(places_m), dtype=bool)
    return Workspace(is_in_reach, is_near)


@dataclass(frozen=True)
class Team:
    """One robot or several at one table.

    Parameters
    ----------
    robots
        The robots, robot 0 first.
    clearance_m
        Objects nearer than that are too near for two robots at once [m].
    reward_per_s
        Price of each second of the table's clock; 0 or below [1/s].

    Raises
    ------
    ArgumentError
        There is no robot, what is among them is none, or a number is none that it can be.
    """

    robots: tuple[Robot, ...]
    clearance_m: float | int = CLEARANCE_M
    reward_per_s: float | int = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "robots", tuple(self.robots))
        if not self.robots:
            raise ArgumentError("robots is empty: give at least one Robot")
        for k, robot in enumerate(self.robots):
            if not isinstance(robot, Robot):
                raise ArgumentError(f"robots[{k}] is {robot!r}; give a Robot")
        check_numbers(vars(self))

    def config(self, world: WorldConfig) -> WorldConfig:
        """Give the numbers of this team in a world, and there the law of grasping of each robot, if one has its own."""
        rates = tuple(robot.drop_out_rate for robot in self.robots)
        speed = tuple(robot.speed for robot in self.robots)
        laws = [robot.grasping for robot in self.robots]
        if any(law is not None for law in laws):
            own = tuple(world.grasping if law is None else law for law in laws)
            world = replace(world, grasping=GraspingByRobot(own))
        return replace(world, speed=speed, reward_per_s=self.reward_per_s, drop_out_rate=rates if any(rates) else None)

    def layouts(self, scenes: Sequence[Scene], num_objects: int | None = None) -> Layout:
        """Set scenes before the team, padded to a common number of objects.

        Raises
        ------
        SceneError
            There is no scene, one has no object, or more than `num_objects`, or does not tell where they stand.
        """
        tables = pad_scenes(scenes, num_objects)
        size = tables.is_object.shape[-1]
        is_in_reach = np.zeros((len(scenes), len(self.robots), size), dtype=bool)
        is_near = np.zeros((len(scenes), size, size), dtype=bool)
        for k, scene in enumerate(scenes):
            if scene.places_m is None:
                raise SceneError(f"{scene.name}: places_m is None, so nobody knows who reaches what; give each a place")
            found = workspace_of(self.robots, scene.places_m, self.clearance_m, scene.name)
            is_in_reach[k, :, : scene.num_objects] = found.is_in_reach
            is_near[k, : scene.num_objects, : scene.num_objects] = found.is_near
        return replace(tables, workspace=Workspace(is_in_reach, is_near))
