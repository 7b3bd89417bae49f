"""Lines are straight, schedules keep to the speeds, and the live cell follows them."""

import numpy as np
import pytest

from halfseen.cell import Robot, cell_model
from halfseen.cell.kinematics import Kinematics
from halfseen.cell.live_cell import LiveCell
from halfseen.cell.motion import line, schedule
from halfseen.errors import PlanError
from halfseen.scene.cups import Cup
from halfseen.scene.poses import Pose
from halfseen.scene.table import TABLE_TOP_M

ROBOT = Robot()
HOME = np.array(ROBOT.home_rad)
SPEEDS = ROBOT.arm.speeds_rad_s
CUP = Cup(0.1, 0.04, 0.035)


@pytest.fixture(scope="module")
def kinematics():
    return Kinematics(cell_model([], []), ROBOT)


def test_a_line_is_straight_and_does_not_turn_the_hand(kinematics):
    begin = kinematics.hand(HOME)
    end_m = np.add(begin.position_m, [0.1, -0.05, -0.15])
    way = line(kinematics, HOME, begin, end_m)
    toward = (end_m - begin.position_m) / np.linalg.norm(end_m - begin.position_m)
    for angles in way:
        pose = kinematics.hand(angles)
        apart = np.subtract(pose.position_m, begin.position_m)
        assert np.linalg.norm(apart - (apart @ toward) * toward) < 1e-3
        assert abs(np.dot(pose.quaternion, begin.quaternion)) > 1 - 1e-5
    np.testing.assert_allclose(kinematics.hand(way[-1]).position_m, end_m, atol=1e-3)


def test_a_line_out_of_reach_says_where_it_breaks_off(kinematics):
    begin = kinematics.hand(HOME)
    with pytest.raises(
        PlanError, match=r"the line to \(-0\.4.., -1\.5.., 0\.9..\) m breaks off at .* come from another"
    ):
        line(kinematics, HOME, begin, np.add(begin.position_m, [0.0, -2.1, 0.0]))


@pytest.mark.parametrize("turn", [1e-3, 0.05, 1.0])
def test_a_schedule_begins_and_ends_at_rest_and_keeps_to_the_speeds(turn):
    way = HOME + turn * np.array([[0.5, 0.2, 0, 0, 0, 0], [1.0, -1.0, 0.5, 0.3, 0, -1.0]])
    plan = schedule(HOME, way, SPEEDS)
    times = np.linspace(0.0, plan.duration_s, 2001)
    angles = plan.at(times)
    np.testing.assert_allclose(angles[0], HOME)
    np.testing.assert_allclose(angles[-1], way[-1], atol=1e-12)
    speed = np.diff(angles, axis=0) / times[1]
    assert (np.abs(speed) <= SPEEDS * 1.001).all()
    assert np.abs(speed[[0, -1]]).max() < 0.02 * SPEEDS.max()


def picked(friction=0.6):
    """Fetch a cup: hover, approach, close, lift."""
    cell = LiveCell(cell_model([CUP], [Pose((0.05, 0.05, TABLE_TOP_M))], frictions=[friction]), [ROBOT])
    kinematics = cell.kinematics[ROBOT.name]
    above = Pose((0.05, 0.05, TABLE_TOP_M + CUP.height_m + 0.1), (0.0, 1.0, 0.0, 0.0))
    begins = HOME + np.random.default_rng(0).uniform(-1.0, 1.0, size=(12, 6))
    hover = kinematics.solve_from(above, begins, HOME)
    assert hover is not None
    down_m = np.array([0.05, 0.05, TABLE_TOP_M + CUP.height_m - 0.02])
    down = line(kinematics, hover, above, down_m)
    cell.grip(ROBOT, 0.11)
    cell.move(ROBOT, hover[None])
    cell.move(ROBOT, down, speed=0.5)
    cell.grip(ROBOT, 0.0)
    cell.move(ROBOT, down[::-1], speed=0.5)
    return cell


def test_a_cup_is_fetched_and_the_same_again():
    cell, again = picked(), picked()
    assert cell.cup(0).position_m[2] - TABLE_TOP_M == pytest.approx(0.1, abs=0.02)
    assert 0.06 < cell.opening_m(ROBOT) < 0.085
    assert cell.time_s == again.time_s
    assert cell.cup(0) == again.cup(0)


def test_whoever_watches_can_stop_it():
    class StopError(Exception):
        pass

    def stop(cell):
        if cell.time_s > 0.1:
            raise StopError

    cell = LiveCell(cell_model([], []), [ROBOT])
    cell.watches.append(stop)
    with pytest.raises(StopError):
        cell.move(ROBOT, (HOME + 0.3)[None])
    assert cell.time_s == pytest.approx(0.101, abs=0.002)
    np.testing.assert_allclose(cell.angles_rad(ROBOT), HOME, atol=0.05)
