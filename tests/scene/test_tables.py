"""Tables of cups: meshes, physics at rest, the truth beside pictures, and the ten that ship."""

import subprocess
import sys
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner

import halfseen.scene
from halfseen.errors import ArgumentError, SceneError
from halfseen.perception import read_cloud
from halfseen.scene import Camera, Cup, Pose, Table, capture, random_table, read_table, read_truth, table_paths
from halfseen.scene.__main__ import main
from halfseen.scene.cups import NUM_AROUND, body_mesh, handle_mesh
from halfseen.scene.draw import GAP_M, MAX_OCCLUSION, MIN_RETURNS_PX, num_cups_of, settle, smallest_gap_m
from halfseen.scene.poses import about_axis, compose
from halfseen.scene.rays import at_rest, cast
from halfseen.scene.shipped import KEPT_WITHIN_M, NUM_TABLES, SEEDS, cloud_path, made_with, truth_path, versions
from halfseen.scene.table import TABLE_SIZE_M, TABLE_TOP_M, look_at, truth_of
from halfseen.scene.view import TIMESTEP_S, cup_name, lone_cup_model, lone_depths_m, room_spec, table_view
from halfseen.scene.xtion import XTION, xtion_at

PACKAGE = Path(halfseen.scene.__file__).parent
CUP = Cup(0.1, 0.04, 0.04)
TUMBLER = Cup(0.12, 0.04, 0.03)
MUG = Cup(0.1, 0.045, 0.040, wall_m=0.003, bottom_m=0.006, handle_m=0.03)
SMALL_MUG = Cup(0.09, 0.04, 0.038, handle_m=0.03)
HERE = Pose((0.0, 0.0, 0.0))
LYING = about_axis((1.0, 0.0, 0.0), np.pi / 2)
EYE = xtion_at(look_at(np.array([0.0, -0.9, 1.2]), np.array([0.0, 0.0, 0.75])))


# Cups
def enclosed_volume_m3(vertices, faces):
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return float(np.einsum("fi,fi->f", a, np.cross(b, c)).sum() / 6)


def test_surfaces_are_closed_look_outward_and_have_the_volume_of_their_prism():
    for build in (body_mesh, handle_mesh):
        vertices, faces = build(MUG)
        edges = Counter((int(face[k]), int(face[(k + 1) % 3])) for face in faces for k in range(3))
        assert set(edges.values()) == {1}
        assert all((end, start) in edges for start, end in edges)
        assert enclosed_volume_m3(vertices, faces) > 0
    polygon = NUM_AROUND / 2 * np.sin(2 * np.pi / NUM_AROUND)
    expected = polygon * (0.04**2 * 0.1 - 0.037**2 * 0.095)
    found = enclosed_volume_m3(*body_mesh(Cup(0.1, 0.04, 0.04, wall_m=0.003, bottom_m=0.005)))
    assert found == pytest.approx(expected, rel=1e-9)


def test_cup_is_hollow_and_its_handle_has_a_hole():
    mug = at_rest(lone_cup_model(MUG, HERE))
    down = cast(mug, np.array([0.003, 0.001, 1.0]), np.array([[0.0, 0.0, -1.0]]), 5.0)
    assert 1.0 - down.distance_m[0] == pytest.approx(MUG.bottom_m, abs=1e-7)  # meshes are float32
    x_m, across = MUG.radius_at(0.05) + 0.4 * MUG.handle_m, np.array([[0.0, 1.0, 0.0]])
    heights_m = np.linspace(0.02, 0.09, 71)
    is_met = [cast(mug, np.array([x_m, -1.0, z_m]), across, 5.0).body[0] > 0 for z_m in heights_m]
    assert any(is_met)
    assert not is_met[35]


# At rest
def moved_m(cups, world_from_cup, duration_s=0.5):
    """How far the farthest-moving cup goes when physics runs on [m]."""
    model = room_spec(cups, world_from_cup, is_free=True).compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, round(duration_s / TIMESTEP_S))
    ends = [data.body(cup_name(index)).xpos for index in range(len(cups))]
    starts = [pose.position_m for pose in world_from_cup]
    return float(np.max(np.linalg.norm(np.subtract(ends, starts), axis=1)))


@pytest.mark.parametrize("cup", [TUMBLER, SMALL_MUG])
def test_a_standing_cup_stands_where_it_is_let_go(cup):
    (end,) = settle([cup], [Pose((0.1, -0.05, TABLE_TOP_M + 0.004))])
    assert end.position_m == pytest.approx((0.1, -0.05, TABLE_TOP_M), abs=2e-4)
    assert end.rotation[2, 2] > 0.9999


