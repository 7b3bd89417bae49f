"""The robots at a table (base, reach, speed), and the layout of scenes before them.

A team can be read from a TOML or JSON file::

    clearance_m = 0.12          # optional, like all other keys except base_m and reach_m
    reward_per_s = -0.05

    [[robot]]
    name = "left"
    base_m = [-0.5, 0.0]
    reach_m = 0.7
    speed = 1.0
    drop_out_rate = 0.001
    law = "assumed"             # name of its law of grasping, resolved by `read_team`; default: the world's law
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError, HalfseenWarning, SceneError, did_you_mean, within
from halfseen.reading import json_of, read_text, toml_of
from halfseen.world.config import WorldConfig, check_number, is_finite, is_number
from halfseen.world.grasping import GraspingByRobot, GraspLaw, check_law
from halfseen.world.scene import Scene
from halfseen.world.state import Layout, Workspace, pad_scenes, padded

CLEARANCE_M = 0.12
"""Distance below which two objects are too near for two robots at once: two open grippers side by side [m]."""


@dataclass(frozen=True)
class Robot:
    """One robot at the table.

    Parameters
    ----------
    base_m
        Position of its base, (x, y), in the frame of `Scene.places_m`: right of the camera's foot, and away from it
        [m].
    reach_m
        Largest distance from the base at which it can grasp [m].
    speed
        Relative speed: all durations of the world are divided by it.
    name
        Its name in messages.
    drop_out_rate
        Hazard that it drops out (battery, e-stop), by the table's clock [1/s].
    grasping
        Law of its attempts; None for the law of the world.

    Raises
    ------
    ArgumentError
        `base_m` is not two finite numbers, `name` is not a text, `grasping` is not a law, another number is not finite,
        reach or speed is not positive, or the hazard is negative.
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


def check_robot(given: Mapping[str, Any]) -> None:
    """Check the parameters of a `Robot`.

    Those with a default may be missing, except the name.

    Raises
    ------
    ArgumentError
        A parameter is invalid; see `Robot`.
    """
    base, name = given["base_m"], given["name"]
    if not (isinstance(name, str) and name.strip()):
        raise ArgumentError(f"the robot at {base!r}: name is {name!r}; give a string")
    is_pair = isinstance(base, list | tuple | np.ndarray) and len(base) == 2
    if not (is_pair and all(is_number(each) and is_finite(each) for each in base)):
        raise ArgumentError(f"{name}: base_m is {base!r}; give two finite numbers, x and y [m]")
    for parameter, value in given.items():
        check_number(parameter, value, f"{name}: {parameter}")
    if given.get("grasping") is not None:
        check_law(given["grasping"], f"{name}: grasping")


@dataclass(frozen=True)
class Team:
    """One robot or several at one table.

    Parameters
    ----------
    robots
        The robots, robot 0 first.
    clearance_m
        Distance below which two objects are too near for two robots at once [m].
    reward_per_s
        Price of each second of the table's clock; 0 or below [1/s].

    Raises
    ------
    ArgumentError
        There is no robot, an entry is not a `Robot`, or a number is out of range.
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
        check_number("clearance_m", self.clearance_m)
        check_number("reward_per_s", self.reward_per_s)

    def config(self, world: WorldConfig) -> WorldConfig:
        """Set this team's parameters in a world, with a law of grasping for each robot if any has its own."""
        rates = tuple(robot.drop_out_rate for robot in self.robots)
        laws = tuple(world.grasping if robot.grasping is None else robot.grasping for robot in self.robots)
        has_own = any(robot.grasping is not None for robot in self.robots)
        return replace(
            world,
            grasping=GraspingByRobot(laws) if has_own else world.grasping,
            speed=tuple(robot.speed for robot in self.robots),
            reward_per_s=self.reward_per_s,
            drop_out_rate=rates if any(rates) else None,
        )

    def workspace(self, scene: Scene) -> Workspace:
        """Find the objects that each robot reaches, and the pairs of objects too near for two robots at once.

        An object in no robot's reach raises a warning, because it will be left.

        Raises
        ------
        SceneError
            The scene lacks the places of its objects.
        """
        if scene.places_m is None:
            raise SceneError(f"{scene.name}: places_m is None, so reach cannot be computed; give each object a place")
        bases_m = np.array([robot.base_m for robot in self.robots], dtype=np.float64)
        reach_m = np.array([[robot.reach_m] for robot in self.robots], dtype=np.float64)
        is_in_reach = np.linalg.norm(scene.places_m - bases_m[:, None], axis=-1) <= reach_m
        for k in np.flatnonzero(~is_in_reach.any(axis=0)):
            x, y = scene.places_m[k]
            message = (
                f"{scene.name}: object {k} at ({x:.3g}, {y:.3g}) m is out of every robot's reach, so it counts as left"
            )
            warnings.warn(f"{message}; move a base, or leave it out", HalfseenWarning, stacklevel=2)
        apart_m = np.linalg.norm(scene.places_m[:, None] - scene.places_m, axis=-1)
        return Workspace(is_in_reach, (apart_m < self.clearance_m) | np.eye(scene.num_objects, dtype=bool))

    def layouts(self, scenes: Sequence[Scene], num_objects: int | None = None) -> Layout:
        """Lay out scenes before the team, padded to a common number of objects.

        Raises
        ------
        SceneError
            There is no scene; or one has no object, more than `num_objects`, or no places.
        """
        tables, spaces = pad_scenes(scenes, num_objects), [self.workspace(scene) for scene in scenes]
        size = tables.is_object.shape[-1]
        is_in_reach = padded([space.is_in_reach for space in spaces], (len(self.robots), size), False)
        is_near = padded([space.is_near for space in spaces], (size, size), False)
        return replace(tables, workspace=Workspace(is_in_reach, is_near))


