"""Grasps close where the shape says; nothing that is seen stands in their way; hidden space costs."""

from dataclasses import replace

import numpy as np
import pytest

from halfseen.cell import Gripper
from halfseen.cell.clearance import Surroundings, ranked
from halfseen.cell.grasps import CLEARANCE_M, FLOOR_M, GRASPING, Grasp, hand_axes, tips_m
from halfseen.perception.solids import Hull, Vessel
from halfseen.perception.view import SeenObject

GRIPPER = Gripper()
STANDING = Vessel(np.array([0.05, 0.6, 0.05]), np.array([0.0, 0.0, 1.0]), 0.035, 0.1, (-0.05, 0.05), 0.1)
LYING = Vessel(np.array([0.0, 0.7, 0.04]), np.array([0.6, 0.8, 0.0]), 0.038, 0.1, (-0.05, 0.05), 0.1)


def seen(solid):
    upright = isinstance(solid, Vessel) and solid.is_upright
    return SeenObject(0, np.zeros(3), 0.1, np.zeros(3), 0.0, 100, upright, np.arange(100), solid)


def grasps(solid, gripper=GRIPPER, points_m=None, name="completed"):
    return GRASPING[name](seen(solid), np.zeros((1, 3)) if points_m is None else points_m, gripper)


def box_points(size_m=(0.06, 0.04, 0.08)):
    corners = np.array(np.meshgrid(*[np.linspace(0, size, 9) for size in size_m])).reshape(3, -1).T
    return corners + np.array([0.1, 0.5, 0.0])


@pytest.mark.parametrize("solid", [STANDING, LYING, Hull(box_points())])
def test_hands_are_right_handed_keep_off_the_table_and_open_no_wider_than_they_can(solid):
    found = grasps(solid, points_m=box_points())
    assert found
    for grasp in found:
        np.testing.assert_allclose(grasp.axes.T @ grasp.axes, np.eye(3), atol=1e-12)
        assert np.linalg.det(grasp.axes) > 0
        assert grasp.opening_m <= GRIPPER.stroke_m
        assert grasp.approach[2] < -0.5
        if grasp.kind in ("across", "box"):
            assert grasp.on_table(tips_m(grasp, GRIPPER))[:, 2].min() > FLOOR_M - 1e-9


def test_a_hand_at_the_rim_has_the_wall_between_its_pads():
    rim = [grasp for grasp in grasps(STANDING) if grasp.kind == "rim"]
    assert len(rim) == 48
    for grasp in rim:
        assert abs(float(STANDING.outside_m(grasp.middle_m[None])[0])) < 0.003
        inner, outer = grasp.on_table(np.array([[0.0, sign * 0.5 * grasp.opening_m, 0.0] for sign in (-1, 1)]))
        assert STANDING.outside_m(inner[None])[0] < -0.015
        assert STANDING.outside_m(outer[None])[0] > 0.015


def test_a_hand_around_a_cup_has_the_axis_in_its_middle_and_room_on_either_side():
    around = [grasp for grasp in grasps(STANDING) if grasp.kind == "around"]
    assert len(around) == 24
    rim_m = STANDING.radius_m + STANDING.slope * STANDING.ends_m[1]
    for grasp in around:
        np.testing.assert_allclose(grasp.middle_m[:2], STANDING.centre_m[:2])
        assert grasp.opening_m == pytest.approx(2 * (rim_m + CLEARANCE_M))
        assert abs(grasp.axes[2, 1]) < 1e-9  # it closes level


def test_a_hand_across_a_lying_cup_closes_square_to_it():
    for grasp in grasps(LYING):
        assert grasp.kind == "across"
        assert abs(grasp.axes[:, 1] @ LYING.axis) < np.sin(0.31)
        along = LYING.along_m(grasp.middle_m[None])[0]
        assert LYING.ends_m[0] < along < LYING.ends_m[1]


def test_only_what_is_visible_counts_for_the_honest_contrast():
    points_m = box_points()
    boxes = grasps(STANDING, points_m=points_m, name="visible-only")
    assert {grasp.kind for grasp in boxes} == {"box"}
    straight = [grasp for grasp in boxes if grasp.approach[2] < -0.999]
    narrow = min(straight, key=lambda grasp: grasp.opening_m)
    assert narrow.opening_m == pytest.approx(0.04 + 2 * CLEARANCE_M, abs=0.006)
    assert abs(narrow.axes[1, 1]) > 0.99  # along y, where the box is 4 cm wide
    np.testing.assert_allclose(narrow.middle_m[:2], [0.13, 0.52], atol=0.003)


