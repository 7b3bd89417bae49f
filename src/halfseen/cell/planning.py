"""Planning: joint angles to hover, approach and lift in straight lines, or the reason for failure; and home poses.

At home the hand is behind the table's left, close to most of the table. Inverse kinematics searches for home angles
from many fixed start angles. Solutions must avoid furniture; those with a joint at a limit come last. Those with the
highest elbows are tried, and the one with the most places over the table within straight reach is chosen.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from math import cos, pi, sin

import numpy as np

from halfseen.arrays import Transform
from halfseen.cell.arm import SerialArm
from halfseen.cell.grasps import Grasp
from halfseen.cell.kinematics import Angles, Kinematics, Way, in_metres, line
from halfseen.cell.model import MountedArm, cell_model
from halfseen.errors import PlanError
from halfseen.scene.poses import Pose, from_matrix, pose_of, rigid
from halfseen.scene.table import TABLE_TOP_M
from halfseen.shapes import Float

APPROACH_M = 0.10
HOVER_M = 0.12
LIFT_M = 0.20
MOST_PLANS = 8  # infeasible grasps, no two of them alike, after which an object counts as out of reach
_ALIKE_M, _ALIKE_COSINE = 0.03, 0.98
_NUM_DRAWN = 3


class OutOfReachError(PlanError):
    """A robot reaches no grasp of an object; another robot may."""


@dataclass(frozen=True, eq=False)
class FetchPlan:
    """Plan to fetch an object: `grasp` in the table frame and `held`, the hand's pose there in the world.

    Joint angles go down to the start of the approach (`hover`), straight to the grasp (`approach`), and straight up
    (`lift`).
    """

    grasp: Grasp
    held: Pose
    hover: Float[np.ndarray, "hovering J"]
    approach: Float[np.ndarray, "coming J"]
    lift: Float[np.ndarray, "lifting J"]

    @property
    def below_m(self) -> float:
        """How far the held object reaches below the hand: the hand's height over the table at the grasp [m]."""
        return float(self.grasp.middle_m[2])

    @property
    def way_in(self) -> Way:
        """Joint angles of hover, approach and lift."""
        return np.concatenate([self.hover, self.approach, self.lift])

    @property
    def way_out(self) -> Way:
        """Joint angles back along the approach and hover, with an empty hand."""
        return np.concatenate([self.approach[-2::-1], self.hover[::-1]])

    @property
    def way_back(self) -> Way:
        """Joint angles to put the object down where it stood and draw back."""
        return np.concatenate([self.lift[::-1], self.approach[-1:], self.way_out])


def plans(
    grasps: Iterable[Grasp],
    world_from_table: Transform,
    kinematics: Kinematics,
    begin_rad: Angles,
    rng: np.random.Generator,
) -> Iterator[FetchPlan]:
    """Plan the grasps that the robot can execute.

    Parameters
    ----------
    grasps
        Candidates, best first. Those similar to an earlier one are skipped; planning ends after `MOST_PLANS` failures.
    world_from_table
        Transform of homogeneous points from the table to the world [m].

    Yields
    ------
    Plan
        At least one, best first.

    Raises
    ------
    PlanError
        There is no grasp.
    OutOfReachError
        No grasp is within reach.
    """
    tried: list[Grasp] = []
    refusals: list[str] = []
    for grasp in grasps:
        if any(_is_alike(grasp, other) for other in tried):
            continue
        try:
            found = _planned(grasp, world_from_table, kinematics, begin_rad, rng)
        except PlanError as error:
            refusals.append(str(error))
        else:
            yield found
        tried.append(grasp)
        if len(refusals) == MOST_PLANS:
            break
    if not tried:
        raise PlanError("every grasp is blocked; clear what is next to the object first")
    if len(refusals) == len(tried):
        raise OutOfReachError(f"no grasp is within reach; the best of {len(refusals)} tried: {refusals[0]}")


def _is_alike(grasp: Grasp, other: Grasp) -> bool:
    """Whether two grasps have nearly the same position and approach, and so the same obstacles."""
    apart_m = float(np.linalg.norm(grasp.middle_m - other.middle_m))
    return apart_m < _ALIKE_M and float(grasp.approach @ other.approach) > _ALIKE_COSINE


