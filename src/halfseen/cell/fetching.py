"""Activities of an arm: fetch an object, turn it in front of the camera, put it back or into the rack."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from halfseen.arrays import Points
from halfseen.cell.grasps import UP, Grasp
from halfseen.cell.kinematics import Angles, Kinematics, Way, in_metres, line
from halfseen.cell.live_cell import Activity, Grip, LiveCell, Move, Reserve, Rest
from halfseen.cell.model import MountedArm
from halfseen.cell.planning import FetchPlan, beginnings
from halfseen.errors import PlanError
from halfseen.perception.clouds import Vector
from halfseen.scene.poses import Pose, from_matrix, pose_of, rigid
from halfseen.shapes import Bool, Float


@dataclass(frozen=True)
class ObservedAttempt:
    """Outcome of an attempt, as the robot observes it.

    `is_held` is whether the hand held an object after the lift and, when washing, put it into the rack. `duration_s` is
    the time from the decision until the grasp's outcome was known [s]. `kind` is the kind of grasp, None if none was
    tried. `reason` is the reason for a failure, and `is_too_far` is whether no grasp was within reach.
    """

    is_held: bool
    duration_s: float
    kind: str | None
    reason: str = ""
    is_too_far: bool = False


_COMING, _LIFTING, _PUTTING = 0.6, 0.9, 0.9  # shares of the joints' speeds
_PRESSED_M = {"rim": -0.020}
"""Target opening of the closing hand, by kind of grasp [m]; 0 for other kinds."""
_LEAST_FELT_M = {"rim": 0.0015}
_LEAST_FELT_ELSE_M = 0.016
_SETTLE_S = 0.3


def come(plan: FetchPlan) -> Activity[None]:
    """Move an open hand to the grasp of a plan."""
    yield Grip(plan.grasp.opening_m, seconds=0.0)
    yield Move(plan.hover)
    yield Move(plan.approach, _COMING)


def pick_up(plan: FetchPlan) -> Activity[None]:
    """Close the hand and lift the object."""
    yield Grip(_PRESSED_M.get(plan.grasp.kind, 0.0))
    yield Move(plan.lift, _LIFTING)
    yield Rest(_SETTLE_S)


def feels(cell: LiveCell, robot: MountedArm, grasp: Grasp) -> bool:
    """Whether an object keeps the closed hand open, judged by its finger positions."""
    return cell.opening_m(robot) > _LEAST_FELT_M.get(grasp.kind, _LEAST_FELT_ELSE_M)


def put_down(plan: FetchPlan) -> Activity[None]:
    """Put the lifted object back where it was and release it."""
    yield Move(np.concatenate([plan.lift[-2::-1], plan.approach[-1:]]), _PUTTING)
    yield from open_hand(plan)


def open_hand(plan: FetchPlan) -> Activity[None]:
    """Open the hand in place, to the opening of the plan's grasp."""
    yield Grip(plan.grasp.opening_m, seconds=0.4)


def draw_back(cell: LiveCell, robot: MountedArm, plan: FetchPlan) -> Activity[None]:
    """Draw an open hand back along its approach and go home."""
    yield Move(plan.way_out, _PUTTING)
    yield from go_home(cell, robot)


def go_home(cell: LiveCell, robot: MountedArm) -> Activity[None]:
    """Go to the home position."""
    yield Move(home_from(cell, robot, cell.angles_rad(robot))[None])
    yield Rest(_SETTLE_S)


def with_home(cell: LiveCell, robot: MountedArm, way: Way) -> Float[np.ndarray, "homeward J"]:
    """Append the home angles to a path, at the nearest turn of endless joints."""
    return np.concatenate([way, home_from(cell, robot, way[-1])[None]])


def home_from(cell: LiveCell, robot: MountedArm, here_rad: Angles) -> Angles:
    """Home angles, at the turn of endless joints nearest to the given angles."""
    return cell.kinematics[robot.name].nearest_turn(np.array(robot.home_rad), here_rad)


SHOWN_AT_M = (0.0, 0.05, 1.02)
"""Position of the hand that shows an object, in the world [m]: in the camera's view, above everything on the table."""
NUM_SIDES = 2
_MOVING = 1.0  # share of the joints' speeds
_BESIDE_M, _BARE_M, _SLACK_M = 0.11, 0.08, 0.015
"""Distances of a held object from the point between the pads, sideways and up; and the error of its shape [m]."""


