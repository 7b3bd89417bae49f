"""Where robots clearly differ in how they grasp, the team learns it of each; else of all."""

from dataclasses import replace

import numpy as np
import pytest

from halfseen.arrays import stacked
from halfseen.errors import PolicyError
from halfseen.policies.folder.team_grasp import split_grasp, team_grasp_arrays, team_grasp_of
from halfseen.tables import TeamTask
from halfseen.tables.features import table_columns
from halfseen.tables.grasp.grasp_table import GraspByRobot, GraspTable
from halfseen.tables.team_features import NUM_LIFT, NUM_WASH, team_features
from halfseen.world import FittedGrasping, Robot, Scene, TableWorld, UniformPolicy, Verb, WorldConfig, random
from halfseen.world.transition import start, step
from picked import leaves_of, picked

HIDES = np.triu(np.full((4, 4), 0.25), 1)
SCENE = Scene(HIDES, places_m=np.array([[-0.3, 0.0], [-0.1, 0.0], [0.1, 0.0], [0.3, 0.0]]))
WORLD = WorldConfig(horizon=5)
LOGISTIC = FittedGrasping(
    log_odds=0.4,
    log_odds_per_occlusion=-2.0,
    offset_std=1.5,
    log_held_s=float(np.log(2.0)),
    log_missed_s=float(np.log(4.0)),
    log_std=1e-3,
    limit_s=9.0,
)

SURE, CLUMSY = replace(LOGISTIC, log_odds=3.0), replace(LOGISTIC, log_odds=-2.0)
KEY = random.key_of(2)


def world_of(*laws):
    robots = [Robot((x, 0.05), 2.0, grasping=law) for x, law in zip((-0.5, 0.5), laws, strict=True)]
    return TableWorld(WORLD, robots=robots, clearance_m=0.05)


def begun(world):
    """The first decision at the table."""
    return start(world.played_config, picked(world.layouts([SCENE]), 0), KEY)


def fitted(*laws, num_paths=300):
    logs = world_of(*laws).simulate([SCENE], UniformPolicy(), num_paths, seed=1, cut_share=0.2)
    return TeamTask(base=None).fitted(logs, 2 * WORLD.horizon)


@pytest.mark.slow
def test_robots_that_differ_are_told_apart_and_those_that_do_not_are_not():
    told = fitted(SURE, CLUMSY)
    assert isinstance(told.grasp, GraspByRobot)
    assert "own attempts" in told.chosen[-1]
    state, _ = begun(world_of(SURE, CLUMSY))
    # Of the object in full view before any attempt: the law, its hidden grip integrated out.
    offsets = LOGISTIC.offset_std * np.random.default_rng(0).standard_normal(100_000)
    for robot, law in enumerate((SURE, CLUMSY)):
        known = np.mean(1.0 / (1.0 + np.exp(-law.log_odds - offsets)))
        assert float(told.grasp.of(robot).probability(state)[-1]) == pytest.approx(known, abs=0.1)
    assert not isinstance(fitted(SURE, SURE).grasp, GraspByRobot)
    # Too few attempts tell nothing.
    assert not isinstance(fitted(SURE, CLUMSY, num_paths=5).grasp, GraspByRobot)


def by_robot():
    shared, *own = (
        GraspTable(np.full((3, 2, 2), chance, dtype=np.float32), np.float32(1.0)) for chance in (0.5, 0.9, 0.2)
    )
    return GraspByRobot(shared, stacked(own)), shared, own


def test_what_is_about_an_object_goes_by_who_is_at_it():
    model, shared, own = by_robot()
    world = world_of(None, None)
    state, hidden = begun(world)
    state, hidden, _ = step(world.played_config, state, hidden, np.int32(2), KEY)  # robot 0 washes 1, robot 1 decides
    assert int(state.decider) == 1
    of_0, of_1 = (table_columns(state, each).of_verb[Verb.WASH] for each in own)
    found, plain = (team_features(state, each) for each in (model, shared))
    # After WASH of 2 two are under way, each as its robot grasps; after FINISH that of robot 0.
    of_wash = slice(1, NUM_WASH)
    both = [one[1] + other[2] for one, other in zip(of_0, of_1, strict=True)]
    for action, known in ((1 + 2, both), (0, [each[1] for each in of_0])):
        np.testing.assert_allclose(found[action, of_wash], known, rtol=1e-5)
    # What the team can clear is the same, whoever decides.
    team = slice(NUM_WASH + NUM_LIFT, NUM_WASH + NUM_LIFT + 18)
    np.testing.assert_array_equal(found[:, team], plain[:, team])
    assert np.abs(found[:, of_wash] - plain[:, of_wash]).max() > 0.1
    # Where all grasp alike, nothing changes.
    alike = GraspByRobot(shared, stacked([shared, shared]))
    np.testing.assert_allclose(team_features(state, alike), plain, rtol=1e-6)


def test_it_comes_back_from_a_folder_and_what_does_not_fit_is_refused():
    model, _, _ = by_robot()
    arrays = team_grasp_arrays(model)
    shared, own = split_grasp(arrays, 2)
    again = team_grasp_of(shared, own)
    assert isinstance(again, GraspByRobot)
    for one, other in zip(leaves_of(again), leaves_of(model), strict=True):
        np.testing.assert_array_equal(one, other)
    without = {name: each for name, each in arrays.items() if name != "own.grasp.per_grip"}
    twos = {**arrays, "own.grasp.chances": arrays["own.grasp.chances"] * 0.0 + 2.0}
    for given, num_robots, told in (
        (arrays, 3, "asks for float32 of shape"),
        (without, 2, "'own.grasp.per_grip' or 'grasp.per_grip' is missing"),
        (twos, 2, "'own.grasp.chances' holds 2.0"),
    ):
        with pytest.raises(PolicyError, match=told):
            split_grasp(given, num_robots)