def test_a_lying_tumbler_rests_on_its_cone_and_a_mug_does_not_balance_on_its_handle():
    (end,) = settle([TUMBLER], [Pose((0.0, 0.0, TABLE_TOP_M + 0.045), LYING)])
    # The axis of a cone that lies dips from the wide mouth to the narrow base by the half angle of the cone.
    half_angle_rad = np.arctan((TUMBLER.rim_radius_m - TUMBLER.base_radius_m) / TUMBLER.height_m)
    assert np.arcsin(end.rotation[2, 2]) == pytest.approx(half_angle_rad, abs=0.01)
    base_m = TUMBLER.base_radius_m * np.cos(half_angle_rad)
    assert end.position_m[2] - TABLE_TOP_M == pytest.approx(base_m, abs=5e-4)
    rolled = compose(about_axis((0.0, 0.0, 1.0), np.deg2rad(-60)), LYING)
    (end,) = settle([SMALL_MUG], [Pose((0.0, 0.0, TABLE_TOP_M + 0.08), rolled)])
    handle_tip_m = end.apply(np.array([[SMALL_MUG.rim_radius_m + SMALL_MUG.handle_m, 0.0, 0.045]]))[0]
    assert handle_tip_m[2] > TABLE_TOP_M - 1e-3
    assert moved_m([SMALL_MUG], [end]) < 5e-4


def test_nothing_on_a_shipped_table_moves():
    for table in (read_table(0), read_table(1)):
        assert moved_m(table.cups, table.world_from_cup) < 5e-4


def table_with(*places_m):
    return Table((CUP,) * len(places_m), tuple(Pose((x, y, TABLE_TOP_M)) for x, y in places_m), EYE)


def test_gap_between_two_straight_cups_and_fallen_means_off_the_vertical():
    table = table_with((0.0, 0.0), (0.1, 0.0))
    gap_m = partial(smallest_gap_m, table.cups, table.world_from_cup)
    assert gap_m() == pytest.approx(0.02, abs=1e-4)
    assert gap_m(beyond_m=0.01) == pytest.approx(0.01)
    with pytest.raises(SceneError, match="beyond_m"):
        gap_m(beyond_m=0.0)
    poses = [Pose((0.2 * k, 0.0, 1.0), about_axis((0.0, 1.0, 0.0), np.deg2rad(k * 20))) for k in range(6)]
    assert Table((MUG,) * 6, tuple(poses), EYE).is_fallen.tolist() == [False, False, False, False, True, True]


# What a picture shows, and the truth
@pytest.mark.slow
def test_cloud_is_the_depth_image_lifted(picture):
    cloud, depth_m = picture.cloud, picture.depth_m
    assert cloud.shape == (480, 640)
    assert np.array_equal(np.isnan(cloud.points_m[:, 2]), np.isnan(depth_m).ravel())
    points_m = cloud.points_m[np.isfinite(cloud.points_m[:, 2])]
    projected = points_m @ cloud.intrinsics.T
    rows, columns = np.nonzero(np.isfinite(depth_m))
    assert np.allclose(projected[:, :2] / projected[:, 2:], np.stack([columns, rows], 1), atol=1e-3)
    assert np.array_equal(points_m, points_m.astype(np.float32))


def test_returns_of_a_cup_lie_on_that_cup(table, picture):
    points_m = table.camera.world_from_camera.apply(picture.cloud.points_m).reshape(480, 640, 3)
    for index, (cup, pose) in enumerate(zip(table.cups, table.world_from_cup, strict=True)):
        mine_m = points_m[picture.truth.labels == index]
        own_m = pose.apply_inverse(mine_m[np.isfinite(mine_m[:, 0])])
        assert len(own_m) >= MIN_RETURNS_PX
        assert np.quantile(np.abs(own_m[:, 2] - cup.height_m / 2), 0.99) < cup.height_m / 2 + 0.01
        assert np.quantile(np.hypot(own_m[:, 0], own_m[:, 1]), 0.99) < cup.rim_radius_m + cup.handle_m + 0.01


def seen_px(table, which, cup):
    """Pixels that show a cup when only some cups are there, by a full picture of exactly those."""
    cups, poses = (tuple(each[k] for k in which) for each in (table.cups, table.world_from_cup))
    view = table_view(replace(table, cups=cups, world_from_cup=poses), XTION.baseline_m)
    return int(np.sum(view.labels == which.index(cup)))


