"""One arm: where its hand comes, lines, schedules and plans, what it grips, shows and puts away; and grasps.

Grasps close where the shape says; nothing that is seen stands in their way; hidden space costs.
"""

from dataclasses import replace

import numpy as np
import pytest
from cells import CUP, DOWN, DOWN_AXES, HOME, MUG, ROBOT, WORLD_FROM_TABLE, standing

from halfseen.cell.fetching import NUM_SIDES, SHOWN_AT_M, is_in_hand, turned
from halfseen.cell.grasps import CLEARANCE_M, FLOOR_M, GRASPING, Grasp, Surroundings, hand_axes, ranked, tips_m
from halfseen.cell.gripper import Gripper
from halfseen.cell.kinematics import NEAR_M, Kinematics, line, schedule
from halfseen.cell.live_cell import Grip, LiveCell, Move
from halfseen.cell.model import SLOT_M, MountedArm, Rack, cell_model
from halfseen.cell.planning import plans
from halfseen.errors import PlanError, SceneError
from halfseen.perception.solids import Hull, Vessel
from halfseen.perception.view import SeenObject
from halfseen.scene.poses import Pose
from halfseen.scene.rays import UNSEEN_GROUP
from halfseen.scene.table import TABLE_TOP_M
from halfseen.scene.view import room_spec

SPEEDS = ROBOT.arm.speeds_rad_s


@pytest.fixture(scope="module")
def kinematics():
    return Kinematics(cell_model([], []), ROBOT)


def rng_of(seed=0):
    return np.random.default_rng(seed)


def angles_of(rng):
    return np.array([rng.uniform(-3, 3), rng.uniform(1.5, 4.5), rng.uniform(0.6, 5.0), *rng.uniform(-3, 3, size=3)])


def apart(one, other):
    """Between two poses: [m], and the angle [rad]."""
    turn = abs(float(np.dot(one.quaternion, other.quaternion)))
    return np.linalg.norm(np.subtract(one.position_m, other.position_m)), 2 * np.arccos(min(1.0, turn))


@pytest.mark.slow
def test_where_some_angles_bring_the_hand_angles_are_found(kinematics):
    rng = rng_of()
    for _ in range(30):
        truth = angles_of(rng)
        target = kinematics.hand(truth)
        found = kinematics.solve_from(target, [angles_of(rng) for _ in range(8)], truth)
        assert found is not None
        distance, angle = apart(kinematics.hand(found), target)
        assert distance < NEAR_M
        assert angle < 4e-3
        assert ((found >= kinematics.limits_rad[:, 0]) & (found <= kinematics.limits_rad[:, 1])).all()
        assert (np.abs(found - truth)[kinematics.is_endless] <= np.pi + 1e-9).all()


@pytest.mark.slow
def test_most_of_the_table_is_in_reach_from_above_and_what_is_far_away_is_not(kinematics):
    rng = rng_of(2)
    begins = [angles_of(rng) for _ in range(8)]
    places = [(x, y, 0.8) for x in np.linspace(-0.35, 0.35, 5) for y in np.linspace(-0.25, 0.25, 4)]
    found = [kinematics.solve_from(Pose(place, DOWN), begins, begins[0]) is not None for place in places]
    assert np.mean(found) >= 0.85
    assert kinematics.solve_from(Pose((0.0, -1.5, 0.8), DOWN), begins[:4], begins[0]) is None


def test_endless_joints_take_the_nearest_turn(kinematics):
    angles = np.array([4.0, 3.0, 2.0, -4.0, 7.0, 0.1])
    near = kinematics.nearest_turn(angles, np.zeros(6))
    np.testing.assert_allclose(near, [4.0 - 2 * np.pi, 3.0, 2.0, -4.0 + 2 * np.pi, 7.0 - 2 * np.pi, 0.1])
    np.testing.assert_allclose(kinematics.hand(near).position_m, kinematics.hand(angles).position_m, atol=1e-12)