def _planned(
    grasp: Grasp, world_from_table: Transform, kinematics: Kinematics, begin_rad: Angles, rng: np.random.Generator
) -> FetchPlan:
    back_m = grasp.middle_m - APPROACH_M * grasp.approach
    before, angles = _first(_poses(grasp, back_m, world_from_table), kinematics, begin_rad, rng)
    held = pose_of((world_from_table @ [*grasp.middle_m, 1.0])[:3], before.quaternion)
    approach = line(kinematics, angles, before, np.array(held.position_m))
    lift = line(kinematics, approach[-1], held, np.add(held.position_m, [0.0, 0.0, LIFT_M]))
    hover = np.concatenate([_above(kinematics, angles, before), angles[None]])
    for way in (hover, approach, lift):
        kinematics.refuse_furniture(way)
    return FetchPlan(grasp, held, hover, approach, lift)


def _above(kinematics: Kinematics, angles: Angles, before: Pose) -> Way:
    """Path down from above to the start of the approach; empty if that is out of reach."""
    with suppress(PlanError):
        return line(kinematics, angles, before, np.add(before.position_m, [0.0, 0.0, HOVER_M]))[::-1]
    return np.empty((0, len(angles)))


def _poses(grasp: Grasp, middle_m: Float[np.ndarray, " 3"], world_from_table: Transform) -> list[Pose]:
    """Two equivalent hand poses: that of the grasp, and one turned by 180° about the approach."""
    hands = (rigid(grasp.axes * [sign, sign, 1.0], middle_m) for sign in (1.0, -1.0))
    return [from_matrix(world_from_table @ hand) for hand in hands]


def beginnings(kinematics: Kinematics, here_rad: Angles, rng: np.random.Generator) -> list[Angles]:
    """Start angles of a search: the current ones and some random ones."""
    drawn = rng.uniform(*kinematics.search_rad.T, size=(_NUM_DRAWN, len(here_rad)))
    return [here_rad, *(kinematics.nearest_turn(angles, here_rad) for angles in drawn)]


def _first(
    poses: list[Pose], kinematics: Kinematics, begin_rad: Angles, rng: np.random.Generator
) -> tuple[Pose, Angles]:
    """The pose whose joint angles are closest to the current ones, and those angles."""
    begins = beginnings(kinematics, begin_rad, rng)
    found = [(pose, kinematics.solve_from(pose, begins, begin_rad)) for pose in poses]
    reached = [(pose, angles) for pose, angles in found if angles is not None]
    if not reached:
        raise PlanError(f"{in_metres(poses[0].position_m)} is out of reach at the tilt that the grasp needs")
    return min(reached, key=lambda pair: float(np.abs(pair[1] - begin_rad).max()))


HOME_M = (-0.40, 0.58, 0.98)  # where the hand waits, pointing down
STANDS_M = ((0.0, 0.42, 0.56), (0.0, 0.50, 0.72), (0.0, 0.60, 0.72))
"""Base positions behind the table, in the order in which they are tried."""
PLACES_M = tuple(product((-0.3, 0.0, 0.3), (-0.2, 0.0, 0.2), (TABLE_TOP_M + 0.2,)))
"""Positions over the table that the hand should reach from home, pointing down, and from which it descends."""
_NUM_BEGUN, _NUM_KEPT = 96, 6
_TURNS_RAD = (0.0, pi / 2, pi / 4, -pi / 4)
_NUM_LOOKED_AT = 8
_DOWN_M = 0.12
_CORNER_RAD = 0.05
_NUM_REACHED = 2000


