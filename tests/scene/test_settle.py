import mujoco
import numpy as np
import pytest

from halfseen.errors import SceneError
from halfseen.scene import Cup, Pose, Table, random_table
from halfseen.scene.poses import about_axis, compose
from halfseen.scene.room import TIMESTEP_S, cup_name, room_model
from halfseen.scene.settle import settle, smallest_gap_m
from halfseen.scene.table import TABLE_TOP_M
from halfseen.scene.xtion import xtion_at

TUMBLER = Cup(0.12, 0.04, 0.03)
MUG = Cup(0.09, 0.04, 0.038, handle_m=0.03)
LYING = about_axis((1.0, 0.0, 0.0), np.pi / 2)


def settled(cup: Cup, start: Pose) -> Pose:
    poses = settle([cup], [start])
    assert poses is not None
    return poses[0]


def moved_m(cups, world_from_cup, duration_s: float) -> float:
    """How far the farthest-moving cup goes when physics runs on [m]."""
    model = room_model(cups, world_from_cup, is_free=True)
    data = mujoco.MjData(model)
    for _ in range(round(duration_s / TIMESTEP_S)):
        mujoco.mj_step(model, data)
    ends = [data.body(cup_name(index)).xpos for index in range(len(cups))]
    starts = [pose.position_m for pose in world_from_cup]
    return float(np.max(np.linalg.norm(np.subtract(ends, starts), axis=1)))


@pytest.mark.parametrize("cup", [TUMBLER, MUG])
def test_a_standing_cup_stands_where_it_is_let_go(cup):
    end = settled(cup, Pose((0.1, -0.05, TABLE_TOP_M + 0.004)))
    assert end.position_m == pytest.approx((0.1, -0.05, TABLE_TOP_M), abs=2e-4)
    assert end.rotation[2, 2] > 0.9999


def test_a_lying_tumbler_rests_on_its_cone():
    end = settled(TUMBLER, Pose((0.0, 0.0, TABLE_TOP_M + 0.045), LYING))
    # The axis of a cone that lies dips from the wide mouth to the narrow base by the half angle of the cone.
    half_angle_rad = np.arctan((TUMBLER.rim_radius_m - TUMBLER.base_radius_m) / TUMBLER.height_m)
    assert np.arcsin(end.rotation[2, 2]) == pytest.approx(half_angle_rad, abs=0.01)
    base_m = TUMBLER.base_radius_m * np.cos(half_angle_rad)
    assert end.position_m[2] - TABLE_TOP_M == pytest.approx(base_m, abs=5e-4)


def test_a_mug_on_its_side_does_not_balance_on_its_handle():
    rolled = about_axis((0.0, 0.0, 1.0), np.deg2rad(-60))
    end = settled(MUG, Pose((0.0, 0.0, TABLE_TOP_M + 0.08), compose(rolled, LYING)))
    handle_tip_m = end.apply(np.array([[MUG.rim_radius_m + MUG.handle_m, 0.0, 0.045]]))[0]
    assert handle_tip_m[2] > TABLE_TOP_M - 1e-3
    assert moved_m([MUG], [end], 0.5) < 5e-4


@pytest.mark.parametrize(
    "seed", [0, 1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)]
)
def test_nothing_on_a_drawn_table_moves(seed):
    table = random_table(seed)
    assert moved_m(table.cups, table.world_from_cup, duration_s=0.5) < 5e-4


def test_gap_between_two_straight_cups():
    cup = Cup(0.1, 0.04, 0.04)
    poses = [Pose((0.0, 0.0, TABLE_TOP_M)), Pose((0.1, 0.0, TABLE_TOP_M))]
    assert smallest_gap_m([cup, cup], poses) == pytest.approx(0.02, abs=1e-4)
    assert smallest_gap_m([cup, cup], poses, beyond_m=0.01) == pytest.approx(0.01)
    with pytest.raises(SceneError, match="beyond_m"):
        smallest_gap_m([cup, cup], poses, beyond_m=0.0)


def test_fallen_means_off_the_vertical():
    poses = [Pose((0.2 * k, 0.0, 1.0), about_axis((0.0, 1.0, 0.0), np.deg2rad(k * 20))) for k in range(6)]
    table = Table((MUG,) * 6, tuple(poses), xtion_at(Pose((0.0, 0.0, 0.0))))
    assert table.is_fallen.tolist() == [False, False, False, False, True, True]