def test_a_line_is_straight_does_not_turn_the_hand_and_says_where_it_breaks_off(kinematics):
    begin = kinematics.hand(HOME)
    end_m = np.add(begin.position_m, [0.1, -0.05, -0.15])
    way = line(kinematics, HOME, begin, end_m)
    toward = (end_m - begin.position_m) / np.linalg.norm(end_m - begin.position_m)
    for angles in way:
        pose = kinematics.hand(angles)
        gone = np.subtract(pose.position_m, begin.position_m)
        assert np.linalg.norm(gone - (gone @ toward) * toward) < 1e-3
        assert abs(np.dot(pose.quaternion, begin.quaternion)) > 1 - 1e-5
    np.testing.assert_allclose(kinematics.hand(way[-1]).position_m, end_m, atol=1e-3)
    broken = r"the line to \(-0\.4.., -1\.5.., 0\.9..\) m breaks off at .* approach from another"
    with pytest.raises(PlanError, match=broken):
        line(kinematics, HOME, begin, np.add(begin.position_m, [0.0, -2.1, 0.0]))


@pytest.mark.parametrize("turn", [1e-3, 0.05, 1.0])
def test_a_schedule_begins_and_ends_at_rest_and_keeps_to_the_speeds(turn):
    way = HOME + turn * np.array([[0.5, 0.2, 0, 0, 0, 0], [1.0, -1.0, 0.5, 0.3, 0, -1.0]])
    planned = schedule(HOME, way, SPEEDS)
    times = np.linspace(0.0, planned.duration_s, 2001)
    angles = planned.at(times)
    np.testing.assert_allclose(angles[[0, -1]], [HOME, way[-1]], atol=1e-12)
    speed = np.diff(angles, axis=0) / times[1]
    assert (np.abs(speed) <= SPEEDS * 1.001).all()
    assert np.abs(speed[[0, -1]]).max() < 0.02 * SPEEDS.max()


def box(x_m, y_m, z_m):
    return Grasp("box", np.array([x_m, y_m, z_m]), DOWN_AXES, 0.1)


def test_a_plan_passes_through_the_places_that_its_grasp_asks_for(kinematics):
    found = next(plans([box(0.05, -0.02, 0.06)], WORLD_FROM_TABLE, kinematics, HOME, rng_of()))
    held = np.array([0.05, -0.02, TABLE_TOP_M + 0.06])
    for angles, up_m in ((found.hover[-1], 0.10), (found.approach[-1], 0.0), (found.lift[-1], 0.20)):
        pose = kinematics.hand(angles)
        np.testing.assert_allclose(pose.position_m, np.add(held, [0.0, 0.0, up_m]), atol=2e-3)
        np.testing.assert_allclose(np.abs(pose.rotation), np.abs(DOWN_AXES), atol=1e-2)
    np.testing.assert_allclose(found.held.position_m, held)


@pytest.mark.parametrize(
    ("grasps", "message"),
    [
        ([box(0.0, -0.9, 0.06)] * 2, r"the best of 1 tried: \(0\.000, -0\.900, .* out of reach"),
        ([box(0.05, -0.02, -0.02)], "would touch furniture"),
        ([], "every grasp is blocked"),
    ],
)
def test_a_grasp_out_of_reach_or_through_furniture_says_so(kinematics, grasps, message):
    with pytest.raises(PlanError, match=message):
        next(plans(grasps, WORLD_FROM_TABLE, kinematics, HOME, rng_of()))


def test_fingers_open_and_close_alike_and_cups_and_arm_stay_where_they_are():
    places = (0.0, 0.0), (0.2, 0.1)
    cell = LiveCell(cell_model([CUP, MUG], standing(*places)), [ROBOT])
    for wanted in (Gripper().stroke_m, 0.0):
        cell.do(ROBOT, Grip(wanted, 1.0))
        left, right = (cell.data.geom(ROBOT.of(f"gripper/pad_{side}")).xpos for side in ("left", "right"))
        assert np.linalg.norm(left - right) - Gripper().pad_thickness_m == pytest.approx(wanted, abs=1e-3)
    for number, place in enumerate(places):
        np.testing.assert_allclose(cell.cup(number).position_m, [*place, TABLE_TOP_M], atol=2e-3)
    np.testing.assert_allclose(cell.angles_rad(ROBOT), HOME, atol=1e-4)