def test_hand_made_depths(table):
    """Two cups of six and four pixels; the second hides two of the first's, the first hides none of the second's."""
    lone_m = np.full((2, 1, 9), np.inf)
    lone_m[0, 0, 0:6], lone_m[1, 0, 4:8] = 1.0, 0.9
    truth = truth_of(Table(table.cups[:2], table.world_from_cup[:2], table.camera), lone_m)
    assert truth.labels.tolist() == [[0, 0, 0, 0, 1, 1, 1, 1, -1]]
    assert truth.occlusion == pytest.approx([2 / 6, 0.0])
    assert truth.hides.tolist() == [[0.0, 2 / 6], [0.0, 0.0]]
    assert truth.silhouette_px.tolist() == [6, 4]


def test_a_cup_behind_another_loses_what_the_pictures_say():
    table = table_with((0.0, 0.1), (0.02, 0.0))
    truth = truth_of(table, lone_depths_m(table))
    alone_px, with_other_px = seen_px(table, [0], 0), seen_px(table, [0, 1], 0)
    assert 0.2 < truth.occlusion[0] < 0.8
    assert truth.silhouette_px[0] == alone_px
    assert truth.occlusion[0] == pytest.approx(1 - with_other_px / alone_px, abs=1e-12)
    assert truth.hides == pytest.approx(np.array([[0.0, truth.occlusion[0]], [0.0, 0.0]]))


@pytest.mark.slow
def test_pairs_agree_with_pictures_of_pairs(table, picture):
    """But for a pixel or two, as below."""
    for i, j in [(0, 1), (1, 0), *np.argwhere(picture.truth.hides > 0.05)[:3].tolist()]:
        alone_px = seen_px(table, [i], i)
        expected = 1 - seen_px(table, [i, j], i) / alone_px
        assert picture.truth.hides[i, j] == pytest.approx(expected, abs=3 / alone_px)


@pytest.mark.slow
def test_the_truth_agrees_with_the_full_picture_and_with_itself(table, picture):
    """But for a pixel or two: contact lets a cup sink into the table by some 0.01 mm, which the full picture shows."""
    truth, view, lone_m = picture.truth, table_view(table, XTION.baseline_m), lone_depths_m(table)
    differs = truth.labels != view.labels
    assert differs.sum() <= 3
    assert (lone_m.min(axis=0)[differs] - view.depth_m[differs] < 1e-4).all()
    assert np.all(truth.occlusion >= truth.hides.max(axis=1) - 1e-12)
    assert np.all(truth.occlusion <= truth.hides.sum(axis=1) + 1e-12)
    assert not np.diag(truth.hides).any()
    for index, centroid_m in enumerate(truth.centroid_m):
        column, row, _ = table.camera.intrinsics @ (centroid_m / centroid_m[2])
        assert np.isfinite(lone_m[index, round(row), round(column)])


@pytest.mark.slow
def test_what_was_seen_of_the_last_table_is_kept_and_cannot_be_changed(table):
    views = [table_view(each, XTION.baseline_m) for each in (table, read_table(3))]
    assert views[0] is views[1]
    for image in (views[0].depth_m, lone_depths_m(table)):
        with pytest.raises(ValueError, match="read-only"):
            image[...] = 0.0


# Tables that are drawn, and the ten that ship
@pytest.mark.slow
def test_same_seed_same_bytes_and_the_global_seed_changes_nothing_other_seed_other_noise_same_truth(table, picture):
    np.random.seed(12345)  # noqa: NPY002 - the global generator is what must not matter
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    drawn = random_table(SEEDS[3])
    again, other = capture(drawn, 3), capture(table, 4)
    assert np.array_equal(np.random.get_state()[1], before)  # noqa: NPY002
    assert drawn == table != random_table(SEEDS[3] + 1)
    for one, same in (
        (again.cloud.points_m, picture.cloud.points_m),
        (again.truth.labels, picture.truth.labels),
        (again.truth.hides, picture.truth.hides),
        (other.truth.labels, picture.truth.labels),
    ):
        assert one.tobytes() == same.tobytes()
    assert not np.array_equal(other.depth_m, picture.depth_m, equal_nan=True)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_drawn_tables_keep_their_promises(seed):
    table = random_table(seed)
    picture = capture(table, seed)
    assert 5 <= table.num_cups <= 10
    middle_m = table.centroid_m
    assert np.all(np.abs(middle_m[:, :2]) < np.array(TABLE_SIZE_M) / 2)
    assert np.all((middle_m[:, 2] > TABLE_TOP_M + 0.02) & (middle_m[:, 2] < TABLE_TOP_M + 0.1))
    upward = np.array([pose.rotation[2, 2] for pose in table.world_from_cup])
    assert np.array_equal(upward < 0.5, table.is_fallen)
    assert np.all((upward > 0.995) | (np.abs(upward) < 0.5))
    assert smallest_gap_m(table.cups, table.world_from_cup) >= GAP_M
    assert np.all(picture.truth.occlusion <= MAX_OCCLUSION)
    is_back = np.isfinite(picture.depth_m)
    assert min(np.sum(is_back & (picture.truth.labels == cup)) for cup in range(table.num_cups)) >= MIN_RETURNS_PX
    assert moved_m(table.cups, table.world_from_cup) < 5e-4


