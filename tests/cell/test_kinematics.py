"""Inverse kinematics: there and back, out of reach, and turns."""

import numpy as np
import pytest

from halfseen.cell.kinematics import NEAR_M, Kinematics
from halfseen.cell.model import Robot, cell_model
from halfseen.scene.poses import Pose

DOWN = (0.0, 1.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def kinematics():
    return Kinematics(cell_model([], []), Robot())


def angles_of(rng):
    return np.array([rng.uniform(-3, 3), rng.uniform(1.5, 4.5), rng.uniform(0.6, 5.0), *rng.uniform(-3, 3, size=3)])


def apart(one, other):
    """Between two poses: [m], and the angle [rad]."""
    turned = abs(float(np.dot(one.quaternion, other.quaternion)))
    return np.linalg.norm(np.subtract(one.position_m, other.position_m)), 2 * np.arccos(min(1.0, turned))


def test_where_some_angles_bring_the_hand_angles_are_found(kinematics):
    rng = np.random.default_rng(0)
    for _ in range(30):
        truth = angles_of(rng)
        target = kinematics.hand(truth)
        found = kinematics.solve_from(target, [angles_of(rng) for _ in range(8)], truth)
        assert found is not None
        distance, angle = apart(kinematics.hand(found), target)
        assert distance < NEAR_M
        assert angle < 4e-3
        assert (found >= kinematics.limits_rad[:, 0]).all()
        assert (found <= kinematics.limits_rad[:, 1]).all()
        assert (np.abs(found - truth)[kinematics.is_endless] <= np.pi + 1e-9).all()


def test_what_is_out_of_reach_is_not_found(kinematics):
    rng = np.random.default_rng(1)
    begins = [angles_of(rng) for _ in range(4)]
    assert kinematics.solve_from(Pose((0.0, -1.5, 0.8), DOWN), begins, begins[0]) is None


def test_endless_joints_take_the_nearest_turn(kinematics):
    angles = np.array([4.0, 3.0, 2.0, -4.0, 7.0, 0.1])
    near = kinematics.nearest_turn(angles, np.zeros(6))
    np.testing.assert_allclose(near, [4.0 - 2 * np.pi, 3.0, 2.0, -4.0 + 2 * np.pi, 7.0 - 2 * np.pi, 0.1])
    np.testing.assert_allclose(kinematics.hand(near).position_m, kinematics.hand(angles).position_m, atol=1e-12)


def test_most_of_the_table_is_in_reach_from_above(kinematics):
    rng = np.random.default_rng(2)
    begins = [angles_of(rng) for _ in range(8)]
    places = [(x, y) for x in np.linspace(-0.35, 0.35, 5) for y in np.linspace(-0.25, 0.25, 4)]
    found = [kinematics.solve_from(Pose((x, y, 0.8), DOWN), begins, begins[0]) is not None for x, y in places]
    assert np.mean(found) >= 0.85