def test_a_cup_is_shown_from_two_opposite_sides_and_what_is_held_is_reported_from_what_stands_below():
    cell = LiveCell(cell_model([], []), [ROBOT])
    kinematics, closing = cell.kinematics[ROBOT.name], []
    grasp = Grasp("around", np.array([0.05, -0.02, 0.08]), DOWN_AXES, 0.1)
    done = next(plans([grasp], WORLD_FROM_TABLE, kinematics, HOME, rng_of()))
    cell.do(ROBOT, Move(done.lift))

    def look_at(side):
        hand = kinematics.hand(cell.angles_rad(ROBOT))
        assert side == len(closing)
        np.testing.assert_allclose(hand.position_m, SHOWN_AT_M, atol=0.01)
        closing.append(hand.rotation[:, 1])

    cell.carry_out(ROBOT, turned(cell, ROBOT, done, rng_of(1), look_at))
    assert len(closing) == NUM_SIDES
    np.testing.assert_allclose(closing[0], -closing[1], atol=0.05)
    np.testing.assert_allclose(cell.angles_rad(ROBOT), done.lift[-1], atol=0.05)
    # It reaches as far below the hand as it stood above the table.
    beside_m = [[0.0, 0.0, 0.0], [0.05, 0.0, -0.08], [0.0, 0.0, -0.11], [0.13, 0.0, 0.0], [0.0, 0.0, 0.1], [np.nan] * 3]
    held = is_in_hand(np.add(SHOWN_AT_M, beside_m), Pose(SHOWN_AT_M, DOWN), done)
    assert held.tolist() == [True, True, False, False, False, False]
    # The tallest cup on the table stays below the lowest that is held at its rim.
    assert SHOWN_AT_M[2] - 0.15 > TABLE_TOP_M + 0.145


def test_slots_lie_in_the_rack_apart_from_one_another_and_walls_weigh_nothing_and_are_not_seen():
    rack = Rack()
    apart_m = np.linalg.norm(rack.slots_m[:, None] - rack.slots_m[None], axis=2) + np.eye(len(rack.slots_m))
    assert len(rack.slots_m) == 12
    assert apart_m.min() >= SLOT_M
    assert all(rack.holds(slot) for slot in rack.slots_m)
    assert not rack.holds(np.array([0.0, 0.0, TABLE_TOP_M]))
    mug = [MUG], standing((0.0, 0.0))
    bare, plain = cell_model(*mug, robots=()), room_spec(*mug, is_free=True).compile()
    assert (bare.geom_group == UNSEEN_GROUP).sum() == 16 + 1 + 5
    assert bare.body("cup_0").mass == plain.body("cup_0").mass
    np.testing.assert_array_equal(bare.body("cup_0").inertia, plain.body("cup_0").inertia)


@pytest.mark.parametrize(
    ("cups", "options", "message"),
    [
        ([CUP], {}, "1 cups and 0 poses; give one for every cup"),
        ([CUP], {"world_from_cup": standing((0.0, 0.0)), "frictions": [0.5] * 2}, "1 cups and 2 frictions; give one"),
        ([], {"robots": [MountedArm("one")] * 2}, "2 robots are called 'one'; give each a name of its own"),
    ],
)
def test_what_does_not_fit_together_is_refused(cups, options, message):
    with pytest.raises(SceneError, match=message):
        cell_model(cups, **{"world_from_cup": [], **options})


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
        assert LYING.ends_m[0] < LYING.outside_along_m(grasp.middle_m[None])[1][0] < LYING.ends_m[1]
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
