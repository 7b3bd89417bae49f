"""Grasp candidates from the cloud alone, in table coordinates, and their obstacles.

An upright vessel is grasped by its rim (one finger inside) or around it (both fingers outside, from above); a lying
one is grasped across. Other objects, and all objects under the visible-only planner, are grasped by the box around
their points. The open hand must avoid visible points. Hidden space may hold obstacles, so a grasp costs more the larger
the share of its fingers in hidden space.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from halfseen.arrays import Image, Intrinsics, Points, Transform
from halfseen.cell.gripper import Gripper
from halfseen.perception.clouds import Vector
from halfseen.perception.objects import LOWEST_OBJECT_M, Labels
from halfseen.perception.solids import Vessel
from halfseen.perception.view import SeenObject, View
from halfseen.shapes import Bool, Float

Axes = Float[np.ndarray, "3 3"]

UP = np.array([0.0, 0.0, 1.0])
CLEARANCE_M = 0.012  # extra opening on either side of the object
FLOOR_M = 0.004  # fingertips stay this far above the table
_RIM_OPENING_M = 0.046
_RIM_DEPTH_M = 0.012  # depth of the pads' middle below the rim
_WALL_M = 0.0015  # half of a typical wall
_AROUND_DEPTH_M = 0.020  # depth of the pads' middle below the rim
_BELOW_AXIS_M = 0.004  # a lying vessel is grasped slightly below its axis, so that it does not slip out upwards
_SMALLEST_RADIUS_M = 0.010
_NUM_RIM, _NUM_AROUND, _NUM_BOX = 16, 8, 8
_RIM_TILTS_RAD, _TILTS_RAD = (0.0, -0.6, 0.6), (0.0, -0.35, 0.35)
_TURNS_RAD = (0.0, -0.3, 0.3)
_ALONG = (0.25, 0.35, 0.45, 0.5, 0.55, 0.65, 0.75)


@dataclass(frozen=True, eq=False)
class Grasp:
    """A pose of the hand for grasping an object.

    Parameters
    ----------
    kind
        ``"rim"``, ``"around"``, ``"across"`` or ``"box"``.
    middle_m
        Point between the pads, in table coordinates [m].
    axes
        Columns are the hand's axes: across the fingers, along the closing direction, and out of the palm.
    opening_m
        Opening between the pads during the approach [m].
    cost
        Cost; 0 is best.
    """

    kind: str
    middle_m: Vector
    axes: Axes
    opening_m: float
    cost: float = 0.0

    @property
    def approach(self) -> Vector:
        """Unit vector of the approach direction."""
        return self.axes[:, 2]

    def on_table(self, hand_m: Points) -> Points:
        """Transform points from the hand frame to the table frame [m]."""
        return hand_m @ self.axes.T + self.middle_m

    def in_hand(self, table_m: Points) -> Points:
        """Transform points from the table frame to the hand frame [m]."""
        return (table_m - self.middle_m) @ self.axes


Grasping = Callable[[SeenObject, Points, Gripper], Iterable[Grasp]]
"""Generates grasp candidates from an object, its visible points in table coordinates [m], and the gripper."""


def completed(seen: SeenObject, points_m: Points, gripper: Gripper) -> Iterator[Grasp]:
    """Grasps of the completed shape, or of the visible points if the object is not a vessel."""
    if not isinstance(seen.solid, Vessel):
        return visible(seen, points_m, gripper)
    return (_of_standing if seen.solid.is_upright else _of_lying)(seen.solid, gripper)


def visible(seen: SeenObject, points_m: Points, gripper: Gripper) -> Iterator[Grasp]:
    """Grasps from above, with several closing directions, of the box around all visible points but outliers."""
    top_m = float(np.percentile(points_m[:, 2], 99)) - _AROUND_DEPTH_M
    for angle, tilt in product(np.pi * np.arange(_NUM_BOX) / _NUM_BOX, _TILTS_RAD):
        closing, beside = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([-np.sin(angle), np.cos(angle), 0.0])
        low_m, high_m = np.percentile(points_m @ np.stack([closing, beside], axis=1), [2, 98], axis=0)
        opening_m = float(high_m[0] - low_m[0]) + 2 * CLEARANCE_M
        if opening_m > gripper.stroke_m:
            continue
        middle_m = np.stack([closing, beside, UP], axis=1) @ [*(low_m + high_m) / 2, top_m]
        axes = hand_axes(_turned(-UP, closing, tilt), closing)
        yield _above_table(Grasp("box", middle_m, axes, opening_m, 0.1 + 0.08 * abs(tilt)), gripper)


GRASPING: dict[str, Grasping] = {"completed": completed, "visible-only": visible}
"""Grasp generators by name: with completed shapes, or with visible points only as the baseline."""


def _of_standing(vessel: Vessel, gripper: Gripper) -> Iterator[Grasp]:
    top_m, radius_m = vessel.axis_ends_m()[1], _radius_m(vessel, vessel.ends_m[1])
    slope = float(np.clip(vessel.slope, -0.1, 0.4))
    for angle, tilt in product(2 * np.pi * np.arange(_NUM_RIM) / _NUM_RIM, _RIM_TILTS_RAD):
        outward = np.array([np.cos(angle), np.sin(angle), 0.0])
        up = _unit(UP + slope * outward)
        closing = _unit(outward - (outward @ up) * up)
        middle_m = top_m + (radius_m - _WALL_M) * outward - _RIM_DEPTH_M * up
        cost = 0.10 + 0.08 * abs(tilt)
        yield Grasp("rim", middle_m, hand_axes(_turned(-up, closing, tilt), closing), _RIM_OPENING_M, cost)
    if 2 * (radius_m + CLEARANCE_M) > gripper.stroke_m:
        return
    depth_m = min(_AROUND_DEPTH_M, top_m[2] - 0.5 * gripper.pad_length_m - FLOOR_M)
    for angle, tilt in product(np.pi * np.arange(_NUM_AROUND) / _NUM_AROUND, _TILTS_RAD):
        closing = np.array([np.cos(angle), np.sin(angle), 0.0])
        axes = hand_axes(_turned(-UP, closing, tilt), closing)
        yield Grasp("around", top_m - depth_m * UP, axes, 2 * (radius_m + CLEARANCE_M), 0.08 * abs(tilt))


def _of_lying(vessel: Vessel, gripper: Gripper) -> Iterator[Grasp]:
    along = _unit(vessel.axis * [1.0, 1.0, 0.0])
    low_m, high_m = vessel.ends_m
    for share, lean, nod, turn in product(_ALONG, _RIM_TILTS_RAD, _TILTS_RAD, _TURNS_RAD):
        if nod and turn:
            continue
        at_m = low_m + share * (high_m - low_m)
        radius_m = _radius_m(vessel, at_m)
        opening_m = 2 * (radius_m / np.cos(turn) + CLEARANCE_M)
        if opening_m > gripper.stroke_m:
            continue
        closing = _turned(np.cross(UP, along), along, nod)
        approach = _turned(_turned(-UP, along, nod), closing, lean)
        about = Rotation.from_rotvec(turn * UP).as_matrix()
        centre_m = vessel.centre_m + at_m * vessel.axis - _BELOW_AXIS_M * UP
        cost = 0.6 * abs(share - 0.5) + 0.05 * (abs(lean) + abs(nod)) + 0.3 * abs(turn)
        grasp = Grasp("across", centre_m, about @ hand_axes(approach, closing), opening_m, cost)
        raised = _above_table(grasp, gripper)
        if raised.middle_m[2] - centre_m[2] < 0.45 * radius_m:
            yield raised


def _above_table(grasp: Grasp, gripper: Gripper) -> Grasp:
    """Draw the hand back until its fingertips clear the table."""
    lowest_m = float(grasp.on_table(tips_m(grasp, gripper))[:, 2].min())
    back_m = max(0.0, FLOOR_M - lowest_m) / max(0.3, -float(grasp.approach[2]))
    return replace(grasp, middle_m=grasp.middle_m - back_m * grasp.approach)


def tips_m(grasp: Grasp, gripper: Gripper) -> Points:
    """Corners of the open fingertips in the hand frame [m]."""
    across, out = 0.5 * gripper.pad_width_m, 0.5 * grasp.opening_m + gripper.finger_thickness_m
    return np.array([[x, y, 0.5 * gripper.pad_length_m] for x in (-across, across) for y in (-out, out)])


def hand_axes(approach: Vector, closing: Vector) -> Axes:
    """Hand axes from the approach and closing directions; the latter is made orthogonal to the former."""
    out = _unit(approach)
    close = _unit(closing - (closing @ out) * out)
    return np.stack([np.cross(close, out), close, out], axis=1)


def _radius_m(vessel: Vessel, along_m: float) -> float:
    return max(vessel.radius_m + vessel.slope * along_m, _SMALLEST_RADIUS_M)


def _turned(vector: Vector, axis: Vector, angle_rad: float) -> Vector:
    return Rotation.from_rotvec(angle_rad * axis).apply(vector)


def _unit(vector: Vector) -> Vector:
    return vector / np.linalg.norm(vector)


_NEAR_M = 0.28  # points farther from an object, across the table, are not obstacles
_BACK_M = 0.22  # length of the approach that is checked for obstacles
_MARGIN_M = 0.002
_FLOOR_M = 0.003
_WRIST_RADIUS_M = 0.045
_BEHIND_M = 0.01  # a point this much farther than the visible depth is hidden
_MOST_OTHER_POINTS = 2
_MOST_OWN_POINTS = (12, 4)  # in the fingers, in the palm
_COST_HIDDEN, _COST_HIDDEN_BY_ITSELF = 1.0, 0.3
_COST_AGAIN, _SAME_PLACE_M = 1.0, 0.02
_NUM_ALONG_FINGER = 6


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Visible surroundings of an object, in table coordinates [m].

    `own_m` holds the visible points of the object with label `id`; `other_m` holds other points near it above the
    table.
    """

    own_m: Float[np.ndarray, "own 3"]
    other_m: Float[np.ndarray, "others 3"]
    id: int
    labels: Labels
    depth_m: Image
    intrinsics: Intrinsics
    camera_from_table: Transform

    def hidden(self, points_m: Points) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Masks of points that are hidden (behind a surface or without return), and hidden by the object itself."""
        rotation, shift_m = self.camera_from_table[:3, :3], self.camera_from_table[:3, 3]
        seen_m = points_m @ rotation.T + shift_m
        pixel = np.rint((seen_m @ self.intrinsics.T)[:, :2] / seen_m[:, 2:]).astype(int)
        column, row = np.clip(pixel, 0, np.array(self.depth_m.shape[::-1]) - 1).T
        is_hidden = ~(seen_m[:, 2] <= self.depth_m[row, column] + _BEHIND_M)
        return is_hidden, is_hidden & (self.labels[row, column] == self.id)


def surroundings(view: View, seen: SeenObject) -> Surroundings:
    """Collect the visible surroundings of an object from a view."""
    rotation, shift_m = view.camera_from_table[:3, :3], view.camera_from_table[:3, 3]
    is_return = view.image.is_return
    table_m = (view.image.points_m[is_return] - shift_m) @ rotation
    is_own = view.labels[is_return] == seen.id
    own_m = table_m[is_own]
    is_near = np.linalg.norm(table_m[:, :2] - np.median(own_m[:, :2], axis=0), axis=1) < _NEAR_M
    # Everything above the table is an obstacle, whether or not it belongs to an object.
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
    """Keep the collision-free grasps and sort them by cost, cheapest first.

    Returns
    -------
    list of Grasp
        Grasps with the costs of hidden space and earlier failures added.
    """
    free = [grasp for grasp in grasps if _is_free(grasp, around, gripper)]
    costed = [replace(grasp, cost=grasp.cost + _more_cost(grasp, around, gripper, failed)) for grasp in free]
    return sorted(costed, key=lambda grasp: grasp.cost)


def _is_free(grasp: Grasp, around: Surroundings, gripper: Gripper) -> bool:
    if _lowest_m(grasp, gripper) < _FLOOR_M:
        return False
    fingers, palm, between = _within(grasp.in_hand(around.other_m), grasp, gripper, _MARGIN_M)
    # A rim grasp has one finger inside the cup, so points between the fingers are mostly the cup's opposite wall.
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
    """Position of the palm's front relative to the middle of the pads, along the approach [m]; negative."""
    return 0.5 * gripper.pad_length_m - gripper.finger_m


def _within(
    hand_m: Points, grasp: Grasp, gripper: Gripper, margin_m: float
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Masks of the points swept by the fingers, by the palm and wrist, and of those between the fingers."""
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
    """Sample points on the open fingers, in the hand frame [m]."""
    inner_m = 0.5 * grasp.opening_m + _MARGIN_M
    outer_m = 0.5 * grasp.opening_m + gripper.finger_thickness_m
    along = np.linspace(0.5 * gripper.pad_length_m, _palm_m(gripper), _NUM_ALONG_FINGER)
    across = (-0.5 * gripper.pad_width_m, 0.5 * gripper.pad_width_m)
    sides = (inner_m, outer_m, -inner_m, -outer_m)
    return np.array([[x, y, z] for x in across for y in sides for z in along])
