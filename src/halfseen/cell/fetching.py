"""Fetching in physics: open, hover, come, close, lift; and how it is put back or away."""

import numpy as np

from halfseen.cell.grasps import Grasp
from halfseen.cell.live_cell import LiveCell
from halfseen.cell.model import Robot
from halfseen.cell.planning import Plan

_COMING, _LIFTING, _PUTTING = 0.6, 0.9, 0.9  # shares of the joints' speeds
_PRESSED_M = {"rim": -0.020}
"""By kind of grasp, the opening that is asked for when the hand closes [m]; 0 for others."""
_LEAST_FELT_M = {"rim": 0.0015}
_LEAST_FELT_ELSE_M = 0.016
_SETTLE_S = 0.3


def fetch(cell: LiveCell, robot: Robot, plan: Plan) -> None:
    """Fetch what a plan is for, and lift it.

    Parameters
    ----------
    cell
        The running cell.
    robot
        Who fetches.
    plan
        How.
    """
    cell.grip(robot, plan.grasp.opening_m, seconds=0.0)
    cell.move(robot, plan.hover)
    cell.move(robot, plan.approach, _COMING)
    cell.grip(robot, _PRESSED_M.get(plan.grasp.kind, 0.0))
    cell.move(robot, plan.lift, _LIFTING)
    cell.wait(_SETTLE_S)


def feels(cell: LiveCell, robot: Robot, grasp: Grasp) -> bool:
    """Whether something keeps the closed hand open, as far as its fingers tell.

    Parameters
    ----------
    cell
        The running cell.
    robot
        Whose hand.
    grasp
        What it closed on.
    """
    return cell.opening_m(robot) > _LEAST_FELT_M.get(grasp.kind, _LEAST_FELT_ELSE_M)


def put_back(cell: LiveCell, robot: Robot, plan: Plan) -> None:
    """Put what was lifted back where it was, let go, and go home.

    Parameters
    ----------
    cell
        The running cell.
    robot
        Who fetched.
    plan
        How it was fetched.
    """
    cell.move(robot, np.concatenate([plan.lift[-2::-1], plan.approach[-1:]]), _PUTTING)
    let_go(cell, robot, plan)


def let_go(cell: LiveCell, robot: Robot, plan: Plan) -> None:
    """Open the hand where it is, draw it back the way it came, and go home."""
    cell.grip(robot, plan.grasp.opening_m, seconds=0.4)
    cell.move(robot, np.concatenate([plan.approach[-2::-1], plan.hover[::-1]]), _PUTTING)
    go_home(cell, robot)


def go_home(cell: LiveCell, robot: Robot) -> None:
    """Go where the robot waits."""
    here = cell.angles_rad(robot)
    home = cell.kinematics[robot.name].nearest_turn(np.array(robot.home_rad), here)
    cell.move(robot, home[None])
    cell.wait(_SETTLE_S)