NOTHING = np.empty((0, 3))


def around_nothing(own_m, other_m=NOTHING, depth_m=9.0):
    """What a camera straight above sees: it looks down from 2 m, everywhere as deep as is said."""
    camera_from_table = np.diag([1.0, -1.0, -1.0, 1.0])
    camera_from_table[:3, 3] = [0.0, 0.5, 2.0]
    depth = np.full((100, 100), depth_m)
    K = np.array([[50.0, 0.0, 50.0], [0.0, 50.0, 50.0], [0.0, 0.0, 1.0]])
    return Surroundings(own_m, other_m, 0, np.full(depth.shape, -1), depth, K, camera_from_table)


TOP_DOWN = Grasp("box", np.array([0.0, 0.5, 0.05]), hand_axes(np.array([0, 0, -1.0]), np.array([0, 1.0, 0])), 0.08)
OWN = np.array([[0.0, 0.5, 0.05]])
FINGER_M = 0.5 * TOP_DOWN.opening_m + 0.5 * GRIPPER.finger_thickness_m


@pytest.mark.parametrize(
    ("beside_m", "is_free"),
    [
        ([0.0, FINGER_M, 0.05], False),  # in the finger
        ([0.0, -FINGER_M, 0.15], False),  # where the finger comes from
        ([0.0, FINGER_M, 0.02], True),  # below its tip
        ([0.0, FINGER_M + 0.02, 0.05], True),  # outside of the finger
        ([0.03, FINGER_M, 0.05], True),  # beside the finger
        ([0.0, 0.02, 0.05], False),  # between the fingers
        ([0.015, 0.06, 0.125], False),  # in the palm
        ([0.0, 0.03, 0.26], False),  # in the wrist
        ([0.0, 0.09, 0.26], True),
    ],
)
def test_a_hand_comes_only_where_nothing_that_is_seen_stands(beside_m, is_free):
    other_m = np.repeat([np.add([0.0, 0.5, 0.0], beside_m)], 5, axis=0)
    assert len(ranked([TOP_DOWN], around_nothing(OWN, other_m), GRIPPER)) == is_free


def test_a_hand_does_not_dip_into_the_table_nor_into_what_it_fetches():
    low = replace(TOP_DOWN, middle_m=np.array([0.0, 0.5, 0.01]))
    assert ranked([low], around_nothing(OWN), GRIPPER) == []
    in_palm = np.repeat([[0.0, 0.5, 0.13]], 9, axis=0)
    assert ranked([TOP_DOWN], around_nothing(in_palm), GRIPPER) == []


def test_hidden_space_and_a_former_failure_cost_and_the_cheapest_comes_first():
    (free,) = ranked([TOP_DOWN], around_nothing(OWN), GRIPPER)
    (hidden,) = ranked([TOP_DOWN], around_nothing(OWN, depth_m=1.5), GRIPPER)
    assert free.cost == 0.0
    assert hidden.cost == pytest.approx(1.0)
    (unseen,) = ranked([TOP_DOWN], around_nothing(OWN, depth_m=np.nan), GRIPPER)
    assert unseen.cost == pytest.approx(1.0)
    (again,) = ranked([TOP_DOWN], around_nothing(OWN), GRIPPER, failed=[TOP_DOWN])
    assert again.cost == pytest.approx(1.0)
    elsewhere = replace(TOP_DOWN, middle_m=np.array([0.0, 0.53, 0.05]), cost=0.3)
    order = ranked([TOP_DOWN, elsewhere], around_nothing(OWN), GRIPPER, failed=[TOP_DOWN])
    assert order[0].cost == pytest.approx(0.3)


def test_what_is_wider_than_the_hand_is_not_taken_around():
    narrow = replace(GRIPPER, stroke_m=0.07)
    assert {grasp.kind for grasp in grasps(STANDING, narrow)} == {"rim"}
    assert grasps(LYING, narrow) == []
