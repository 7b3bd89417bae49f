"""Grasps close where the shape says; nothing that is seen stands in their way; hidden space costs."""

from dataclasses import replace

import numpy as np
import pytest

from halfseen.cell import Gripper
from halfseen.cell.grasps import CLEARANCE_M, FLOOR_M, GRASPING, Grasp, Surroundings, hand_axes, ranked, tips_m
from halfseen.perception.solids import Hull, Vessel
from halfseen.perception.view import SeenObject

GRIPPER = Gripper()
NARROW = replace(GRIPPER, stroke_m=0.07)
STANDING = Vessel(np.array([0.05, 0.6, 0.05]), np.array([0.0, 0.0, 1.0]), 0.035, 0.1, (-0.05, 0.05), 0.1)
LYING = Vessel(np.array([0.0, 0.7, 0.04]), np.array([0.6, 0.8, 0.0]), 0.038, 0.1, (-0.05, 0.05), 0.1)
CORNERS = np.meshgrid(*[np.linspace(0, size, 9) for size in (0.06, 0.04, 0.08)])
BOX_M = np.array(CORNERS).reshape(3, -1).T + np.array([0.1, 0.5, 0.0])


def grasps(solid, gripper=GRIPPER, points_m=BOX_M, name="completed", kind=None):
    """All grasps of an object, or those of a kind."""
    upright = isinstance(solid, Vessel) and solid.is_upright
    seen = SeenObject(0, np.zeros(3), 0.1, np.zeros(3), 0.0, 100, upright, np.arange(100), solid)
    found = GRASPING[name](seen, points_m, gripper)
    return [grasp for grasp in found if kind in (None, grasp.kind)]


@pytest.mark.parametrize("solid", [STANDING, LYING, Hull(BOX_M)])
def test_hands_are_right_handed_keep_off_the_table_and_open_no_wider_than_they_can(solid):
    assert grasps(solid)
    for grasp in grasps(solid):
        np.testing.assert_allclose(grasp.axes.T @ grasp.axes, np.eye(3), atol=1e-12)
        assert np.linalg.det(grasp.axes) > 0
        assert grasp.opening_m <= GRIPPER.stroke_m
        assert grasp.approach[2] < -0.5
        if grasp.kind in ("across", "box"):
            assert grasp.on_table(tips_m(grasp, GRIPPER))[:, 2].min() > FLOOR_M - 1e-9


def test_a_standing_cup_is_taken_at_its_rim_or_around_it_and_a_lying_one_across_and_square_to_it():
    rim, around = grasps(STANDING, kind="rim"), grasps(STANDING, kind="around")
    assert (len(rim), len(around)) == (48, 24)
    for grasp in rim:
        assert abs(float(STANDING.outside_m(grasp.middle_m[None])[0])) < 0.003
        inner, outer = grasp.on_table(np.array([[0.0, sign * 0.5 * grasp.opening_m, 0.0] for sign in (-1, 1)]))
        assert STANDING.outside_m(inner[None])[0] < -0.015
        assert STANDING.outside_m(outer[None])[0] > 0.015
    rim_m = STANDING.radius_m + STANDING.slope * STANDING.ends_m[1]
    for grasp in around:
        np.testing.assert_allclose(grasp.middle_m[:2], STANDING.centre_m[:2])
        assert grasp.opening_m == pytest.approx(2 * (rim_m + CLEARANCE_M))
        assert abs(grasp.axes[2, 1]) < 1e-9  # it closes level
    assert {grasp.kind for grasp in grasps(STANDING, NARROW)} == {"rim"}
    for grasp in grasps(LYING):
        assert grasp.kind == "across"
        assert abs(grasp.axes[:, 1] @ LYING.axis) < np.sin(0.31)
        assert LYING.ends_m[0] < LYING.along_m(grasp.middle_m[None])[0] < LYING.ends_m[1]
    assert grasps(LYING, NARROW) == []


def test_only_what_is_visible_counts_for_the_honest_contrast():
    boxes = grasps(STANDING, name="visible-only")
    assert {grasp.kind for grasp in boxes} == {"box"}
    narrow = min((grasp for grasp in boxes if grasp.approach[2] < -0.999), key=lambda grasp: grasp.opening_m)
    assert narrow.opening_m == pytest.approx(0.04 + 2 * CLEARANCE_M, abs=0.006)
    assert abs(narrow.axes[1, 1]) > 0.99  # along y, where the box is 4 cm wide
    np.testing.assert_allclose(narrow.middle_m[:2], [0.13, 0.52], atol=0.003)


TOP_DOWN = Grasp("box", np.array([0.0, 0.5, 0.05]), hand_axes(np.array([0, 0, -1.0]), np.array([0, 1.0, 0])), 0.08)
OWN, NOTHING = np.array([[0.0, 0.5, 0.05]]), np.empty((0, 3))
FINGER_M = 0.5 * TOP_DOWN.opening_m + 0.5 * GRIPPER.finger_thickness_m


def tried(grasps, own_m=OWN, other_m=NOTHING, depth_m=9.0, **known):
    """Grasps as ranked where a camera looks straight down from 2 m, everywhere as deep as is said."""
    camera_from_table = np.diag([1.0, -1.0, -1.0, 1.0])
    camera_from_table[:3, 3] = [0.0, 0.5, 2.0]
    depth = np.full((100, 100), depth_m)
    K = np.array([[50.0, 0.0, 50.0], [0.0, 50.0, 50.0], [0.0, 0.0, 1.0]])
    around = Surroundings(own_m, other_m, 0, np.full(depth.shape, -1), depth, K, camera_from_table)
    return ranked(grasps, around, GRIPPER, **known)


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
    assert len(tried([TOP_DOWN], other_m=other_m)) == is_free
    # It dips neither into the table nor into what it fetches.
    assert tried([replace(TOP_DOWN, middle_m=np.array([0.0, 0.5, 0.01]))]) == []
    assert tried([TOP_DOWN], own_m=np.repeat([[0.0, 0.5, 0.13]], 9, axis=0)) == []


def test_hidden_space_and_a_former_failure_cost_and_the_cheapest_comes_first():
    free, hidden, unseen, again = (
        tried([TOP_DOWN], **known)[0].cost
        for known in ({}, {"depth_m": 1.5}, {"depth_m": np.nan}, {"failed": [TOP_DOWN]})
    )
    assert free == 0.0
    assert (hidden, unseen, again) == pytest.approx((1.0, 1.0, 1.0))
    elsewhere = replace(TOP_DOWN, middle_m=np.array([0.0, 0.53, 0.05]), cost=0.3)
    assert tried([TOP_DOWN, elsewhere], failed=[TOP_DOWN])[0].cost == pytest.approx(0.3)
