"""What stands in a hand's way: the open hand, on its way to a grasp, against the points that are seen.

Where nothing is seen something may be: fingers in hidden space cost, the more of them the more.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from halfseen.arrays import Image, Intrinsics, Points
from halfseen.cell.grasps import Grasp, tips_m
from halfseen.cell.gripper import Gripper
from halfseen.perception.objects import LOWEST_OBJECT_M, Labels
from halfseen.perception.view import SeenObject, View
from halfseen.shapes import Bool, Float

_NEAR_M = 0.28  # what is farther from an object, across the table, is in nobody's way
_BACK_M = 0.22  # how far back along its way the hand is looked after
_MARGIN_M = 0.002
_FLOOR_M = 0.003
_WRIST_RADIUS_M = 0.045
_BEHIND_M = 0.01  # farther than what is seen by this: hidden
_MOST_OTHER_POINTS = 2
_MOST_OWN_POINTS = (12, 4)  # in the fingers, in the palm
_COST_HIDDEN, _COST_HIDDEN_BY_ITSELF = 1.0, 0.3
_COST_AGAIN, _SAME_PLACE_M = 1.0, 0.02
_NUM_ALONG_FINGER = 6


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What a view shows around an object, in coordinates of the table.

    Parameters
    ----------
    own_m, other_m
        Visible points of the object, and of what else is above the table near it [m].
    id
        The object's label.
    labels, depth_m, intrinsics, camera_from_table
        Of the view.
    """

    own_m: Float[np.ndarray, "own 3"]
    other_m: Float[np.ndarray, "others 3"]
    id: int
    labels: Labels
    depth_m: Image
    intrinsics: Intrinsics
    camera_from_table: Float[np.ndarray, "4 4"]

    def hidden(self, points_m: Points) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Which points nobody sees (something is nearer, or nothing returned), and which the object itself hides."""
        rotation, shift_m = self.camera_from_table[:3, :3], self.camera_from_table[:3, 3]
        seen_m = points_m @ rotation.T + shift_m
        pixel = np.rint((seen_m @ self.intrinsics.T)[:, :2] / seen_m[:, 2:]).astype(int)
        column, row = np.clip(pixel, 0, np.array(self.depth_m.shape[::-1]) - 1).T
        is_hidden = ~(seen_m[:, 2] <= self.depth_m[row, column] + _BEHIND_M)
        return is_hidden, is_hidden & (self.labels[row, column] == self.id)


def surroundings(view: View, seen: SeenObject) -> Surroundings:
    """Gather what a view shows around an object.

    Parameters
    ----------
    view
        What is seen.
    seen
        One of its objects.
    """
    rotation, shift_m = view.camera_from_table[:3, :3], view.camera_from_table[:3, 3]
    is_return = view.image.is_return
    table_m = (view.image.points_m[is_return] - shift_m) @ rotation
    is_own = view.labels[is_return] == seen.id
    own_m = table_m[is_own]
    is_near = np.linalg.norm(table_m[:, :2] - np.median(own_m[:, :2], axis=0), axis=1) < _NEAR_M
    # Whatever is above the table is in the way, objects or not.
    is_other = ~is_own & is_near & (table_m[:, 2] > LOWEST_OBJECT_M)
    return Surroundings(
        own_m,
        table_m[is_other],
        seen.id,
        view.labels,
        view.image.depth_m,
        view.image.intrinsics,
        view.camera_from_table,
    )


def ranked(
    grasps: Iterable[Grasp], around: Surroundings, gripper: Gripper, failed: Sequence[Grasp] = ()
) -> list[Grasp]:
    """Keep the grasps whose way is free, and put the cheapest first.

    Parameters
    ----------
    grasps
        Candidates.
    around
        What is seen.
    gripper
        What comes.
    failed
        Grasps that failed here before: others come first.

    Returns
    -------
    list of Grasp
        Each with what hidden space and former failures add to its cost.
    """
    free = [grasp for grasp in grasps if _is_free(grasp, around, gripper)]
    costed = [replace(grasp, cost=grasp.cost + _more_cost(grasp, around, gripper, failed)) for grasp in free]
    return sorted(costed, key=lambda grasp: grasp.cost)


def _is_free(grasp: Grasp, around: Surroundings, gripper: Gripper) -> bool:
    if _lowest_m(grasp, gripper) < _FLOOR_M:
        return False
    fingers, palm, between = _within(grasp.in_hand(around.other_m), grasp, gripper, _MARGIN_M)
    # By its rim a cup is held with one finger inside: what is between the fingers is mostly its own other wall.
    in_the_way = fingers | palm | (between & (grasp.kind != "rim"))
    own_fingers, own_palm, _ = _within(grasp.in_hand(around.own_m), grasp, gripper, -0.5 * _MARGIN_M)
    most_in_fingers, most_in_palm = _MOST_OWN_POINTS
    return (
        int(in_the_way.sum()) <= _MOST_OTHER_POINTS
        and int(own_fingers.sum()) <= most_in_fingers
        and int(own_palm.sum()) <= most_in_palm
    )


def _lowest_m(grasp: Grasp, gripper: Gripper) -> float:
    """Height of the lowest corner of the open hand over the table [m]."""
    across, along, _ = (0.5 * size for size in gripper.palm_m)
    palm = [[x, y, _palm_m(gripper)] for x in (-across, across) for y in (-along, along)]
    return float(grasp.on_table(np.concatenate([tips_m(grasp, gripper), palm]))[:, 2].min())


def _palm_m(gripper: Gripper) -> float:
    """Front of the palm from the middle of the pads, along the way of the hand [m]; negative."""
    return 0.5 * gripper.pad_length_m - gripper.finger_m


def _within(
    hand_m: Points, grasp: Grasp, gripper: Gripper, margin_m: float
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Which points the fingers sweep on their way, which the palm and the wrist, and which are between the fingers."""
    x, y, z = np.abs(hand_m[:, 0]), np.abs(hand_m[:, 1]), hand_m[:, 2]
    half_m, tip_m, palm_m = 0.5 * grasp.opening_m, 0.5 * gripper.pad_length_m, _palm_m(gripper)
    is_across = x < 0.5 * gripper.pad_width_m + margin_m
    is_ahead = (z < tip_m + margin_m) & (z > -_BACK_M)
    fingers = is_across & (y > half_m - margin_m) & (y < half_m + gripper.finger_thickness_m + margin_m) & is_ahead
    across_m, along_m, deep_m = gripper.palm_m
    is_palm = (x < 0.5 * across_m + margin_m) & (y < 0.5 * along_m + margin_m) & (z < palm_m + margin_m)
    is_wrist = (np.hypot(x, y) < _WRIST_RADIUS_M + margin_m) & (z < palm_m - deep_m + margin_m)
    between = (x < 0.5 * gripper.pad_width_m) & (y < half_m) & (z < tip_m)
    return fingers, (is_palm | is_wrist) & (z > -_BACK_M), between