def robot_of(arm: SerialArm, *, stands_m: Sequence[tuple[float, float, float]] = STANDS_M) -> MountedArm:
    """Make a robot from any arm: find its base position, with the base's x towards the table, and its home angles.

    Parameters
    ----------
    arm
        The arm, for example an `ArmFile`.
    stands_m
        Candidate base positions [m]; the first that reaches all of `PLACES_M` is chosen, or else the best.

    Raises
    ------
    PlanError
        No candidate lets the hand reach its home pose and the table; the message states the reach.
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


def _standing(arm: SerialArm, base_m: tuple[float, float, float]) -> MountedArm:
    return MountedArm(base_m=base_m, turn_rad=-pi / 2, arm=arm, home_rad=(0.0,) * arm.num_joints)


def home_rad(robot: MountedArm) -> tuple[Angles | None, int]:
    """Find a robot's home angles.

    Parameters
    ----------
    robot
        The robot; its current home angles are ignored.

    Returns
    -------
    tuple
        Joint angles [rad], None if the home pose is out of reach; and how many of `PLACES_M` they reach.
    """
    kinematics = Kinematics(cell_model([], [], (robot,)), robot)
    begins = np.random.default_rng(0).uniform(*kinematics.search_rad.T, size=(_NUM_BEGUN, robot.arm.num_joints))
    found = []
    for number, begin in enumerate(begins):
        angles = kinematics.solve(_down(HOME_M, _TURNS_RAD[number % len(_TURNS_RAD)]), begin)
        if angles is not None:
            found.append(kinematics.nearest_turn(angles, np.zeros(len(angles))))
    free = [angles for angles in found if _is_free(kinematics, angles[None])]
    ranked = sorted(free, key=lambda angles: (_is_cornered(kinematics, angles), -_height_m(kinematics, robot, angles)))
    counted = [(angles, sum(_comes(kinematics, angles, place) for place in PLACES_M)) for angles in ranked[:_NUM_KEPT]]
    return max(counted, key=lambda pair: pair[1], default=(None, 0))


def _down(place_m: tuple[float, float, float], turn_rad: float) -> Pose:
    """Hand pose at a position, pointing down and turned about the vertical."""
    return Pose(place_m, (0.0, cos(0.5 * turn_rad), sin(0.5 * turn_rad), 0.0))


def _comes(kinematics: Kinematics, home: Angles, place_m: tuple[float, float, float]) -> bool:
    """Whether the hand gets from home to a position, all joints turning evenly, and straight down without contact."""
    for turn_rad in _TURNS_RAD[:2]:
        above = _down(place_m, turn_rad)
        there = kinematics.solve(above, home)
        if there is None:
            continue
        with suppress(PlanError):
            down = line(kinematics, there, above, np.subtract(place_m, (0.0, 0.0, _DOWN_M)))
            kinematics.refuse_furniture([*np.linspace(home, there, _NUM_LOOKED_AT), *down])
            return True
    return False


def _is_free(kinematics: Kinematics, way: np.ndarray) -> bool:
    with suppress(PlanError):
        kinematics.refuse_furniture(way)
        return True
    return False


def _is_cornered(kinematics: Kinematics, angles: Angles) -> bool:
    """Whether a joint is at a limit."""
    return bool((np.abs(angles[:, None] - kinematics.limits_rad) < _CORNER_RAD).any())


def _height_m(kinematics: Kinematics, robot: MountedArm, angles: Angles) -> float:
    """Mean height of the arm's joints above the floor [m]."""
    kinematics.place(angles)
    return float(np.mean([kinematics.data.joint(name).xanchor[2] for name in robot.joint_names]))


def _too_far(robot: MountedArm) -> str:
    kinematics, rng = Kinematics(cell_model([], [], (robot,)), robot), np.random.default_rng(0)
    drawn = rng.uniform(*kinematics.search_rad.T, size=(_NUM_REACHED, robot.arm.num_joints))
    base_m = np.array(robot.base_m)
    reach_m = max(float(np.linalg.norm(kinematics.hand(angles).position_m - base_m)) for angles in drawn)
    home_m, over_m = (float(np.linalg.norm(place - base_m)) for place in (HOME_M, PLACES_M[len(PLACES_M) // 2]))
    return (
        f"arm {robot.arm.name!r}: its hand reaches {reach_m:.2f} m from the base, but must point down, clear of "
        f"furniture, at {home_m:.2f} m from it where it waits and {over_m:.2f} m from it over the middle of the table; "
        "move the base, turn it, or use a longer arm"
    )
