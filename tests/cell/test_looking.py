"""Looks into the live cell: beside rays alone, past arms, and what a look does not find again."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from dataclasses import replace
from functools import lru_cache

import mujoco
import numpy as np
import pytest
from cells import CAMERA, DOWN_AXES, HOMES, LEFT, MUG, ROBOT, one_arm_cell, over, standing, two_arm_cell

from halfseen.cell import CellCamera, LiveCell, cell_model
from halfseen.cell.camera import perceived_whole
from halfseen.cell.grasps import Grasp
from halfseen.cell.memory import Memory, has_vanished
from halfseen.cell.planning import FetchPlan
from halfseen.cell.table_state import Belief, no_grip, rows_of, state_of
from halfseen.perception import perceive
from halfseen.scene import Camera, Cup, Pose, Surface, random_table, read_table
from halfseen.scene.table import TABLE_TOP_M, Table, look_at
from halfseen.scene.view import Sight, cup_name, ideal_view, table_view
from halfseen.scene.xtion import XTION, xtion_at
from halfseen.world import WorldConfig


def coarse(camera):
    """A camera of a quarter of the rows and columns: rays are what takes long here."""
    fx, fy = camera.focal_px
    return Camera(camera.world_from_camera, (fx / 4, fy / 4), (79.5, 59.5), 120, 160)


@pytest.fixture(scope="module")
def drawn():
    table = read_table(5)
    return replace(table, camera=coarse(table.camera))


@pytest.fixture(scope="module")
def cell(drawn):
    return LiveCell(cell_model(drawn.cups, drawn.world_from_cup), [ROBOT])


@pytest.fixture(scope="module")
def eye(cell, drawn):
    return CellCamera(cell, drawn.camera)


def alike(one, other):
    """Same bodies, depths and light in all pixels, but for rays that graze an edge."""
    same = (one.body == other.body) & (one.is_lit == other.is_lit)
    same &= np.isclose(one.depth_m, other.depth_m, atol=1e-9, equal_nan=True)
    return same


def by_rays(cell, camera):
    return ideal_view(Sight(cell.data, camera, XTION.baseline_m))


def test_cups_are_where_the_table_at_rest_has_them_and_the_robot_is_cut_out(cell, eye, drawn):
    seen, view, expected = eye.look(np.random.default_rng(0)), eye.view(), table_view(drawn, XTION.baseline_m).labels
    assert alike(view, by_rays(cell, drawn.camera)).mean() > 0.999
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
        counts.append(len(perceive(CellCamera(cell, table.camera).look(np.random.default_rng(0)).cloud).objects))
    assert counts[0] == counts[1] > 0


def test_the_same_seed_sees_the_same_and_who_knows_the_walls_sees_their_colour(cell, eye, drawn):
    white, red = (238, 236, 230), (175, 60, 55)
    surfaces = [Surface(cup, red if index == 0 else white) for index, cup in enumerate(drawn.cups)]
    plain, again, coloured = (
        each.look(np.random.default_rng(4)) for each in (eye, eye, CellCamera(cell, drawn.camera, surfaces=surfaces))
    )
    for other in (again, coloured):
        np.testing.assert_array_equal(plain.cloud.points_m, other.cloud.points_m)
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
    assert alike(now, by_rays(cell, drawn.camera)).mean() > 0.999
    shown = (now.body > 0) & (now.body <= cell.num_cups)
    assert (now.labels == expected)[shown].mean() > 0.999


LYING = (2**-0.5, 2**-0.5, 0.0, 0.0)
ON_THE_TABLE = Pose((0.0, 0.1, TABLE_TOP_M))
IN_THE_RACK, OUTSIDE = Pose((0.40, 0.62, 0.55), LYING), Pose((1.5, 0.3, 1.0))
HAND_M = LiveCell(cell_model([], [], [ROBOT]), [ROBOT]).data.site(ROBOT.of("gripper/tcp")).xpos
IN_THE_HAND = Pose(tuple(map(float, HAND_M)), LYING)
FULL = xtion_at(look_at(np.array([0.0, -0.9, 1.6]), np.array([0.0, 0.3, 0.7])))
FRONT = coarse(FULL)
LOW = coarse(xtion_at(look_at(np.array([0.0, -0.2, TABLE_TOP_M + 0.06]), np.array([0.0, 0.1, TABLE_TOP_M + 0.05]))))


@pytest.mark.parametrize(
    ("poses", "robots", "camera", "least"),
    [
        ([ON_THE_TABLE, Pose((0.1, 0.1, TABLE_TOP_M + 0.04), LYING), IN_THE_RACK], [ROBOT], FRONT, 1.0),
        ([ON_THE_TABLE, OUTSIDE], [], FRONT, 1.0),
        ([ON_THE_TABLE, *standing((0.06, -0.2), (0.0, -0.35))], [ROBOT], LOW, 1.0),
        ([IN_THE_HAND], [ROBOT], FULL, 0.9999),
        ([], [ROBOT], FRONT, 1.0),
        ([], [], FRONT, 1.0),
    ],
    ids=["lying, and in the rack", "outside", "beside and behind the camera", "in the hand", "no cups", "nothing"],
)
def test_seen_as_by_rays_alone(poses, robots, camera, least):
    cell = LiveCell(cell_model([MUG] * len(poses), poses, robots), robots)
    now, expected = CellCamera(cell, camera).view(), by_rays(cell, camera)
    same = alike(now, expected)
    assert same.mean() >= least
    np.testing.assert_allclose(now.incidence_cosine[same], expected.incidence_cosine[same], atol=1e-9)
    assert (now.body == 1).any() or not poses
    assert (now.body > 1).any() or least == 1.0


# What a look does not find again is hidden, or no longer there, or comes back.
SMALL, TALL = Cup(0.09, 0.042, 0.036), Cup(0.19, 0.07, 0.07)
NEAR, BACK, ASIDE = (0.0, -0.10), (0.0, 0.02), (0.22, 0.0)
BOTH, ONE = ((SMALL, BACK), (SMALL, ASIDE)), ((SMALL, ASIDE),)
BELIEF = Belief(WorldConfig(), no_grip)


@lru_cache
def seen(*cups):
    """A view of cups at their places, and where its table is."""
    cell = one_arm_cell(cups=[cup for cup, _ in cups], poses=standing(*(place for _, place in cups)))
    return cell.look(), cell.world_from_table


def remembered(*looks):
    memory = Memory()
    for cups in looks:
        memory.update(*seen(*cups))
    return memory


def nearest(memory, place):
    return min(memory.objects, key=lambda known: np.linalg.norm(known.middle_m[:2] - place[:2]))


@pytest.mark.slow
def test_what_is_seen_past_is_lost_and_no_longer_on_the_table_unless_it_is_in_hand():
    memory = remembered(BOTH, ONE)
    gone = nearest(memory, BACK)
    assert (gone.is_lost, gone.is_gone, gone.is_racked) == (True, True, False)
    assert [known.is_lost for known in memory.objects].count(True) == 1
    number = memory.objects.index(gone)
    assert rows_of(memory, BELIEF)[number]["location"] == "LOST"
    assert not np.asarray(state_of(memory, BELIEF, 10).is_on_table)[number]
    # What comes back where it was is the same object, and elsewhere another.
    memory = remembered(BOTH, ONE, BOTH)
    assert [known.is_lost or known.seen is None for known in memory.objects] == [False, False]
    memory = remembered(BOTH, ONE, ((SMALL, ASIDE), (SMALL, NEAR)))
    assert sorted(known.is_lost for known in memory.objects) == [False, False, True]
    memory = remembered(BOTH)
    held = nearest(memory, BACK)
    memory.update(*seen(*ONE), in_hand=[held])
    assert (held.seen, held.is_lost) == (None, False)


def test_what_something_stands_before_is_hidden_and_has_not_vanished():
    was, now = seen((SMALL, BACK), (TALL, ASIDE))[0], seen((TALL, NEAR), (SMALL, ASIDE))[0]
    behind = max(was.objects, key=lambda each: each.centroid_m @ [-1.0, 0.0, 0.0])
    surface_m = was.image.points_m.reshape(-1, 3)[behind.pixels]
    assert not has_vanished(surface_m, now)
    assert has_vanished(surface_m, seen(*ONE)[0])
    # A place behind the camera or out of its view tells nothing.
    for place_m in ([0.0, 0.0, -1.0], [9.0, 0.0, 1.0]):
        assert not has_vanished(np.array([place_m] * 5), seen(*ONE)[0])


# An object of which an arm hides a part is left out of a look; what stands free is seen as it is.
NOTHING_HELD = np.zeros(CAMERA.num_rows * CAMERA.num_columns, dtype=bool)


@pytest.fixture
def pair():
    """Two arms and two cups, which have been looked at; and which of its objects are the left and the right cup."""
    cell = two_arm_cell((-0.20, 0.12), (0.25, 0.0))
    cell.look()
    return cell, *sorted(cell.memory.objects, key=lambda known: known.middle_m[0])


def glance(cell):
    return CellCamera(cell.cell, CAMERA).look(np.random.default_rng(1))


def reach(cell, place_m):
    """Hold the left hand somewhere."""
    for name, angle in zip(LEFT.joint_names, over(cell.cell.kinematics[LEFT.name], HOMES[0], place_m), strict=True):
        cell.cell.data.joint(name).qpos = angle
    mujoco.mj_forward(cell.cell.model, cell.cell.data)


@pytest.mark.slow
def test_cups_before_the_arms_are_seen_whole_and_one_behind_an_arm_is_left_out_and_known_as_it_was(pair):
    cell, left, right = pair
    before_m, look = left.middle_m.copy(), glance(cell)
    view, cloud = perceived_whole(look.cloud, look.robots_m, NOTHING_HELD)
    assert len(view.objects) == 2
    assert cloud is look.cloud
    reach(cell, (-0.20, 0.25, 0.80))
    look = glance(cell)
    assert len(perceived_whole(look.cloud, look.robots_m, NOTHING_HELD)[0].objects) == 2
    assert np.isfinite(look.robots_m).any()
    reach(cell, (-0.20, 0.02, 0.80))
    assert len(perceive(glance(cell).cloud).objects) == 2, "a part of it is in view"
    cell.look()
    assert (left.seen, left.is_gone, len(cell.memory.objects)) == (None, False, 2)
    assert right.seen is not None
    np.testing.assert_array_equal(left.middle_m, before_m)


@pytest.mark.slow
def test_a_cup_behind_one_that_an_arm_holds_is_left_out_and_known_as_it_was(pair):
    """The right cup is in the left hand, which has taken it around its middle."""
    cell, left, right = pair
    before_m, whole_px = left.middle_m.copy(), np.count_nonzero(glance(cell).labels == 0)
    hand_m = (-0.20, -0.10, 0.96)
    reach(cell, hand_m)
    model, data = cell.cell.model, cell.cell.data
    place = model.jnt_qposadr[model.body(cup_name(1)).jntadr[0]]
    data.qpos[place : place + 3] = np.array(hand_m) - [0.0, 0.0, 0.08]
    mujoco.mj_forward(model, data)
    grasp = Grasp("around", np.array([0.0, 0.0, 0.08]), DOWN_AXES, 0.1)
    cell.in_hand[0], cell.planned[0] = right, FetchPlan(grasp, Pose(hand_m), *[HOMES[0][None]] * 3)
    look = glance(cell)
    left_px = np.flatnonzero((look.labels == 0).ravel())
    assert len(left_px) < 0.9 * whole_px, "the cup that is held hides a part"
    not_by_arm, _ = perceived_whole(look.cloud, look.robots_m, NOTHING_HELD)
    assert any(np.isin(left_px, each.pixels).any() for each in not_by_arm.objects), "and the arm hides none"
    cell.look()
    assert [known.seen is None for known in cell.memory.objects] == [True, True]
    np.testing.assert_array_equal(left.middle_m, before_m)
    # Nothing else came into sight, such as half a cup or the one in the air.
    assert len(cell.memory.objects) == 2
