"""Scenes, worlds and policies that the tests of the world share."""

from dataclasses import replace

import numpy as np

from halfseen.arrays import record
from halfseen.cell.calibration.law import read_law, shipped_law
from halfseen.world import Robot, Scene, TableWorld, Team, Workspace, WorldConfig
from halfseen.world.actions import FINISH
from halfseen.world.policy import surely
from halfseen.world.state import pad_scenes

LEFT, RIGHT = (-0.5, 0.05), (0.5, 0.05)
SLOW = replace(WorldConfig().grasping, log_time=1.2)
THREE = Scene(np.array([[0.0, 0.5, 0.2], [0.0, 0.0, 0.3], [0.1, 0.0, 0.0]]))
FITTED_SCENES = [
    Scene(np.array([[0.0, 0.6, 0.0], [0.1, 0.0, 0.0], [0.0, 0.4, 0.0]]), grip=np.array([-1.25, 0.5, 2.0])),
    Scene(np.zeros((2, 2)), grip=np.array([0.75, 0.0])),
]


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


PER_OBJECT = ("is_object", "is_on_table", "grip", "log_odds", "seen", "lifts")


def permuted(states, order):
    """A batch in which object k of the result is object order[k] of the given states."""
    rank, tried, space = np.argsort(order), states.attempt_object, states.workspace
    turned = replace(
        states,
        **{name: getattr(states, name)[:, order] for name in PER_OBJECT},
        hides=states.hides[:, order][:, :, order],
        attempt_object=np.where(tried >= 0, rank[tried], tried).astype(np.int32),
    )
    if space is None:
        return turned
    space = replace(space, is_in_reach=space.is_in_reach[:, :, order], is_near=space.is_near[:, order][:, :, order])
    return replace(turned, workspace=space, robots=replace(states.robots, target=rank[states.robots.target]))


def layouts_of(hides, reach, near=()):
    """One scene; a row of `reach` says what a robot reaches, and `near` which pairs of objects are near one another."""
    is_near = np.eye(len(hides), dtype=bool)
    for i, j in near:
        is_near[i, j] = is_near[j, i] = True
    return replace(pad_scenes([Scene(hides)]), workspace=Workspace(np.asarray(reach, dtype=bool)[None], is_near[None]))


def random_scene(num_objects, seed, largest=0.6):
    """Some objects, each hidden by about half of the others."""
    rng = np.random.default_rng(seed)
    hides = rng.uniform(0.0, largest, (num_objects, num_objects)) * (rng.random((num_objects, num_objects)) < 0.5)
    np.fill_diagonal(hides, 0.0)
    return Scene(hides, name=f"random-{num_objects}")


def recorded_scenes():
    """Three tables of 4, 6 and 5 objects, with grips and places."""
    rng, made = np.random.default_rng(3), []
    for size in (4, 6, 5):
        hides = rng.uniform(0.0, 0.5, (size, size)) * (rng.random((size, size)) < 0.4) * ~np.eye(size, dtype=bool)
        grip, places_m = rng.normal(0.0, 0.3, size), rng.uniform(-0.4, 0.4, (size, 2))
        made.append(Scene(hides, f"table of {size}", grip, places_m))
    return made


def world_of(team, law="assumed"):
    config = WorldConfig() if law == "assumed" else read_law(shipped_law()).law.config(WorldConfig())
    return TableWorld.of(TEAMS[team], config)


@record
class InTurn:
    """LIFT, then WASH, the first object on the table, until it is gone; then the next; FINISH at the last step."""

    def decide(self, state, key):
        first = np.argmax(state.is_on_table, axis=-1)
        is_lift = state.steps_to_go % 2 == 0
        action = 1 + first + np.where(is_lift, state.num_objects, 0)
        return surely(np.where(state.steps_to_go == 1, FINISH, action))


@record
class Suspicious:
    """WASH what looks dirtiest."""

    def decide(self, state, key):
        worst = np.argmax(np.where(state.is_on_table, state.log_odds, -np.inf), axis=-1)
        return surely(1 + worst)


ONE = Team((Robot((0.0, 0.0), 5.0),))
FRAIL = Team((Robot((-0.5, 0.0), 0.8, drop_out_rate=0.1), Robot((0.5, 0.0), 0.8)))
FRAIL3 = Team((*FRAIL.robots, Robot((0.0, -0.5), 0.8)))
