"""Into the rack: over a free slot, down until what is held stands, and open."""

import numpy as np
from scipy.spatial.transform import Rotation

from halfseen.cell.commands import Activity, Grip, Move, Reserve
from halfseen.cell.fetching import go_home, with_home
from halfseen.cell.grasps import UP
from halfseen.cell.kinematics import Angles, Kinematics
from halfseen.cell.live_cell import LiveCell
from halfseen.cell.model import Robot
from halfseen.cell.motion import Way, line
from halfseen.cell.planning import Plan, beginnings
from halfseen.errors import PlanError
from halfseen.perception.clouds import Vector
from halfseen.scene.poses import Pose, from_matrix

_ABOVE_M = 0.16  # over where it is put down, what is held passes over the rim and what stands there already
_DROP_M = 0.010
_NUM_TURNS = 8
_CARRYING, _PUTTING = 1.0, 0.7  # shares of the joints' speeds


class GaveWayError(PlanError):
    """A robot that held something was told to give way."""


def put_away(
    cell: LiveCell, robot: Robot, plan: Plan, middle_m: Vector, slot_m: Vector, rng: np.random.Generator
) -> Activity[None]:
    """Put what was lifted into a slot of the rack, and go home.

    Parameters
    ----------
    cell
        The running cell.
    robot
        Who holds it.
    plan
        How it was fetched.
    middle_m
        Where its middle was before, in the world [m].
    slot_m
        Where to, on the floor of the rack [m].
    rng
        Draws where the search for angles begins.

    Raises
    ------
    PlanError
        The slot is out of reach with the hand as it holds.
    GaveWayError
        It was told to give way to another robot, and has the way back to where the object stood.
    """
    kinematics = cell.kinematics[robot.name]
    here = plan.lift[-1]
    begins = beginnings(kinematics, here, rng)
    over, down = _ways(kinematics, plan, middle_m - np.array(plan.held.position_m), slot_m, begins)
    into = with_home(cell, robot, np.concatenate([over[None], down, down[-2::-1], over[None]]))
    if not (yield Reserve(into, with_home(cell, robot, plan.way_back), below_m=plan.below_m)):
        raise GaveWayError("another arm stood between it and the rack, so it gave way")
    yield Move(over[None], _CARRYING)
    yield Move(down, _PUTTING)
    yield Grip(plan.grasp.opening_m, seconds=0.4)
    yield Move(np.concatenate([down[-2::-1], over[None]]), _PUTTING)
    yield from go_home(cell, robot)


def _ways(
    kinematics: Kinematics, plan: Plan, beside_m: Vector, slot_m: Vector, begins: list[Angles]
) -> tuple[Angles, Way]:
    """Angles over a slot, and the way down: of the turns of the hand the one that is nearest."""
    above_table_m = plan.grasp.middle_m[2]
    found = []
    for turn_rad in 2 * np.pi * np.arange(_NUM_TURNS) / _NUM_TURNS:
        about = Rotation.from_rotvec(turn_rad * UP).as_matrix()
        hand = np.eye(4)
        hand[:3, :3] = about @ plan.held.rotation
        # What is held stood on the table: it stands in the rack when the hand is as far above its floor.
        hand[:3, 3] = slot_m - (about @ beside_m) * [1.0, 1.0, 0.0] + (above_table_m + _DROP_M) * UP
        way = _down(kinematics, from_matrix(hand), begins)
        if way is not None:
            found.append(way)
    if not found:
        x_m, y_m, z_m = slot_m
        raise PlanError(f"the rack's slot at ({x_m:.3f}, {y_m:.3f}, {z_m:.3f}) m is out of reach as the hand holds")
    return min(found, key=lambda way: float(np.abs(way[0] - begins[0]).max()))


def _down(kinematics: Kinematics, standing: Pose, begins: list[Angles]) -> tuple[Angles, Way] | None:
    x_m, y_m, z_m = standing.position_m
    above = Pose((x_m, y_m, z_m + _ABOVE_M), standing.quaternion)
    over = kinematics.solve_from(above, begins, begins[0])
    if over is None:
        return None
    try:
        return over, line(kinematics, over, above, np.array(standing.position_m))
    except PlanError:
        return None
