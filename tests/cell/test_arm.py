"""The arm beside a product of 4 × 4 matrices from its maker's table."""

from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pytest

from halfseen.cell import Gripper, Robot
from halfseen.cell.arm import JACO_2
from halfseen.cell.kinematics import Kinematics
from halfseen.cell.model import cell_model
from halfseen.cell.planning import beginnings
from halfseen.errors import SceneError

ANGLES = np.random.default_rng(0).uniform(-3.0, 3.0, size=(20, 6))


@pytest.fixture(scope="module")
def model():
    return JACO_2.spec().compile()


def of_the_maker(angles):
    """Flange of the arm by the table in the maker's guide: its lengths, tilts, and which way it counts."""
    d1, d2, d3, d4, d5, e2 = 0.2755, 0.41, 0.2073, 0.0741, 0.0741, 0.0098
    bend = np.deg2rad(30.0)
    fold = np.sin(bend) / np.sin(2 * bend)
    theta = angles * [-1, 1, 1, 1, 1, 1] + np.deg2rad([0, -90, 90, 0, -180, 90])
    alpha = [np.pi / 2, np.pi, np.pi / 2, 2 * bend, 2 * bend, np.pi]
    along_x = [0, d2, 0, 0, 0, 0]
    along_z = [d1, 0, -e2, -(d3 + fold * d4), -fold * (d4 + d5), -(fold * d5 + 0.02)]
    frame = np.eye(4)
    for t, a, x, z in zip(theta, alpha, along_x, along_z, strict=True):
        about_z = np.array([[np.cos(t), -np.sin(t), 0, 0], [np.sin(t), np.cos(t), 0, 0], [0, 0, 1, z], [0, 0, 0, 1]])
        about_x = np.array([[1, 0, 0, x], [0, np.cos(a), -np.sin(a), 0], [0, np.sin(a), np.cos(a), 0], [0, 0, 0, 1]])
        frame = frame @ about_z @ about_x
    return frame


@pytest.mark.parametrize("angles", ANGLES[:5])
def test_the_flange_is_where_the_makers_table_puts_it(model, angles):
    data = mujoco.MjData(model)
    data.qpos[:] = angles
    mujoco.mj_kinematics(model, data)
    expected = of_the_maker(angles)
    np.testing.assert_allclose(data.site("flange").xpos, expected[:3, 3], atol=1e-12)
    np.testing.assert_allclose(data.site("flange").xmat.reshape(3, 3), expected[:3, :3], atol=1e-12)


def test_it_weighs_what_its_links_weigh_and_carries_itself(model):
    links = [joint.mass_kg for joint in JACO_2.joints]
    assert model.body_mass.sum() == pytest.approx(sum(links) + JACO_2.base_mass_kg)
    data = mujoco.MjData(model)
    data.qpos[:] = data.ctrl[:] = [0.0, 3.0, 2.0, 0.0, 0.0, 0.0]
    for _ in range(500):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qpos, data.ctrl, atol=1e-6)


def test_searches_begin_where_they_always_did():
    least, largest = [-3.0, 2.0, 0.6, -3.0, -3.0, -3.0], [3.0, 4.3, 3.1, 3.0, 3.0, 3.0]
    kinematics, here = Kinematics(cell_model([], []), Robot()), np.zeros(6)
    drawn = np.random.default_rng(5).uniform(least, largest, size=(3, 6))
    np.testing.assert_array_equal(
        beginnings(kinematics, here, np.random.default_rng(5))[1:],
        [kinematics.nearest_turn(angles, here) for angles in drawn],
    )
    np.testing.assert_allclose(replace(JACO_2, begins_rad=None).search_rad[:2, 1], [np.pi, np.deg2rad(313.0)])


JOINT, MOTOR = JACO_2.joints[1], JACO_2.joints[1].motor


@pytest.mark.parametrize(
    ("part", "changed", "message"),
    [
        (MOTOR, {"speed_rad_s": 0.0}, r"motor: speed_rad_s is 0\.0; give a positive number"),
        (MOTOR, {"stiffness_nm": -1.0}, r"motor: stiffness_nm is -1\.0"),
        (MOTOR, {"armature_kgm2": float("nan")}, "motor: armature_kgm2 is nan"),
        (JOINT, {"mass_kg": -0.1}, r"joint: mass_kg is -0\.1"),
        (JOINT, {"radius_m": 0.0}, r"joint: radius_m is 0\.0"),
        (JOINT, {"a_m": float("inf")}, "joint: a_m is inf; give a finite number"),
        (JOINT, {"limits_rad": (2.0, 1.0)}, r"joint: limits_rad is \(2\.0, 1\.0\); give the smaller angle first"),
        (JACO_2, {"joints": JACO_2.joints[:4]}, "has 4 joints; to point its hand it needs 5"),
        (JACO_2, {"base_mass_kg": -1.0}, r"arm 'Kinova.*': base_mass_kg is -1\.0"),
        (JACO_2, {"flange_m": float("nan")}, "flange_m is nan; give a finite number"),
        (JACO_2, {"begins_rad": ((0.0, 1.0),)}, "has 6 joints and begins_rad 1 ranges; give one for every joint"),
        (Gripper(), {"finger_m": -0.1}, r"gripper: finger_m is -0\.1; give a positive number"),
        (Gripper(), {"palm_m": (0.1, 0.2, 0.0)}, r"gripper: palm_m is \(0\.1, 0\.2, 0\.0\); give a positive number"),
        (Gripper(), {"stroke_m": 0.2}, r"gripper: stroke_m is 0\.2; make it less than palm_m\[1\], 0\.164"),
        (Gripper(), {"pad_length_m": 0.09}, "make it less than finger_m"),
        (Gripper(), {"pad_thickness_m": 0.02}, "make it less than finger_thickness_m"),
        (
            Robot(),
            {"home_rad": (0.0,) * 5},
            "home_rad has 5 angles and its arm 6 joints; give one angle for every joint",
        ),
    ],
)
def test_numbers_that_cannot_be_are_refused(part, changed, message):
    with pytest.raises(SceneError, match=message):
        replace(part, **changed)


def test_links_end_where_the_next_ones_begin(model):
    """Each capsule touches the one before, whatever the angles."""
    data = mujoco.MjData(model)
    for angles in ANGLES:
        data.qpos[:] = angles
        mujoco.mj_kinematics(model, data)
        ends = []
        for geom in range(model.ngeom):
            half = data.geom_xmat[geom].reshape(3, 3)[:, 2] * model.geom_size[geom, 1]
            ends.append((data.geom_xpos[geom] - half, data.geom_xpos[geom] + half))
        for before, after in pairwise(ends[1:]):
            gap = min(np.linalg.norm(one - other) for one in before for other in after)
            assert gap < 0.0098 + 1e-9  # the elbow's offset


def test_the_middle_joints_have_limits_and_the_others_turn_without_end(model):
    assert model.jnt_limited.tolist() == [0, 1, 1, 0, 0, 0]
    np.testing.assert_allclose(np.rad2deg(model.jnt_range[1:3]), [[47.0, 313.0], [19.0, 341.0]])
