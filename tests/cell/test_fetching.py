"""From a look to a cup in the rack, in physics; and what a cell does when something stops it."""

import numpy as np
import pytest

from halfseen.cell.grasps import Grasp, hand_axes
from halfseen.cell.kinematics import Kinematics
from halfseen.cell.model import SLOT_M, Rack, Robot, cell_model
from halfseen.cell.planning import plan
from halfseen.cell.stops import EMERGENCY_STOP, SENSOR_LOST, TIME_OUT, StoppedError, Stops
from halfseen.cell.workcell import Errors, Workcell
from halfseen.errors import PlanError
from halfseen.scene import random_table
from halfseen.scene.camera import look_at
from halfseen.scene.cups import Cup
from halfseen.scene.poses import Pose
from halfseen.scene.table import TABLE_TOP_M, Table
from halfseen.scene.xtion import xtion_at

ROBOT = Robot()
HOME = np.array(ROBOT.home_rad)
CAMERA = xtion_at(look_at(np.array([0.0, -0.78, 1.24]), np.array([0.0, 0.0, TABLE_TOP_M])))
WORLD_FROM_TABLE = np.eye(4)
WORLD_FROM_TABLE[2, 3] = TABLE_TOP_M
DOWN = hand_axes(np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]))


def workcell(seed=0, **options):
    """Two cups, one of which hides a part of the other."""
    cups = (Cup(0.10, 0.040, 0.034), Cup(0.09, 0.042, 0.036))
    poses = (Pose((0.0, -0.02, TABLE_TOP_M)), Pose((0.02, 0.10, TABLE_TOP_M)))
    return Workcell(Table(cups, poses, CAMERA), np.random.default_rng(seed), **options)


@pytest.fixture(scope="module")
def kinematics():
    return Kinematics(cell_model([], []), ROBOT)


def test_a_plan_passes_through_the_places_that_its_grasp_asks_for(kinematics):
    grasp = Grasp("box", np.array([0.05, -0.02, 0.06]), DOWN, 0.1)
    found = plan([grasp], WORLD_FROM_TABLE, kinematics, HOME, np.random.default_rng(0))
    held = np.array([0.05, -0.02, TABLE_TOP_M + 0.06])
    for angles, up_m in ((found.hover[-1], 0.10), (found.approach[-1], 0.0), (found.lift[-1], 0.20)):
        pose = kinematics.hand(angles)
        np.testing.assert_allclose(pose.position_m, np.add(held, [0.0, 0.0, up_m]), atol=2e-3)
        np.testing.assert_allclose(np.abs(pose.rotation), np.abs(DOWN), atol=1e-2)
    np.testing.assert_allclose(found.held.position_m, held)


def test_a_grasp_out_of_reach_or_through_furniture_says_so(kinematics):
    far = Grasp("box", np.array([0.0, -0.9, 0.06]), DOWN, 0.1)
    with pytest.raises(PlanError, match=r"of 1 that were tried the best: \(0\.000, -0\.900, .* out of reach"):
        plan([far, far], WORLD_FROM_TABLE, kinematics, HOME, np.random.default_rng(0))
    low = Grasp("box", np.array([0.05, -0.02, -0.02]), DOWN, 0.1)
    with pytest.raises(PlanError, match="would touch furniture"):
        plan([low], WORLD_FROM_TABLE, kinematics, HOME, np.random.default_rng(0))
    with pytest.raises(PlanError, match="no grasp is free"):
        plan([], WORLD_FROM_TABLE, kinematics, HOME, np.random.default_rng(0))


def test_a_cup_is_lifted_and_stands_where_it_was_then_goes_into_the_rack_and_stays_forgotten():
    cell = workcell()
    assert len(cell.look().objects) == 2
    front = int(np.argmin([known.seen.occlusion for known in cell.memory.objects]))
    before = cell.cell.cup(0).position_m
    lifted = cell.lift(front)
    assert lifted.is_held
    assert lifted.kind == "around"
    assert 4.0 < lifted.duration_s < 12.0
    np.testing.assert_allclose(cell.cell.cup(0).position_m, before, atol=0.01)
    cell.look()
    assert [known.lifts for known in cell.memory.objects] == [1 - front, front]
    assert cell.wash(front).is_held
    assert cell.rack.holds(np.array(cell.cell.cup(0).position_m))
    assert not cell.rack.holds(np.array(cell.cell.cup(1).position_m))
    assert len(cell.look().objects) == 1
    behind = cell.memory.objects[1 - front]
    assert behind.seen is not None
    assert behind.seen.occlusion < 0.02
    assert cell.memory.objects[front].is_gone


@pytest.mark.parametrize(
    ("stops", "cause"),
    [
        (Stops(limit_s=3.0, force_n=1e9, camera_lost_per_s=0.0), TIME_OUT),
        (Stops(limit_s=1e9, force_n=5.0, camera_lost_per_s=0.0), EMERGENCY_STOP),
        (Stops(limit_s=1e9, force_n=1e9, camera_lost_per_s=1.0), SENSOR_LOST),
    ],
)
def test_a_cell_stops_with_its_cause(stops, cause):
    cell = workcell(stops=stops)
    cell.look()
    with pytest.raises(StoppedError, match=cause):
        cell.lift(0)


@pytest.mark.slow
@pytest.mark.parametrize("grasping", ["completed", "visible-only"])
def test_most_attempts_on_random_tables_hold_and_completed_shapes_no_less(grasping):
    held = []
    for seed in range(60, 64):
        cell = Workcell(random_table(seed), np.random.default_rng(seed), grasping=grasping)
        cell.look()
        for number in range(len(cell.memory.objects)):
            held.append(cell.memory.objects[number].seen is not None and cell.lift(number).is_held)
            cell.look()
    print(f"{grasping}: {np.mean(held):.2f} of {len(held)} held")
    assert np.mean(held) > {"completed": 0.85, "visible-only": 0.6}[grasping]


@pytest.mark.slow
def test_washing_until_nothing_is_left_fills_the_rack():
    num_cups, num_racked = 0, 0
    for seed in (70, 71):
        table = random_table(seed)
        cell = Workcell(table, np.random.default_rng(seed), errors=Errors())
        for _ in range(2 * table.num_cups):
            cell.look()
            there = [k for k, known in enumerate(cell.memory.objects) if known.seen is not None]
            if not there:
                break
            cell.wash(min(there, key=lambda k: (len(cell.memory.objects[k].failed), k)))
        num_cups += table.num_cups
        num_racked += sum(cell.rack.holds(np.array(cell.cell.cup(k).position_m)) for k in range(table.num_cups))
    print(f"{num_racked} of {num_cups} cups in the rack")
    assert num_racked >= 0.9 * num_cups


def test_slots_lie_in_the_rack_apart_from_one_another():
    rack = Rack()
    slots_m = rack.slots_m
    apart_m = np.linalg.norm(slots_m[:, None] - slots_m[None], axis=2) + np.eye(len(slots_m))
    assert len(slots_m) == 12
    assert apart_m.min() >= SLOT_M
    assert all(rack.holds(slot) for slot in slots_m)
    assert not rack.holds(np.array([0.0, 0.0, TABLE_TOP_M]))
