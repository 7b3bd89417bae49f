"""Two arms at the ends of a table: mirror images that can touch one another, each with a rack that it reaches."""

import numpy as np
import pytest

from halfseen.cell.kinematics import Kinematics
from halfseen.cell.model import cell_model
from halfseen.cell.motion import line
from halfseen.cell.several.pair import PAIR
from halfseen.cell.several.volumes import Outline
from halfseen.errors import PlanError
from halfseen.scene.poses import Pose
from halfseen.scene.table import TABLE_TOP_M

ROBOTS = [station.robot for station in PAIR]
TURNS_RAD = np.array([0.0, 0.5, 0.25, -0.25]) * np.pi


@pytest.fixture(scope="module")
def model():
    return cell_model([], [], ROBOTS, [station.rack for station in PAIR])


def parts(model, robot):
    names = [model.body(model.geom_bodyid[geom]).name for geom in range(model.ngeom)]
    return np.array([geom for geom, name in enumerate(names) if name.startswith(robot.of(""))])


def meet(model, one, other):
    return (model.geom_contype[one][:, None] & model.geom_conaffinity[other]) | (
        model.geom_conaffinity[one][:, None] & model.geom_contype[other]
    )


def test_parts_of_an_arm_meet_those_of_the_other_and_none_of_their_own(model):
    left, right = (parts(model, robot) for robot in ROBOTS)
    assert (meet(model, left, right) != 0).all()
    for own in (left, right):
        assert (meet(model, own, own) == 0).all()


def test_the_arms_wait_as_mirror_images_free_of_furniture_and_of_one_another(model):
    hands = []
    for robot in ROBOTS:
        kinematics = Kinematics(model, robot)
        kinematics.refuse_furniture([np.array(robot.home_rad)])
        hands.append(np.array(kinematics.hand(np.array(robot.home_rad)).position_m))
    np.testing.assert_allclose(hands[0] * [-1.0, 1.0, 1.0], hands[1], atol=2e-3)
    left, right = (
        Outline(model, robot).along(np.array(robot.home_rad), np.zeros((0, 6)), below_m=0.15) for robot in ROBOTS
    )
    assert not left.meets(right, margin_m=0.2)


def comes(kinematics, home, place_m, down_m):
    """Whether the hand comes over a place, and straight down by so much, pointing down."""
    for turn_rad in TURNS_RAD:
        over = Pose(tuple(place_m), (0.0, np.cos(0.5 * turn_rad), np.sin(0.5 * turn_rad), 0.0))
        angles = kinematics.solve(over, home)
        if angles is None:
            continue
        try:
            line(kinematics, angles, over, np.subtract(place_m, (0.0, 0.0, down_m)))
        except PlanError:
            continue
        return True
    return False


@pytest.mark.parametrize("station", PAIR, ids=["left", "right"])
def test_an_arm_reaches_every_slot_of_its_rack_and_its_half_of_the_table(model, station):
    kinematics, home = Kinematics(model, station.robot), np.array(station.robot.home_rad)
    assert len(station.rack.slots_m) == 9
    assert all(comes(kinematics, home, np.add(slot_m, [0.0, 0.0, 0.24]), 0.15) for slot_m in station.rack.slots_m)
    base_m, side = np.array(station.robot.base_m[:2]), np.sign(station.robot.base_m[0])
    own = [np.array((side * x_m, y_m)) for x_m in (0.3, 0.15, 0.0) for y_m in (-0.2, 0.0, 0.2)]
    near = [place_m for place_m in own if np.linalg.norm(place_m - base_m) <= station.reach_m]
    assert len(near) == 9
    assert all(comes(kinematics, home, (*place_m, TABLE_TOP_M + 0.26), 0.18) for place_m in near)
