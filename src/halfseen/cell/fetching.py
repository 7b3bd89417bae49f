"""Fetching in physics: open, hover, come, close, lift; and how it is put back or away."""

import numpy as np

from halfseen.cell.commands import Activity, Grip, Move, Rest
from halfseen.cell.grasps import Grasp
from halfseen.cell.kinematics import Angles
from halfseen.cell.live_cell import LiveCell
from halfseen.cell.model import Robot
from halfseen.cell.motion import Way
from halfseen.cell.planning import Plan
from halfseen.shapes import Float

_COMING, _LIFTING, _PUTTING = 0.6, 0.9, 0.9  # shares of the joints' speeds
_PRESSED_M = {"rim": -0.020}
"""By kind of grasp, the opening that is asked for when the hand closes [m]; 0 for others."""
_LEAST_FELT_M = {"rim": 0.0015}
_LEAST_FELT_ELSE_M = 0.016
_SETTLE_S = 0.3


def come(plan: Plan) -> Activity[None]:
    """Come to what a plan is for, with an open hand.

    Parameters
    ----------
    plan
        How.
    """
    yield Grip(plan.grasp.opening_m, seconds=0.0)
    yield Move(plan.hover)
    yield Move(plan.approach, _COMING)


def pick_up(plan: Plan) -> Activity[None]:
    """Close the hand there, and lift what it holds.

    Parameters
    ----------
    plan
        How it came there.
    """
    yield Grip(_PRESSED_M.get(plan.grasp.kind, 0.0))
    yield Move(plan.lift, _LIFTING)
    yield Rest(_SETTLE_S)


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


def put_down(plan: Plan) -> Activity[None]:
    """Put what was lifted back where it was, and let go.

    Parameters
    ----------
    plan
        How it was fetched.
    """
    yield Move(np.concatenate([plan.lift[-2::-1], plan.approach[-1:]]), _PUTTING)
    yield from open_hand(plan)


def open_hand(plan: Plan) -> Activity[None]:
    """Open the hand where it is, as far as it was to fetch something."""
    yield Grip(plan.grasp.opening_m, seconds=0.4)


def draw_back(cell: LiveCell, robot: Robot, plan: Plan) -> Activity[None]:
    """Draw an open hand back the way it came, and go home.

    Parameters
    ----------
    cell
        The running cell.
    robot
        Who came.
    plan
        How.
    """
    yield Move(plan.way_out, _PUTTING)
    yield from go_home(cell, robot)


def go_home(cell: LiveCell, robot: Robot) -> Activity[None]:
    """Go where the robot waits."""
    yield Move(home_from(cell, robot, cell.angles_rad(robot))[None])
    yield Rest(_SETTLE_S)


def with_home(cell: LiveCell, robot: Robot, way: Way) -> Float[np.ndarray, "homeward J"]:
    """Add to the end of a way where the robot waits, at the turn that is nearest."""
    return np.concatenate([way, home_from(cell, robot, way[-1])[None]])


def home_from(cell: LiveCell, robot: Robot, here_rad: Angles) -> Angles:
    """Angles where the robot waits, at the turn that is nearest to some angles."""
    return cell.kinematics[robot.name].nearest_turn(np.array(robot.home_rad), here_rad)
