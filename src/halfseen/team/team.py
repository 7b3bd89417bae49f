"""A team: its robots, how near two may work, and what its seconds cost; how scenes stand before it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from halfseen.arrays import on_device
from halfseen.errors import ArgumentError, SceneError
from halfseen.team.config import TeamConfig
from halfseen.team.robots import CLEARANCE_M, Robot, check_numbers, workspace_of
from halfseen.team.state import TeamLayout, Workspace
from halfseen.world.config import WorldConfig
from halfseen.world.grasping_by_robot import GraspingByRobot
from halfseen.world.scene import Scene
from halfseen.world.state import pad_scenes


@dataclass(frozen=True)
class Team:
    """Several robots at one table.

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

    def config(self, world: WorldConfig) -> TeamConfig:
        """Give the numbers of this team in a world, and there the law of grasping of each robot, if one has its own."""
        rates = tuple(robot.drop_out_rate for robot in self.robots)
        speed = tuple(robot.speed for robot in self.robots)
        laws = [robot.grasping for robot in self.robots]
        if any(law is not None for law in laws):
            own = tuple(world.grasping if law is None else law for law in laws)
            world = replace(world, grasping=GraspingByRobot(own))
        return TeamConfig(world, speed, self.reward_per_s, rates if any(rates) else None)

    def layouts(self, scenes: Sequence[Scene], num_objects: int | None = None) -> TeamLayout:
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
        return TeamLayout(tables, Workspace(*on_device((is_in_reach, is_near))))