@pytest.mark.slow
def test_five_tables():
    tables = [random_table(seed) for seed in range(5)]
    assert [table.num_cups for table in tables] == [num_cups_of(seed) for seed in range(5)]
    assert {num_cups_of(seed) for seed in range(40)} == set(range(5, 11))
    assert 0.15 < np.concatenate([table.is_fallen for table in tables]).mean() < 0.4


def test_stored_tables_are_those_of_their_seeds():
    assert read_table(5) == random_table(SEEDS[5])


def test_shipped_clouds_agree_with_their_truth_and_are_varied():
    truths = [read_truth(k) for k in range(NUM_TABLES)]
    for k, (path, truth) in enumerate(zip(table_paths(), truths, strict=True)):
        cloud, table = read_cloud(path), read_table(k)
        assert cloud.shape == truth.labels.shape == (480, 640)
        assert np.array_equal(cloud.intrinsics, table.camera.intrinsics)
        assert np.array_equal(table.is_fallen, truth.is_fallen)
        depth_m = cloud.points_m[:, 2].reshape(cloud.shape)
        assert np.nanmax(depth_m) <= KEPT_WITHIN_M
        for index, centroid_m in enumerate(truth.centroid_m):
            mine_m = depth_m[(truth.labels == index) & np.isfinite(depth_m)]
            assert len(mine_m) >= MIN_RETURNS_PX
            assert abs(np.median(mine_m) - centroid_m[2]) < 0.1
    assert {truth.num_cups for truth in truths} == set(range(5, 11))
    assert sum(truth.is_fallen.any() for truth in truths) >= 8
    occlusion = np.concatenate([truth.occlusion for truth in truths])
    assert np.histogram(occlusion, [0.0, 0.1, 0.3, 0.5, 0.7, 0.85])[0].min() >= 3


@pytest.mark.slow
@pytest.mark.skipif(
    made_with(0) != versions(), reason=f"the shipped tables were made with {made_with(0)}; here is {versions()}"
)
def test_all_ten_come_out_the_same(tmp_path):
    command = [sys.executable, "-m", "halfseen.scene", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")
    # A slow machine shows a line a minute.
    assert all(line.startswith("halfseen: draw, ") for line in done.stderr.splitlines())
    for k in range(NUM_TABLES):
        for path_of in (cloud_path, truth_path):
            assert path_of(tmp_path, k).read_bytes() == path_of(PACKAGE, k).read_bytes(), path_of(tmp_path, k).name


def test_a_folder_that_cannot_be_is_reported_in_one_line(tmp_path):
    (tmp_path / "tables").write_text("in the way")
    result = CliRunner().invoke(main, ["--out", str(tmp_path)])
    assert result.exit_code == 2
    (line,) = (line for line in result.output.splitlines() if line.strip())
    assert "choose another folder" in line


CAMERA = Camera(HERE, (160.0, 160.0), (79.5, 59.5), 120, 160)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (partial(CAMERA.project, np.array([[0.0, 0.0, -1.0]])), SceneError, "behind"),
        (partial(Pose, (0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0)), SceneError, "pose"),
        (partial(Pose, (0.0, 0.0, 0.0), (np.nan, 0.0, 0.0, 0.0)), SceneError, "pose"),
        (partial(Cup, 0.0, 0.04, 0.04), SceneError, "height_m"),
        (partial(Cup, 0.1, np.nan, 0.04), SceneError, "rim_radius_m"),
        (partial(Cup, 0.004, 0.04, 0.04), SceneError, "hollow"),
        (partial(handle_mesh, CUP), SceneError, "handle_m"),
        (partial(Table, (CUP,), (), CAMERA), SceneError, "one pose for every cup"),
        (partial(capture, table_with((0.0, 0.0)), 3, surfaces=[]), SceneError, "0 surfaces and 1 cups"),
        (partial(read_truth, -1), ArgumentError, "numbered from 0 to 9"),
        (partial(read_truth, 10), ArgumentError, "numbered from 0 to 9"),
        (partial(getattr, halfseen.scene, "nonsense"), AttributeError, "random_table"),
    ],
)
def test_what_cannot_be_is_refused(make, error, message):
    with pytest.raises(error, match=message):
        make()
