"""Two arms at the ends of a table: mirror images that can touch one another, and spaces that hold every part."""

from typing import NamedTuple

import mujoco
import numpy as np
import pytest
from cells import CAMERA, FULL_CAMERA, HOMES, LEFT, ROBOTS, SLIM, live_pair, two_arm_cell
from scipy.spatial.transform import Rotation

from halfseen.cell.kinematics import Kinematics, line
from halfseen.cell.live_cell import Reserve
from halfseen.cell.model import PAIR
from halfseen.cell.space import MARGIN_M, Outline
from halfseen.errors import PlanError
from halfseen.scene.cups import draw_surface
from halfseen.scene.poses import Pose
from halfseen.scene.table import TABLE_TOP_M

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false


STAYS = np.zeros((0, 6))


@pytest.fixture(scope="module")
def model():
    return live_pair().model


@pytest.fixture(scope="module")
def parts(model):
    """Shapes of each arm."""
    names = [model.body(model.geom_bodyid[geom]).name for geom in range(model.ngeom)]
    return [np.flatnonzero([name.startswith(robot.of("")) for name in names]) for robot in ROBOTS]


def test_the_arms_are_mirror_images_that_wait_free_of_all_and_whose_parts_meet_those_of_the_other_alone(model, parts):
    hands_m, spaces = [], []
    for robot, home in zip(ROBOTS, HOMES, strict=True):
        kinematics = Kinematics(model, robot)
        kinematics.refuse_furniture([home])
        hands_m.append(np.array(kinematics.hand(home).position_m))
        spaces.append(Outline(model, robot).along(home, STAYS, below_m=0.15))
    np.testing.assert_allclose(hands_m[0] * [-1.0, 1.0, 1.0], hands_m[1], atol=2e-3)
    assert not spaces[0].meets(spaces[1], margin_m=0.2)
    kind, affinity = model.geom_contype, model.geom_conaffinity
    meets = (kind[:, None] & affinity) | (affinity[:, None] & kind) != 0
    assert meets[np.ix_(*parts)].all()
    assert not any(meets[np.ix_(own, own)].any() for own in parts)


def comes(kinematics, home, place_m, down_m):
    """Whether the hand comes over a place, and straight down by so much, pointing down."""
    for turn_rad in np.array([0.0, 0.5, 0.25, -0.25]) * np.pi:
        above = Pose(tuple(place_m), (0.0, np.cos(0.5 * turn_rad), np.sin(0.5 * turn_rad), 0.0))
        angles = kinematics.solve(above, home)
        if angles is None:
            continue
        try:
            line(kinematics, angles, above, np.subtract(place_m, (0.0, 0.0, down_m)))
        except PlanError:
            continue
        return True
    return False


@pytest.mark.parametrize("arm", [0, 1], ids=["left", "right"])
def test_an_arm_reaches_every_slot_of_its_rack_and_its_half_of_the_table(model, arm):
    station, home, kinematics = PAIR[arm], HOMES[arm], Kinematics(model, ROBOTS[arm])
    assert len(station.rack.slots_m) == 9
    assert all(comes(kinematics, home, np.add(slot_m, [0.0, 0.0, 0.24]), 0.15) for slot_m in station.rack.slots_m)
    base_m, side = np.array(station.robot.base_m[:2]), np.sign(station.robot.base_m[0])
    own = [np.array((side * x_m, y_m)) for x_m in (0.3, 0.15, 0.0) for y_m in (-0.2, 0.0, 0.2)]
    assert all(np.linalg.norm(place_m - base_m) <= station.reach_m for place_m in own)
    assert all(comes(kinematics, home, (*place_m, TABLE_TOP_M + 0.26), 0.18) for place_m in own)


def distance_m(model, parts, angles):
    """Between the two arms, by MuJoCo, part by part; the oracle."""
    data = mujoco.MjData(model)
    for robot, of_arm in zip(ROBOTS, angles, strict=True):
        for name, angle in zip(robot.joint_names, of_arm, strict=True):
            data.joint(name).qpos = angle
        for name in robot.slide_names:
            data.joint(name).qpos = 0.5 * robot.gripper.stroke_m
    mujoco.mj_forward(model, data)
    return min(mujoco.mj_geomDistance(model, data, one, other, 1.0, None) for one in parts[0] for other in parts[1])


