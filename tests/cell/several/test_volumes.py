"""The space of an arm holds every part of it, all along its way."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from halfseen.cell.kinematics import Kinematics
from halfseen.cell.live_cell import LiveCell
from halfseen.cell.model import cell_model
from halfseen.cell.several.pair import PAIR
from halfseen.cell.several.volumes import MARGIN_M, Outline
from halfseen.scene.poses import Pose

LEFT, RIGHT = (station.robot for station in PAIR)
HOMES = [np.array(robot.home_rad) for robot in (LEFT, RIGHT)]


@pytest.fixture(scope="module")
def model():
    return cell_model([], [], (LEFT, RIGHT), [station.rack for station in PAIR])


def distances_m(model, left_rad, right_rad):
    """Of the two arms, by MuJoCo, part by part; the oracle."""
    data = mujoco.MjData(model)
    for robot, angles in ((LEFT, left_rad), (RIGHT, right_rad)):
        for name, angle in zip(robot.joint_names, angles, strict=True):
            data.joint(name).qpos = angle
        for name in robot.slide_names:
            data.joint(name).qpos = 0.5 * robot.gripper.stroke_m
    mujoco.mj_forward(model, data)
    names = [model.body(model.geom_bodyid[geom]).name for geom in range(model.ngeom)]
    left, right = (
        [geom for geom, name in enumerate(names) if name.startswith(robot.of(""))] for robot in (LEFT, RIGHT)
    )
    return min(mujoco.mj_geomDistance(model, data, one, other, 1.0, None) for one in left for other in right)


def drawn(model, rng, arm, num):
    """Angles with the hand over the middle of the table, anyhow."""
    kinematics, found = Kinematics(model, (LEFT, RIGHT)[arm]), []
    while len(found) < num:
        x_m, y_m, z_m = rng.uniform((-0.15, -0.15, 0.80), (0.15, 0.15, 1.05)).tolist()
        tilted = Rotation.from_euler("xyz", [np.pi, *rng.normal(0.0, 0.4, 2)]).as_quat(scalar_first=True).tolist()
        angles = kinematics.solve(Pose((x_m, y_m, z_m), tuple(tilted)), HOMES[arm])
        found += [] if angles is None else [angles]
    return found


def test_spaces_that_do_not_meet_are_of_arms_that_keep_their_distance(model):
    outlines, rng = [Outline(model, robot) for robot in (LEFT, RIGHT)], np.random.default_rng(0)
    near = []
    for angles in zip(drawn(model, rng, 0, 80), drawn(model, rng, 1, 80), strict=True):
        spaces = [outline.along(place, np.zeros((0, 6))) for outline, place in zip(outlines, angles, strict=True)]
        apart_m = distances_m(model, *angles)
        if not spaces[0].meets(spaces[1]):
            assert apart_m > 0.5 * MARGIN_M
        elif apart_m < 0.3:
            near.append(apart_m)
    assert near, "some of the arms come near"
    # Spheres are larger than what they hold, but not by much: a finger is much thinner.
    assert np.max(near) < MARGIN_M + 0.08


def test_a_way_takes_the_space_of_all_its_places_and_of_what_lies_between(model):
    outline, rng = Outline(model, LEFT), np.random.default_rng(1)
    begin, way = HOMES[0], HOMES[0] + rng.normal(0.0, 0.8, (2, 6))
    space = outline.along(begin, way)
    np.testing.assert_array_equal(space.places_rad[0], begin)
    np.testing.assert_array_equal(space.places_rad[-1], way[-1])
    assert np.abs(np.diff(space.places_rad, axis=0)).max() <= 0.05 + 1e-12
    between = 0.5 * (begin + way[0])
    assert np.abs(space.places_rad - between).max(axis=1).min() < 0.05
    assert len(space.after(3).places_rad) == len(space.places_rad) - 3


def test_what_is_held_takes_space_below_the_hand(model):
    outline = Outline(model, LEFT)
    empty, full = (outline.along(HOMES[0], np.zeros((0, 6)), below_m) for below_m in (0.0, 0.12))
    assert not empty.is_held.any()
    hand_m = np.array(LiveCell(model, [LEFT, RIGHT]).kinematics[LEFT.name].hand(HOMES[0]).position_m)
    held_m = full.middles_m[0, full.is_held]
    np.testing.assert_allclose(held_m[:, :2], np.tile(hand_m[:2], (len(held_m), 1)), atol=1e-9)
    assert held_m[:, 2].max() == pytest.approx(hand_m[2])
    # With its radius the lowest sphere reaches at least as far as what is held.
    assert held_m[:, 2].min() - 0.065 <= hand_m[2] - 0.12
