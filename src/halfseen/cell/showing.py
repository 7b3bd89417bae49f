"""Showing: what is held is turned before the camera, so that it is seen from all sides and hides nothing."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from halfseen.arrays import Points
from halfseen.cell.grasps import UP
from halfseen.cell.kinematics import Angles, Kinematics
from halfseen.cell.live_cell import LiveCell
from halfseen.cell.model import Robot
from halfseen.cell.planning import Plan, beginnings
from halfseen.scene.poses import Pose, from_matrix

SHOWN_AT_M = (0.0, 0.05, 0.98)
"""Where the hand holds it, in the world [m]: in the picture, above everything on the table."""
NUM_SIDES = 2
_MOVING = 1.0  # share of the joints' speeds
_HELD_M = np.array([0.13, 0.13, 0.17])
"""What is held lies within so much of the point between the pads: across, along the closing axis, and ahead [m]."""
_BEHIND_M = 0.05


def turned(cell: LiveCell, robot: Robot, plan: Plan, rng: np.random.Generator) -> Iterator[int]:
    """Turn what was lifted before the camera, stop at each side, and bring it back to where it was lifted to.

    Parameters
    ----------
    cell
        The running cell.
    robot
        Who holds it.
    plan
        How it was fetched.
    rng
        Draws where the search for angles begins.

    Yields
    ------
    int
        How many sides were shown before, whenever one is shown; those out of reach are left out.
    """
    kinematics, num_shown = cell.kinematics[robot.name], 0
    for side in range(NUM_SIDES):
        angles = _facing(kinematics, plan, 2 * np.pi * side / NUM_SIDES, cell.angles_rad(robot), rng)
        if angles is not None:
            cell.move(robot, angles[None], _MOVING)
            yield num_shown
            num_shown += 1
    cell.move(robot, plan.lift[-1:], _MOVING)


def _facing(
    kinematics: Kinematics, plan: Plan, turn_rad: float, here: Angles, rng: np.random.Generator
) -> Angles | None:
    hand = np.eye(4)
    hand[:3, :3] = Rotation.from_rotvec(turn_rad * UP).as_matrix() @ plan.held.rotation
    hand[:3, 3] = SHOWN_AT_M
    return kinematics.solve_from(from_matrix(hand), beginnings(kinematics, here, rng), here)


def is_in_hand(points_m: Points, hand: Pose) -> Bool[np.ndarray, " n"]:
    """Which points belong to what a hand holds.

    Parameters
    ----------
    points_m
        Points of the world that are no robot; NaN where nothing returned [m].
    hand
        Pose of the point between the pads.
    """
    in_hand: Float[np.ndarray, "n 3"] = hand.apply_inverse(points_m)
    with np.errstate(invalid="ignore"):
        return (np.abs(in_hand) < _HELD_M).all(axis=1) & (in_hand[:, 2] > -_BEHIND_M)
