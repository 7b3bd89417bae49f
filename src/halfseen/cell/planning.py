"""From a grasp to angles of the joints: hover, come straight, lift straight; or why not."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from halfseen.cell.grasps import Grasp
from halfseen.cell.kinematics import Angles, Kinematics, Way, line
from halfseen.errors import PlanError
from halfseen.scene.poses import Pose, from_matrix
from halfseen.shapes import Float

APPROACH_M = 0.10
HOVER_M = 0.12
LIFT_M = 0.20
MOST_PLANS = 8  # grasps, no two of them alike, that are looked at before an object counts as out of reach
_ALIKE_M, _ALIKE_COSINE = 0.03, 0.98
_NUM_DRAWN = 3


class OutOfReachError(PlanError):
    """One robot reaches no grasp of an object; another may."""


@dataclass(frozen=True, eq=False)
class Plan:
    """How a robot fetches an object: `grasp` on the table, and the pose of the hand there in the world.

    Angles lead from above down to where the approach begins (`hover`), straight to the grasp, and straight up.
    """

    grasp: Grasp
    held: Pose
    hover: Float[np.ndarray, "hovering J"]
    approach: Float[np.ndarray, "coming J"]
    lift: Float[np.ndarray, "lifting J"]

    @property
    def below_m(self) -> float:
        """How far below the hand what it holds reaches: as far as the hand was above the table [m]."""
        return float(self.grasp.middle_m[2])

    @property
    def way_in(self) -> Way:
        """All moves of fetching."""
        return np.concatenate([self.hover, self.approach, self.lift])

    @property
    def way_out(self) -> Way:
        """From where it was lifted to the way it came, hand empty."""
        return np.concatenate([self.approach[-2::-1], self.hover[::-1]])

    @property
    def way_back(self) -> Way:
        """From where it was lifted, down to where it stood, and back the way it came."""
        return np.concatenate([self.lift[::-1], self.approach[-1:], self.way_out])


def plans(
    grasps: Iterable[Grasp],
    world_from_table: Float[np.ndarray, "4 4"],
    kinematics: Kinematics,
    begin_rad: Angles,
    rng: np.random.Generator,
) -> Iterator[Plan]:
    """Plan grasps that the robot can carry out.

    Parameters
    ----------
    grasps
        Candidates, best first; until `MOST_PLANS` of them are refused, and none that is like one that was tried.
    world_from_table
        Takes homogeneous points of the table into the world [m].

    Yields
    ------
    Plan
        At least one, the best first.

    Raises
    ------
    PlanError
        There is no grasp, or none is within reach: then it is an `OutOfReachError`.
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
        raise PlanError("no grasp is free: something stands in the way of each; clear what is next to it first")
    if len(refusals) == len(tried):
        raise OutOfReachError(f"no grasp is within reach; of {len(refusals)} that were tried the best: {refusals[0]}")


def _is_alike(grasp: Grasp, other: Grasp) -> bool:
    """Whether a grasp is where another is, and comes from there: what keeps one from it keeps the other."""
    apart_m = float(np.linalg.norm(grasp.middle_m - other.middle_m))
    return apart_m < _ALIKE_M and float(grasp.approach @ other.approach) > _ALIKE_COSINE


def _planned(
    grasp: Grasp,
    world_from_table: Float[np.ndarray, "4 4"],
    kinematics: Kinematics,
    begin_rad: Angles,
    rng: np.random.Generator,
) -> Plan:
    back_m = grasp.middle_m - APPROACH_M * grasp.approach
    before, angles = _first(_poses(grasp, back_m, world_from_table), kinematics, begin_rad, rng)
    x_m, y_m, z_m = (world_from_table @ [*grasp.middle_m, 1.0])[:3].tolist()
    held = Pose((x_m, y_m, z_m), before.quaternion)
    approach = line(kinematics, angles, before, np.array(held.position_m))
    lift = line(kinematics, approach[-1], held, np.add(held.position_m, [0.0, 0.0, LIFT_M]))
    hover = np.concatenate([_above(kinematics, angles, before), angles[None]])
    for way in (hover, approach, lift):
        kinematics.refuse_furniture(way)
    return Plan(grasp, held, hover, approach, lift)


def _above(kinematics: Kinematics, angles: Angles, before: Pose) -> Way:
    """Come down from above; where that is out of reach, come as it is."""
    try:
        return line(kinematics, angles, before, np.add(before.position_m, [0.0, 0.0, HOVER_M]))[::-1]
    except PlanError:
        return np.empty((0, len(angles)))


def _poses(grasp: Grasp, middle_m: Float[np.ndarray, " 3"], world_from_table: Float[np.ndarray, "4 4"]) -> list[Pose]:
    """Poses of the hand at a place: as the grasp has it, and turned half about its approach, which is as good."""
    hand = np.eye(4)
    hand[:3, 3] = middle_m
    poses = []
    for sign in (1.0, -1.0):
        hand[:3, :3] = grasp.axes * [sign, sign, 1.0]
        poses.append(from_matrix(world_from_table @ hand))
    return poses


def beginnings(kinematics: Kinematics, here_rad: Angles, rng: np.random.Generator) -> list[Angles]:
    """Angles from which a search begins: those now, and some that are drawn."""
    drawn = rng.uniform(*kinematics.search_rad.T, size=(_NUM_DRAWN, len(here_rad)))
    return [here_rad, *(kinematics.nearest_turn(angles, here_rad) for angles in drawn)]


def _first(
    poses: list[Pose], kinematics: Kinematics, begin_rad: Angles, rng: np.random.Generator
) -> tuple[Pose, Angles]:
    """The pose, and its angles, that are nearest to those now."""
    begins = beginnings(kinematics, begin_rad, rng)
    found = [(pose, kinematics.solve_from(pose, begins, begin_rad)) for pose in poses]
    reached = [(pose, angles) for pose, angles in found if angles is not None]
    if not reached:
        x_m, y_m, z_m = poses[0].position_m
        raise PlanError(f"({x_m:.3f}, {y_m:.3f}, {z_m:.3f}) m is out of reach at the tilt that the grasp needs")
    return min(reached, key=lambda pair: float(np.abs(pair[1] - begin_rad).max()))
