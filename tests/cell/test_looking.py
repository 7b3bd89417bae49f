"""Looks into the live cell beside the view of the same table at rest."""

from dataclasses import replace

import numpy as np
import pytest

from halfseen.cell import Eye, LiveCell, Robot, cell_model
from halfseen.perception import perceive
from halfseen.scene import Camera, Cup, Pose, Surface, random_table
from halfseen.scene.camera import look_at
from halfseen.scene.table import TABLE_TOP_M, Table
from halfseen.scene.view import ideal_view, table_view
from halfseen.scene.xtion import XTION, xtion_at

ROBOT = Robot()


@pytest.fixture(scope="module")
def drawn():
    """A table, seen by a camera of a quarter of the rows and columns: rays are what takes long here."""
    table = random_table(5)
    fx, fy = table.camera.focal_px
    coarse = Camera(table.camera.world_from_camera, (fx / 4, fy / 4), (79.5, 59.5), 120, 160)
    return replace(table, camera=coarse)


@pytest.fixture(scope="module")
def cell(drawn):
    return LiveCell(cell_model(drawn.cups, drawn.world_from_cup), [ROBOT])


@pytest.fixture(scope="module")
def eye(cell, drawn):
    return Eye(cell, drawn.camera)


def alike(one, other):
    """Same bodies, depths and light in all pixels, but for rays that graze an edge."""
    same = (one.body == other.body) & (one.is_lit == other.is_lit)
    same &= np.isclose(one.depth_m, other.depth_m, atol=1e-9, equal_nan=True)
    return same.mean()


def test_seeing_what_may_have_changed_is_seeing_all_anew(cell, eye, drawn):
    assert alike(eye.view(), ideal_view(cell.model, drawn.camera, XTION.baseline_m, cell.data)) > 0.999


def test_cups_are_where_the_table_at_rest_has_them_and_the_robot_is_cut_out(cell, eye, drawn):
    seen = eye.look(np.random.default_rng(0))
    expected = table_view(drawn, XTION.baseline_m).labels
    view = eye.view()
    is_robot = view.body > cell.num_cups
    assert 30 < is_robot.sum() < 0.1 * is_robot.size
    assert np.isnan(seen.cloud.points_m[is_robot.ravel(), 2]).all()
    assert (seen.labels == expected)[~is_robot].mean() > 0.999


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2, 5])
def test_as_much_is_perceived_as_without_the_robot(seed):
    table, counts = random_table(seed), []
    for robots in ([ROBOT], []):
        cell = LiveCell(cell_model(table.cups, table.world_from_cup, robots=robots), robots)
        seen = Eye(cell, table.camera).look(np.random.default_rng(0))
        counts.append(len(perceive(seen.cloud).objects))
    assert counts[0] == counts[1] > 0


def test_the_same_seed_sees_the_same(eye):
    one, other = (eye.look(np.random.default_rng(4)).cloud for _ in range(2))
    np.testing.assert_array_equal(one.points_m, other.points_m)


def test_an_eye_that_knows_the_walls_sees_colour_and_the_same_depths(cell, eye, drawn):
    white, red = (238, 236, 230), (175, 60, 55)
    surfaces = [Surface(cup, red if index == 0 else white) for index, cup in enumerate(drawn.cups)]
    plain = eye.look(np.random.default_rng(4))
    coloured = Eye(cell, drawn.camera, surfaces=surfaces).look(np.random.default_rng(4))
    np.testing.assert_array_equal(plain.cloud.points_m, coloured.cloud.points_m)
    assert plain.cloud.colours is None
    reddish, greenish, _ = coloured.cloud.colours.astype(int).T
    is_red = (reddish - greenish > 40).reshape(plain.labels.shape)
    np.testing.assert_array_equal(is_red, plain.labels == 0)


def test_what_moved_is_seen_where_it_is(cell, eye, drawn):
    joint = cell.model.body("cup_0").jntadr[0]
    cell.data.qpos[cell.model.jnt_qposadr[joint] + 1] += 0.05
    cell.wait(0.2)
    moved = Table(drawn.cups, tuple(cell.cup(index) for index in range(cell.num_cups)), drawn.camera)
    now, expected = eye.view(), table_view(moved, XTION.baseline_m).labels
    assert alike(now, ideal_view(cell.model, drawn.camera, XTION.baseline_m, cell.data)) > 0.999
    shown = (now.body > 0) & (now.body <= cell.num_cups)
    assert (now.labels == expected)[shown].mean() > 0.999


def coarse(world_from_camera):
    """A camera of a quarter of the rows and columns."""
    fx, fy = xtion_at(world_from_camera).focal_px
    return Camera(world_from_camera, (fx / 4, fy / 4), (79.5, 59.5), 120, 160)


MUG = Cup(0.09, 0.042, 0.04, handle_m=0.03)
LYING = (2**-0.5, 2**-0.5, 0.0, 0.0)
IN_THE_RACK = Pose((0.40, 0.62, 0.55), LYING)
ON_THE_TABLE = Pose((0.0, 0.1, TABLE_TOP_M))


def held(robot):
    """Pose of a cup between the pads of a robot at home."""
    cell = LiveCell(cell_model([], [], [robot]), [robot])
    place = cell.data.site(robot.of("gripper/tcp")).xpos
    return Pose(tuple(map(float, place)), LYING)


FRONT = look_at(np.array([0.0, -0.9, 1.6]), np.array([0.0, 0.3, 0.7]))
LOW = look_at(np.array([0.0, -0.2, TABLE_TOP_M + 0.06]), np.array([0.0, 0.1, TABLE_TOP_M + 0.05]))


@pytest.mark.parametrize(
    ("poses", "robots", "camera"),
    [
        ([ON_THE_TABLE, Pose((0.1, 0.1, TABLE_TOP_M + 0.04), LYING), IN_THE_RACK], [ROBOT], FRONT),
        ([ON_THE_TABLE, Pose((1.5, 0.3, 1.0))], [], FRONT),
        ([ON_THE_TABLE, Pose((0.06, -0.2, TABLE_TOP_M)), Pose((0.0, -0.35, TABLE_TOP_M))], [ROBOT], LOW),
        ([], [ROBOT], FRONT),
        ([], [], FRONT),
    ],
    ids=["lying and in the rack", "beside the picture", "beside and behind the camera", "no cups", "nothing"],
)
def test_seen_as_by_rays_alone(poses, robots, camera):
    cell = LiveCell(cell_model([MUG] * len(poses), poses, robots), robots)
    now = Eye(cell, coarse(camera)).view()
    expected = ideal_view(cell.model, coarse(camera), XTION.baseline_m, cell.data)
    assert alike(now, expected) == 1.0
    np.testing.assert_allclose(now.incidence_cosine, expected.incidence_cosine, atol=1e-9)
    assert (now.body == 1).any() or not poses


def test_a_cup_in_the_hand_hides_it_and_is_hidden_as_by_rays_alone():
    cell = LiveCell(cell_model([MUG], [held(ROBOT)]), [ROBOT])
    now = Eye(cell, xtion_at(FRONT)).view()
    assert (now.body == 1).any()
    assert (now.body > 1).any()
    assert alike(now, ideal_view(cell.model, xtion_at(FRONT), XTION.baseline_m, cell.data)) > 0.9999
