import numpy as np
import pytest

from halfseen.scene import Cup, Pose, Table
from halfseen.scene.camera import look_at
from halfseen.scene.room import room_model
from halfseen.scene.table import TABLE_TOP_M
from halfseen.scene.truth import truth_of
from halfseen.scene.view import ideal_view, lone_depths_m, table_view
from halfseen.scene.xtion import XTION, xtion_at

EYE = xtion_at(look_at(np.array([0.0, -0.9, 1.2]), np.array([0.0, 0.0, 0.75])))
CUP = Cup(0.1, 0.04, 0.04)


def table_with(*places_m: tuple[float, float]) -> Table:
    return Table((CUP,) * len(places_m), tuple(Pose((x, y, TABLE_TOP_M)) for x, y in places_m), EYE)


def seen_px(table: Table, which: list[int], cup: int) -> int:
    """Pixels that show a cup when only some cups are there, by a full picture of exactly those."""
    model = room_model([table.cups[k] for k in which], [table.world_from_cup[k] for k in which], is_free=False)
    return int(np.sum(ideal_view(model, table.camera, XTION.baseline_m).labels == which.index(cup)))


def test_hand_made_depths(table):
    """Two cups of six and four pixels; the second hides two of the first's, the first hides none of the second's."""
    lone_m = np.full((2, 1, 9), np.inf)
    lone_m[0, 0, 0:6] = 1.0
    lone_m[1, 0, 4:8] = 0.9
    two = Table(table.cups[:2], table.world_from_cup[:2], table.camera)
    truth = truth_of(two, lone_m)
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
    for i, j in [(0, 1), (1, 0), *np.argwhere(picture.truth.hides > 0.05)[:3].tolist()]:
        expected = 1 - seen_px(table, [i, j], i) / seen_px(table, [i], i)
        assert picture.truth.hides[i, j] == pytest.approx(expected, abs=1e-12)


def test_labels_agree_with_the_full_picture(table, picture):
    """But for a pixel or two: contact lets a cup sink into the table by some 0.01 mm, which the full picture shows."""
    view = table_view(table, XTION.baseline_m)
    differs = picture.truth.labels != view.labels
    assert differs.sum() <= 3
    assert (lone_depths_m(table).min(axis=0)[differs] - view.depth_m[differs] < 1e-4).all()


def test_occlusion_lies_between_the_worst_pair_and_the_sum_of_pairs(picture):
    truth = picture.truth
    assert np.all(truth.occlusion >= truth.hides.max(axis=1) - 1e-12)
    assert np.all(truth.occlusion <= truth.hides.sum(axis=1) + 1e-12)
    assert not np.diag(truth.hides).any()


def test_centroids_project_into_their_silhouettes(table, picture):
    intrinsics = table.camera.intrinsics
    lone_m = lone_depths_m(table)
    for index, centroid_m in enumerate(picture.truth.centroid_m):
        column, row, _ = intrinsics @ (centroid_m / centroid_m[2])
        assert np.isfinite(lone_m[index, round(row), round(column)])
