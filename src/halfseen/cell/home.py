"""Where an arm stands, and where it waits: with its hand behind the table's left, so that most of the table is near.

Angles are sought from many beginnings, always the same; of those that hold the hand there, free of furniture and
with no joint at a limit, those with the highest elbows are tried: the robot takes the ones from which it comes straight
to most places over the table.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from math import cos, pi, sin

import mujoco
import numpy as np

from halfseen.cell.arm import SerialArm
from halfseen.cell.kinematics import Angles, Kinematics, line
from halfseen.cell.model import Robot, cell_model
from halfseen.errors import PlanError
from halfseen.scene.poses import Pose
from halfseen.scene.table import TABLE_TOP_M

HOME_M = (-0.40, 0.58, 0.98)  # where the hand waits, pointing down
STANDS_M = ((0.0, 0.42, 0.56), (0.0, 0.50, 0.72), (0.0, 0.60, 0.72))
"""Where a base may stand behind the table, in the order in which they are tried."""
PLACES_M = tuple(product((-0.3, 0.0, 0.3), (-0.2, 0.0, 0.2), (TABLE_TOP_M + 0.2,)))
"""Over the table, where the hand is to come to from there, pointing down, and on to the table."""
_NUM_BEGUN, _NUM_KEPT = 96, 6
_TURNS_RAD = (0.0, pi / 2, pi / 4, -pi / 4)
_NUM_LOOKED_AT = 8
_DOWN_M = 0.12
_CORNER_RAD = 0.05
_NUM_REACHED = 2000


def robot_of(arm: SerialArm, *, stands_m: Sequence[tuple[float, float, float]] = STANDS_M) -> Robot:
    """Make a robot of any arm: find where it stands, the base's x to the table, and where it waits.

    Parameters
    ----------
    arm
        The arm, for example an `ArmFile`.
    stands_m
        Where its base may stand [m]; the first from which it comes everywhere is taken, or else the best.

    Raises
    ------
    PlanError
        From none of them the hand comes to where it waits, or over the table; the message says how far it reaches.
    """
    best, most = None, 0
    for base_m in stands_m:
        robot = _standing(arm, base_m)
        found, num_places = home_rad(robot)
        if found is not None and num_places > most:
            best, most = replace(robot, home_rad=tuple(found.tolist())), num_places
        if most == len(PLACES_M):
            break
    if best is None:
        raise PlanError(_too_far(_standing(arm, stands_m[0])))
    return best


def _standing(arm: SerialArm, base_m: tuple[float, float, float]) -> Robot:
    return Robot(base_m=base_m, turn_rad=-pi / 2, arm=arm, home_rad=(0.0,) * arm.num_joints)


def home_rad(robot: Robot) -> tuple[Angles | None, int]:
    """Find where a robot waits.

    Parameters
    ----------
    robot
        The robot; where it waits so far is of no account.

    Returns
    -------
    tuple
        Angles of its joints [rad], None if its hand cannot be there, and to how many of `PLACES_M` it comes from there.
    """
    model = cell_model([], [], (robot,))
    kinematics, shown = Kinematics(model, robot), mujoco.MjData(model)
    begins = np.random.default_rng(0).uniform(*kinematics.search_rad.T, size=(_NUM_BEGUN, robot.arm.num_joints))
    found = []
    for number, begin in enumerate(begins):
        angles = kinematics.solve(_down(HOME_M, _TURNS_RAD[number % len(_TURNS_RAD)]), begin)
        if angles is not None:
            found.append(kinematics.nearest_turn(angles, np.zeros(len(angles))))
    free = [angles for angles in found if _is_free(kinematics, angles[None])]
    ranked = sorted(free, key=lambda angles: (_is_cornered(kinematics, angles), -_height_m(shown, robot, angles)))
    counted = [(angles, sum(_comes(kinematics, angles, place) for place in PLACES_M)) for angles in ranked[:_NUM_KEPT]]
    return max(counted, key=lambda pair: pair[1], default=(None, 0))


def _down(place_m: tuple[float, float, float], turn_rad: float) -> Pose:
    """The hand at a place, pointing down and turned about the vertical."""
    return Pose(place_m, (0.0, cos(0.5 * turn_rad), sin(0.5 * turn_rad), 0.0))


def _comes(kinematics: Kinematics, home: Angles, place_m: tuple[float, float, float]) -> bool:
    """Whether the hand comes from home to a place, all joints turning evenly, and straight down, without a touch."""
    for turn_rad in _TURNS_RAD[:2]:
        above = _down(place_m, turn_rad)
        there = kinematics.solve(above, home)
        if there is None:
            continue
        try:
            down = line(kinematics, there, above, np.subtract(place_m, (0.0, 0.0, _DOWN_M)))
            kinematics.refuse_furniture([*np.linspace(home, there, _NUM_LOOKED_AT), *down])
        except PlanError:
            continue
        return True
    return False


def _is_free(kinematics: Kinematics, way: np.ndarray) -> bool:
    try:
        kinematics.refuse_furniture(way)
    except PlanError:
        return False
    return True


def _is_cornered(kinematics: Kinematics, angles: Angles) -> bool:
    """Whether a joint is at a limit, where it can only go back."""
    return bool((np.abs(angles[:, None] - kinematics.limits_rad) < _CORNER_RAD).any())


def _height_m(shown: mujoco.MjData, robot: Robot, angles: Angles) -> float:
    """Of the arm's joints above the floor, on average [m]."""
    for name, angle in zip(robot.joint_names, angles, strict=True):
        shown.joint(name).qpos = angle
    mujoco.mj_kinematics(shown.model, shown)
    return float(np.mean([shown.joint(name).xanchor[2] for name in robot.joint_names]))


def _too_far(robot: Robot) -> str:
    kinematics, rng = Kinematics(cell_model([], [], (robot,)), robot), np.random.default_rng(0)
    drawn = rng.uniform(*kinematics.search_rad.T, size=(_NUM_REACHED, robot.arm.num_joints))
    base_m = np.array(robot.base_m)
    reach_m = max(float(np.linalg.norm(kinematics.hand(angles).position_m - base_m)) for angles in drawn)
    away_m = {
        what: float(np.linalg.norm(np.array(place_m) - base_m))
        for what, place_m in (("where it waits", HOME_M), ("over the table's middle", PLACES_M[len(PLACES_M) // 2]))
    }
    return (
        f"arm {robot.arm.name!r}: its hand reaches {reach_m:.2f} m from the base, and must point down, free of "
        "furniture, "
        + " and ".join(f"{distance_m:.2f} m from it {what}" for what, distance_m in away_m.items())
        + "; stand the base elsewhere, turn it, or take a longer arm"
    )
