import numpy as np
import pytest

from halfseen.scene import capture, random_table
from halfseen.scene.draw import MAX_OCCLUSION, MIN_RETURNS_PX
from halfseen.scene.layout import GAP_M
from halfseen.scene.settle import smallest_gap_m
from halfseen.scene.table import TABLE_SIZE_M, TABLE_TOP_M


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
        radius_m = np.hypot(own_m[:, 0], own_m[:, 1])
        assert len(own_m) >= MIN_RETURNS_PX
        assert np.quantile(np.abs(own_m[:, 2] - cup.height_m / 2), 0.99) < cup.height_m / 2 + 0.01
        assert np.quantile(radius_m, 0.99) < cup.rim_radius_m + cup.handle_m + 0.01


@pytest.mark.slow
def test_same_seed_same_bytes_and_the_global_seed_changes_nothing(table, picture):
    np.random.seed(12345)  # noqa: NPY002 - the global generator is what must not matter
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    drawn = random_table(3)
    again = capture(drawn, 3)
    assert np.array_equal(np.random.get_state()[1], before)  # noqa: NPY002
    assert drawn == table
    assert again.cloud.points_m.tobytes() == picture.cloud.points_m.tobytes()
    assert again.truth.labels.tobytes() == picture.truth.labels.tobytes()
    assert again.truth.hides.tobytes() == picture.truth.hides.tobytes()


@pytest.mark.slow
def test_other_seed_other_noise_same_truth(table, picture):
    other = capture(table, 4)
    assert not np.array_equal(other.depth_m, picture.depth_m, equal_nan=True)
    assert np.array_equal(other.truth.labels, picture.truth.labels)
    assert random_table(4) != table


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
    shown_px = [np.sum(is_back & (picture.truth.labels == index)) for index in range(table.num_cups)]
    assert min(shown_px) >= MIN_RETURNS_PX


@pytest.mark.slow
def test_forty_tables():
    tables = [random_table(seed) for seed in range(40)]
    assert {table.num_cups for table in tables} == set(range(5, 11))
    fallen = np.concatenate([table.is_fallen for table in tables])
    assert 0.15 < fallen.mean() < 0.4