def _more_cost(grasp: Grasp, around: Surroundings, gripper: Gripper, failed: Sequence[Grasp]) -> float:
    is_hidden, is_by_itself = around.hidden(grasp.on_table(_finger_m(grasp, gripper)))
    hidden = _COST_HIDDEN * float(np.mean(is_hidden & ~is_by_itself)) + _COST_HIDDEN_BY_ITSELF * float(
        np.mean(is_by_itself)
    )
    is_again = any(np.linalg.norm(grasp.middle_m - other.middle_m) < _SAME_PLACE_M for other in failed)
    return hidden + _COST_AGAIN * is_again


def _finger_m(grasp: Grasp, gripper: Gripper) -> Points:
    """Points of the open fingers, in the frame of the hand [m]."""
    inner_m = 0.5 * grasp.opening_m + _MARGIN_M
    outer_m = 0.5 * grasp.opening_m + gripper.finger_thickness_m
    along = np.linspace(0.5 * gripper.pad_length_m, _palm_m(gripper), _NUM_ALONG_FINGER)
    across = (-0.5 * gripper.pad_width_m, 0.5 * gripper.pad_width_m)
    sides = (inner_m, outer_m, -inner_m, -outer_m)
    return np.array([[x, y, z] for x in across for y in sides for z in along])