def drawn(model, rng, arm, num):
    """Angles with the hand over the middle of the table, anyhow."""
    kinematics, found = Kinematics(model, ROBOTS[arm]), []
    while len(found) < num:
        place_m = rng.uniform((-0.15, -0.15, 0.80), (0.15, 0.15, 1.05)).tolist()
        tilted = Rotation.from_euler("xyz", [np.pi, *rng.normal(0.0, 0.4, 2)]).as_quat(scalar_first=True).tolist()
        angles = kinematics.solve(Pose(tuple(place_m), tuple(tilted)), HOMES[arm])
        found += [] if angles is None else [angles]
    return found


@pytest.mark.slow
def test_spaces_that_do_not_meet_are_of_arms_that_keep_their_distance(model, parts):
    outlines, rng, near_m = [Outline(model, robot) for robot in ROBOTS], np.random.default_rng(0), []
    for angles in zip(drawn(model, rng, 0, 80), drawn(model, rng, 1, 80), strict=True):
        one, other = (outline.along(place, STAYS) for outline, place in zip(outlines, angles, strict=True))
        apart_m = distance_m(model, parts, angles)
        if not one.meets(other):
            assert apart_m > 0.5 * MARGIN_M
        elif apart_m < 0.3:
            near_m.append(apart_m)
    assert near_m, "some of the arms come near"
    # Spheres are larger than what they hold, but not by much: a finger is much thinner.
    assert np.max(near_m) < MARGIN_M + 0.08


def test_a_way_takes_the_space_of_all_its_places_and_between_and_what_is_held_takes_it_below_the_hand(model):
    outline, begin = Outline(model, LEFT), HOMES[0]
    way = begin + np.random.default_rng(1).normal(0.0, 0.8, (2, 6))
    space = outline.along(begin, way)
    np.testing.assert_array_equal(space.places_rad[[0, -1]], [begin, way[-1]])
    assert np.abs(np.diff(space.places_rad, axis=0)).max() <= 0.05 + 1e-12
    assert np.abs(space.places_rad - 0.5 * (begin + way[0])).max(axis=1).min() < 0.05
    assert len(space.after(3).places_rad) == len(space.places_rad) - 3
    hand_m = np.array(Kinematics(model, LEFT).hand(begin).position_m)
    empty, full = (outline.along(begin, STAYS, below_m) for below_m in (0.0, 0.12))
    assert not empty.is_held.any()
    held_m = full.middles_m[0, full.is_held]
    np.testing.assert_allclose(held_m[:, :2], np.tile(hand_m[:2], (len(held_m), 1)), atol=1e-9)
    assert held_m[:, 2].max() == pytest.approx(hand_m[2])
    # With its radius the lowest sphere reaches at least as far as what is held.
    assert held_m[:, 2].min() - 0.065 <= hand_m[2] - 0.12


STOOD_M = (-0.26, 0.0, TABLE_TOP_M)


def looked_at(camera):
    surface = draw_surface(SLIM, True, np.random.default_rng(2))
    cell = two_arm_cell(STOOD_M[:2], surfaces=[surface], camera=camera)
    cell.look()
    return cell


@pytest.fixture
def cell():
    return looked_at(CAMERA)


class Asked(NamedTuple):
    """A reservation that was granted or refused for good, when it was asked for, and where the arm stood."""

    command: Reserve
    time_s: float
    angles_rad: np.ndarray


def carried_out(cell, activity, refused):
    """Carry out an activity, and answer no to the reservations whose numbers are in `refused`.

    What is only tried is granted the first time, and no reservation of its own where that is refused: the patient one
    after it is. Gives what came of it, and the reservations.
    """
    live, asked = cell.cell, []
    command, answer = next(activity), True
    while True:
        live.do(LEFT, command)
        if isinstance(command, Reserve):
            number = len(asked)
            answer = number not in refused if command.is_patient or 0 not in refused else False
            if command.is_patient or answer:
                asked.append(Asked(command, live.time_s, live.angles_rad(LEFT)))
        try:
            command, answer = activity.send(answer), True
        except StopIteration as ended:
            return ended.value, asked