_OF_ROBOT = (*(field.name for field in fields(Robot) if field.name != "grasping"), "law")
_OF_TEAM = ("clearance_m", "reward_per_s")


def read_team(path: str | Path, law_of: Callable[[str], GraspLaw] | None = None) -> Team:
    """Read the robots of a team.

    Parameters
    ----------
    path
        A TOML file, or a JSON file with the same keys and the suffix .json.
    law_of
        Maps a name to a law of grasping, for robots with a `law`; None if no robot has one. On the command line a name
        is a value of `--law`, and a folder is looked up next to the file.

    Raises
    ------
    ArgumentError
        The file cannot be read, a key is unknown or missing, a value is invalid, or two robots have the same name.
    """
    with within(path):
        given = _parsed(Path(path))
        _check_keys("", given, ("robot", *_OF_TEAM))
        each = given.get("robot")
        if not (isinstance(each, list) and each and all(isinstance(one, Mapping) for one in each)):
            raise ArgumentError("no robots; give each robot a [[robot]] table with base_m and reach_m")
        of_team = {name: given[name] for name in _OF_TEAM if name in given}
        for name, value in of_team.items():
            check_number(name, value)
        robots = tuple(_robot(f"robot {k}", one, law_of) for k, one in enumerate(each))
        names = [robot.name for robot in robots]
        for name in names:
            if names.count(name) > 1:
                raise ArgumentError(f"two robots are called {name!r}; give each a name of its own")
        return Team(robots, **of_team)


def _parsed(path: Path) -> Mapping[str, Any]:
    try:
        given = (json_of if path.suffix.lower() == ".json" else toml_of)(read_text(path))
    except OSError as error:
        raise ArgumentError(f"cannot be read ({error.strerror}); give a TOML or JSON file of robots") from error
    except ValueError as error:
        raise ArgumentError(f"is not TOML or JSON ({error}); fix it there") from error
    if not isinstance(given, Mapping):
        raise ArgumentError(f"holds {type(given).__name__}, not keys; write it as `halfseen.world.robots` shows")
    return given


def _check_keys(where: str, given: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for key in given:
        if key not in known:
            raise ArgumentError(f"{where}unknown key {key!r}; give one of {', '.join(known)}{did_you_mean(key, known)}")


def _robot(where: str, given: Mapping[str, Any], law_of: Callable[[str], GraspLaw] | None) -> Robot:
    _check_keys(f"{where}: ", given, _OF_ROBOT)
    for key in ("base_m", "reach_m"):
        if key not in given:
            raise ArgumentError(f"{where}: {key} is missing; give it in metres")
    parameters = {"name": where, **given}
    law = parameters.pop("law", None)
    check_robot(parameters)
    if law is None:
        return Robot(**parameters)
    if not isinstance(law, str):
        raise ArgumentError(f"{where}: law is {law!r}; give the name of a law of grasping")
    if law_of is None:
        raise ArgumentError(f"{where}: law is {law!r}, but there is no law_of to look it up; give one")
    with within(f"{where}: law"):
        return Robot(**parameters, grasping=law_of(law))
