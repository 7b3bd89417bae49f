"""Worlds of one robot, two and three, and scenes that stand before them: what the tests of the world share."""

from dataclasses import replace

import numpy as np

from halfseen.cell.calibration.law_folder import read_law
from halfseen.cell.calibration.shipped import shipped_law
from halfseen.world import Robot, Scene, TableWorld, Team, WorldConfig

LAW = read_law(shipped_law()).law
CONFIGS = {"assumed": WorldConfig(), "calibrated": LAW.config(WorldConfig())}
LEFT, RIGHT = (-0.5, 0.05), (0.5, 0.05)
SLOW = replace(WorldConfig().grasping, log_time=1.2)


def _team(*robots):
    return Team(robots, reward_per_s=-0.05)


TEAMS = {
    "alone": None,
    "team1": _team(Robot(LEFT, 1.5, 1.3, "one")),
    "team2": _team(Robot(LEFT, 0.65, 1.0, "left", 0.02), Robot(RIGHT, 0.65, 1.5, "right", 0.03)),
    "team2 that nothing stops": _team(Robot(LEFT, 0.65, 1.0, "left"), Robot(RIGHT, 0.65, 1.5, "right")),
    "team2 of two laws": _team(Robot(LEFT, 0.65, 1.0, "left", grasping=SLOW), Robot(RIGHT, 0.65, 1.5, "right")),
    "team3": _team(Robot(LEFT, 0.8, 1.0, "left"), Robot(RIGHT, 0.8, 1.2, "right"), Robot((0.0, 0.6), 0.7, 0.8, "far")),
}


def scenes():
    """Three tables of 4, 6 and 5 objects, with grips and places."""
    rng, made = np.random.default_rng(3), []
    for size in (4, 6, 5):
        hides = rng.uniform(0.0, 0.5, (size, size)) * (rng.random((size, size)) < 0.4) * ~np.eye(size, dtype=bool)
        grip, places_m = rng.normal(0.0, 0.3, size), rng.uniform(-0.4, 0.4, (size, 2))
        made.append(Scene(hides, f"table of {size}", grip, places_m))
    return made


def world_of(team, law="assumed"):
    return TableWorld.of(TEAMS[team], CONFIGS[law])
