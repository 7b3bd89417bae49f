"""An object of which an arm hides a part is left out of a look; what stands free is seen as it is."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np
import pytest

from halfseen.cell.cut_by_arms import perceived_whole
from halfseen.cell.grasps import Grasp, hand_axes
from halfseen.cell.looking import Eye
from halfseen.cell.planning import Plan
from halfseen.cell.several.pair import PAIR
from halfseen.cell.workcell import Workcell
from halfseen.perception.view import perceive
from halfseen.scene.camera import look_at
from halfseen.scene.cups import Cup
from halfseen.scene.poses import Pose
from halfseen.scene.room import cup_name
from halfseen.scene.table import TABLE_TOP_M, Table
from halfseen.scene.xtion import xtion_at

CAMERA = xtion_at(look_at(np.array([0.0, -0.78, 1.24]), np.array([0.0, 0.0, TABLE_TOP_M])))
NOTHING_HELD = np.zeros(CAMERA.num_rows * CAMERA.num_columns, dtype=bool)
HELD_AT_M = (-0.20, -0.10, 0.96)
CUPS_M = ((-0.20, 0.12), (0.25, 0.0))


@pytest.fixture
def cell():
    cups = tuple(Cup(0.10, 0.036, 0.032) for _ in CUPS_M)
    poses = tuple(Pose((x_m, y_m, TABLE_TOP_M)) for x_m, y_m in CUPS_M)
    return Workcell(Table(cups, poses, CAMERA), np.random.default_rng(0), stations=PAIR)


def reach_before(cell, y_m, x_m=-0.20, z_m=0.80):
    """Hold the left hand low before the left cup, or behind it."""
    left = PAIR[0].robot
    kinematics, rng = cell.cell.kinematics[left.name], np.random.default_rng(0)
    begins = [np.array(left.home_rad), *rng.uniform(*kinematics.search_rad.T, size=(20, 6))]
    pose = Pose((x_m, y_m, z_m), (0.0, 1.0, 0.0, 0.0))
    angles = kinematics.solve_from(pose, begins, np.array(left.home_rad))
    assert angles is not None
    for name, angle in zip(left.joint_names, angles, strict=True):
        cell.cell.data.joint(name).qpos = angle
    mujoco.mj_forward(cell.cell.model, cell.cell.data)


def test_with_the_arms_at_home_both_cups_are_seen_whole(cell):
    look = Eye(cell.cell, CAMERA).look(np.random.default_rng(1))
    view, cloud = perceived_whole(look.cloud, look.robots_m, NOTHING_HELD)
    assert len(view.objects) == 2
    assert cloud is look.cloud


def test_a_cup_behind_an_arm_is_left_out_and_known_as_it_was(cell):
    cell.look()
    before = [known.middle_m.copy() for known in cell.memory.objects]
    reach_before(cell, 0.02)
    look = Eye(cell.cell, CAMERA).look(np.random.default_rng(1))
    assert len(perceive(look.cloud).objects) == 2, "a part of it is in view"
    cell.look()
    left, right = sorted(range(2), key=lambda k: before[k][0])
    assert cell.memory.objects[left].seen is None
    assert cell.memory.objects[right].seen is not None
    assert len(cell.memory.objects) == 2
    assert not cell.memory.objects[left].is_gone
    np.testing.assert_array_equal(cell.memory.objects[left].middle_m, before[left])


def test_a_cup_before_an_arm_is_seen(cell):
    cell.look()
    reach_before(cell, 0.25)
    look = Eye(cell.cell, CAMERA).look(np.random.default_rng(1))
    assert np.isfinite(look.robots_m).any()
    assert len(perceived_whole(look.cloud, look.robots_m, NOTHING_HELD)[0].objects) == 2


def hold_before(cell, number, hand_m):
    """Put the right cup into the left hand, which has taken it around its middle and holds it somewhere."""
    reach_before(cell, hand_m[1], hand_m[0], hand_m[2])
    model, data = cell.cell.model, cell.cell.data
    place = model.jnt_qposadr[model.body(cup_name(1)).jntadr[0]]
    data.qpos[place : place + 3] = np.array(hand_m) - [0.0, 0.0, 0.08]
    mujoco.mj_forward(model, data)
    grasp = Grasp(
        "around", np.array([0.0, 0.0, 0.08]), hand_axes(np.array([0.0, 0.0, -1.0]), np.array([1.0, 0, 0])), 0.1
    )
    stand = np.array(PAIR[0].robot.home_rad)[None]
    cell.in_hand[0], cell.planned[0] = cell.memory.objects[number], Plan(grasp, Pose(hand_m), stand, stand, stand)


def test_a_cup_behind_one_that_an_arm_holds_is_left_out_and_known_as_it_was(cell):
    cell.look()
    before = [known.middle_m.copy() for known in cell.memory.objects]
    left, right = sorted(range(2), key=lambda k: before[k][0])
    whole_px = np.count_nonzero(Eye(cell.cell, CAMERA).look(np.random.default_rng(1)).labels == 0)
    hold_before(cell, right, HELD_AT_M)
    look = Eye(cell.cell, CAMERA).look(np.random.default_rng(1))
    left_px = np.flatnonzero((look.labels == 0).ravel())
    assert len(left_px) < 0.9 * whole_px, "the cup that is held hides a part"
    not_by_arm, _ = perceived_whole(look.cloud, look.robots_m, NOTHING_HELD)
    assert any(np.isin(left_px, seen.pixels).any() for seen in not_by_arm.objects), "and the arm hides none"
    cell.look()
    assert [known.seen is None for known in cell.memory.objects] == [True, True]
    np.testing.assert_array_equal(cell.memory.objects[left].middle_m, before[left])
    # Nothing else came into sight, such as half a cup or the one in the air.
    assert len(cell.memory.objects) == 2