def assert_home_with_nothing_in_hand(cell):
    assert cell.in_hand == {}
    np.testing.assert_allclose(cell.cell.angles_rad(LEFT), LEFT.home_rad, atol=0.02)


@pytest.mark.slow
def test_whose_hand_closed_on_nothing_goes_home_all_the_same(cell, monkeypatch):
    monkeypatch.setattr("halfseen.cell.fetching.feels", lambda *_: False)
    attempt, asked = carried_out(cell, cell.washing(0, 0), {1})
    assert len(asked) == 2
    np.testing.assert_array_equal(asked[1].command.way, asked[1].command.back)
    assert not attempt.is_held
    assert len(cell.memory.objects[0].failed) == 1
    assert_home_with_nothing_in_hand(cell)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("work", "phase", "is_held", "lifts", "num_glances", "why"),
    [
        ("washing", 0, False, 0, 1, "another arm was in the way"),
        ("lifting", 0, False, 0, 1, "another arm was in the way"),
        ("washing", 1, False, 0, 1, "gave way"),
        ("lifting", 1, True, 0, 1, ""),
        ("lifting", 2, True, 1, 2, ""),
        ("lifting", 3, True, 1, 3, ""),
    ],
)
def test_who_gives_way_puts_back_what_it_holds_by_the_way_that_it_reserved_and_what_was_shown_counts(
    cell, work, phase, is_held, lifts, num_glances, why
):
    known, gone = cell.memory.objects[0], []
    cell.cell.watches.append(lambda live: gone.append((live.time_s, live.angles_rad(LEFT))))
    attempt, asked = carried_out(cell, getattr(cell, work)(0, 0), {phase})
    # The way back was granted with the answer: nothing more is asked for.
    assert len(asked) == phase + 1
    assert (attempt.is_held, known.lifts) == (is_held, lifts)
    assert why in attempt.reason
    # Where the grasp held, that is what a law of grasping is to learn.
    assert [trial.is_held for trial in known.trials] == [True] * (phase > 0)
    assert len(known.glances) <= num_glances
    last = asked[phase]
    if phase == 0:
        assert (attempt.kind, attempt.duration_s, known.failed) == (None, 0.0, [])
    elif phase == 3:
        # Its way back is its way home: no answer leads elsewhere.
        np.testing.assert_array_equal(last.command.way, last.command.back)
    else:
        places_rad = Outline(cell.cell.model, LEFT).along(last.angles_rad, last.command.back).places_rad
        passed = [angles for time_s, angles in gone if time_s > last.time_s]
        assert len(passed) > 100
        # Servos are a little behind, and cut corners by as much.
        assert max(np.abs(places_rad - angles).max(axis=1).min() for angles in passed) < 0.10
    assert_home_with_nothing_in_hand(cell)
    cup = cell.cell.cup(0)
    np.testing.assert_allclose(cup.position_m, STOOD_M, atol=0.02)
    assert cup.rotation[2, 2] > 0.99
    assert not known.is_racked
    if (work, phase) == ("washing", 1):
        again, _ = carried_out(cell, cell.washing(0, 0), set())
        assert again.is_held
        assert known.is_racked


@pytest.mark.slow
def test_what_is_put_back_is_the_same_object_to_whoever_looks_meanwhile():
    """The other arm decides, and so looks, while this one has opened its hand and is on its way home."""
    cell = looked_at(FULL_CAMERA)
    known, seen = cell.memory.objects[0], []
    cell.cell.watches.append(lambda live: seen.append(cell.look()) if round(live.time_s, 2) % 0.5 == 0 else None)
    carried_out(cell, cell.lifting(0, 0), set())
    assert len(seen) > 10
    cell.look()
    assert cell.memory.objects == [known]
    assert known.seen is not None
    assert not known.is_lost
