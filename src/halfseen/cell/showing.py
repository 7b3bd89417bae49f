"""Showing: what is held is turned before the camera, so that it is seen from all sides and hides nothing."""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from halfseen.arrays import Points
from halfseen.cell.commands import Activity, Move, Reserve
from halfseen.cell.fetching import with_home
from halfseen.cell.grasps import UP
from halfseen.cell.kinematics import Angles, Kinematics
from halfseen.cell.live_cell import LiveCell
from halfseen.cell.model import Robot
from halfseen.cell.planning import Plan, beginnings
from halfseen.scene.poses import Pose, from_matrix
from halfseen.shapes import Bool, Float

SHOWN_AT_M = (0.0, 0.05, 1.02)
"""Where the hand holds it, in the world [m]: in the picture, above everything on the table."""
NUM_SIDES = 2
_MOVING = 1.0  # share of the joints' speeds
_BESIDE_M, _ABOVE_M, _SLACK_M = 0.11, 0.08, 0.015
"""What is held lies so near to the point between the pads, to the sides and up; its shape errs by the last."""


def turned(
    cell: LiveCell, robot: Robot, plan: Plan, rng: np.random.Generator, on_side: Callable[[int], None]
) -> Activity[bool]:
    """Turn what was lifted before the camera, stop at each side, and bring it back to where it was lifted to.

    Parameters
    ----------
    cell, robot, plan, rng
        As for `halfseen.cell.racking.put_away`.
    on_side
        Called whenever a side is shown, with how many were shown before; those out of reach are left out.

    Returns
    -------
    bool
        Whether it was not told to give way to another robot; if so, it has the way back to where the object stood.
    """
    kinematics, num_shown = cell.kinematics[robot.name], 0
    back = with_home(cell, robot, plan.way_back)
    for side in range(NUM_SIDES):
        angles = _facing(kinematics, plan, 2 * np.pi * side / NUM_SIDES, cell.angles_rad(robot), rng)
        if angles is not None:
            if not (yield Reserve(np.stack([angles, plan.lift[-1]]), back, below_m=plan.below_m)):
                yield Move(plan.lift[-1:], _MOVING)
                return False
            yield Move(angles[None], _MOVING)
            on_side(num_shown)
            num_shown += 1
    yield Move(plan.lift[-1:], _MOVING)
    return True


def _facing(
    kinematics: Kinematics, plan: Plan, turn_rad: float, here: Angles, rng: np.random.Generator
) -> Angles | None:
    hand = np.eye(4)
    hand[:3, :3] = Rotation.from_rotvec(turn_rad * UP).as_matrix() @ plan.held.rotation
    hand[:3, 3] = SHOWN_AT_M
    return kinematics.solve_from(from_matrix(hand), beginnings(kinematics, here, rng), here)


def is_in_hand(points_m: Points, hand: Pose, plan: Plan) -> Bool[np.ndarray, " n"]:
    """Which points belong to what a hand holds.

    Parameters
    ----------
    points_m
        Points of the world that are no robot; NaN where nothing returned [m].
    hand
        Pose of the point between the pads.
    plan
        How it was fetched: as it stood on the table, it reaches as far below the hand as that was above the table.
    """
    apart_m: Float[np.ndarray, "n 3"] = points_m - np.array(hand.position_m)
    below_m = float(plan.grasp.middle_m[2]) + _SLACK_M
    with np.errstate(invalid="ignore"):
        is_beside = (np.abs(apart_m[:, :2]) < _BESIDE_M).all(axis=1)
        return is_beside & (apart_m[:, 2] < _ABOVE_M) & (apart_m[:, 2] > -below_m)
