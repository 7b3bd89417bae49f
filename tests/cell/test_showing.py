"""What is held is told from what stands below it."""

import numpy as np

from halfseen.cell import LiveCell, Robot, cell_model
from halfseen.cell.grasps import Grasp, hand_axes
from halfseen.cell.planning import plan
from halfseen.cell.showing import NUM_SIDES, SHOWN_AT_M, is_in_hand, turned
from halfseen.scene.poses import Pose
from halfseen.scene.table import TABLE_TOP_M

ROBOT = Robot()
WORLD_FROM_TABLE = np.eye(4)
WORLD_FROM_TABLE[2, 3] = TABLE_TOP_M
GRASP = Grasp(
    "around", np.array([0.05, -0.02, 0.08]), hand_axes(np.array([0.0, 0.0, -1.0]), np.array([1.0, 0, 0])), 0.1
)


def fetched(cell):
    home = np.array(ROBOT.home_rad)
    return plan([GRASP], WORLD_FROM_TABLE, cell.kinematics[ROBOT.name], home, np.random.default_rng(0))


def test_a_cup_is_shown_from_two_opposite_sides_and_brought_back():
    cell = LiveCell(cell_model([], []), [ROBOT])
    done = fetched(cell)
    cell.move(ROBOT, done.lift)
    kinematics, closing = cell.kinematics[ROBOT.name], []

    def look_at(side):
        hand = kinematics.hand(cell.angles_rad(ROBOT))
        assert side == len(closing)
        np.testing.assert_allclose(hand.position_m, SHOWN_AT_M, atol=0.01)
        closing.append(hand.rotation[:, 1])

    cell.carry_out(ROBOT, turned(cell, ROBOT, done, np.random.default_rng(1), look_at))
    assert len(closing) == NUM_SIDES
    np.testing.assert_allclose(closing[0], -closing[1], atol=0.05)
    np.testing.assert_allclose(cell.angles_rad(ROBOT), done.lift[-1], atol=0.05)


def test_what_is_held_reaches_as_far_below_the_hand_as_it_stood_above_the_table():
    done = fetched(LiveCell(cell_model([], []), [ROBOT]))
    hand = Pose(SHOWN_AT_M, (0.0, 1.0, 0.0, 0.0))
    x, y, z = SHOWN_AT_M
    points_m = np.array(
        [[x, y, z], [x + 0.05, y, z - 0.08], [x, y, z - 0.11], [x + 0.13, y, z], [x, y, z + 0.1], [np.nan] * 3]
    )
    assert is_in_hand(points_m, hand, done).tolist() == [True, True, False, False, False, False]
    # The tallest cup on the table stays below the lowest that is held at its rim.
    assert z - 0.15 > TABLE_TOP_M + 0.145