def turned(
    cell: LiveCell, robot: MountedArm, plan: FetchPlan, rng: np.random.Generator, on_side: Callable[[int], None]
) -> Activity[bool]:
    """Turn the lifted object in front of the camera, stop at each side, and return it to the top of the lift.

    Parameters
    ----------
    cell, robot, plan, rng
        As for `halfseen.cell.fetching.put_away`.
    on_side
        Called at each side with the number of sides shown before; sides out of reach are skipped.

    Returns
    -------
    bool
        False if the robot had to give way to another; the way back to where the object stood is then reserved.
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
    kinematics: Kinematics, plan: FetchPlan, turn_rad: float, here: Angles, rng: np.random.Generator
) -> Angles | None:
    hand = rigid(Rotation.from_rotvec(turn_rad * UP).as_matrix() @ plan.held.rotation, SHOWN_AT_M)
    return kinematics.solve_from(from_matrix(hand), beginnings(kinematics, here, rng), here)


def is_in_hand(points_m: Points, hand: Pose, plan: FetchPlan) -> Bool[np.ndarray, " n"]:
    """Mask of the world points [m] that belong to a held object; points are NaN where nothing returned.

    The object stood on the table, so it reaches as far below the hand as the hand was above the table.
    """
    apart_m: Float[np.ndarray, "n 3"] = points_m - np.array(hand.position_m)
    below_m = float(plan.grasp.middle_m[2]) + _SLACK_M
    with np.errstate(invalid="ignore"):
        is_beside = (np.abs(apart_m[:, :2]) < _BESIDE_M).all(axis=1)
        return is_beside & (apart_m[:, 2] < _BARE_M) & (apart_m[:, 2] > -below_m)


_ABOVE_M = 0.16  # height over the slot at which a held object passes over the rim and the cups already there
_DROP_M = 0.010
_NUM_TURNS = 8
_CARRYING, _RACKING = 1.0, 0.7  # shares of the joints' speeds


class GaveWayError(PlanError):
    """A robot that held an object had to give way."""


def put_away(
    cell: LiveCell, robot: MountedArm, plan: FetchPlan, middle_m: Vector, slot_m: Vector, rng: np.random.Generator
) -> Activity[None]:
    """Put the lifted object into a slot of the rack and go home.

    Parameters
    ----------
    middle_m
        Middle of the object before it was lifted, in the world [m].
    slot_m
        Target on the floor of the rack [m].

    Raises
    ------
    PlanError
        The slot is out of reach with this grasp.
    GaveWayError
        The robot had to give way to another; the way back to where the object stood is then reserved.
    """
    kinematics = cell.kinematics[robot.name]
    here = plan.lift[-1]
    begins = beginnings(kinematics, here, rng)
    over, down = _ways(kinematics, plan, middle_m - np.array(plan.held.position_m), slot_m, begins)
    into = with_home(cell, robot, np.concatenate([over[None], down, down[-2::-1], over[None]]))
    if not (yield Reserve(into, with_home(cell, robot, plan.way_back), below_m=plan.below_m)):
        raise GaveWayError("another arm was between this arm and the rack, so this arm gave way")
    yield Move(over[None], _CARRYING)
    yield Move(down, _RACKING)
    yield Grip(plan.grasp.opening_m, seconds=0.4)
    yield Move(np.concatenate([down[-2::-1], over[None]]), _RACKING)
    yield from go_home(cell, robot)


def _ways(
    kinematics: Kinematics, plan: FetchPlan, beside_m: Vector, slot_m: Vector, begins: list[Angles]
) -> tuple[Angles, Way]:
    """Joint angles over a slot and the path down, for the turn of the hand that needs the least motion."""
    above_table_m = plan.grasp.middle_m[2]
    found = []
    for turn_rad in 2 * np.pi * np.arange(_NUM_TURNS) / _NUM_TURNS:
        about = Rotation.from_rotvec(turn_rad * UP).as_matrix()
        # The object stood on the table. It stands in the rack when the hand has the same height over the rack's floor.
        hand_m = slot_m - (about @ beside_m) * [1.0, 1.0, 0.0] + (above_table_m + _DROP_M) * UP
        way = _down(kinematics, from_matrix(rigid(about @ plan.held.rotation, hand_m)), begins)
        if way is not None:
            found.append(way)
    if not found:
        raise PlanError(f"the rack's slot at {in_metres(slot_m)} is out of reach with this grasp")
    return min(found, key=lambda way: float(np.abs(way[0] - begins[0]).max()))


def _down(kinematics: Kinematics, standing: Pose, begins: list[Angles]) -> tuple[Angles, Way] | None:
    above = pose_of(np.add(standing.position_m, [0.0, 0.0, _ABOVE_M]), standing.quaternion)
    over = kinematics.solve_from(above, begins, begins[0])
    if over is not None:
        with suppress(PlanError):
            return over, line(kinematics, over, above, np.array(standing.position_m))
    return None
