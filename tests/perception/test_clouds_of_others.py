"""Clouds as others record them: cropped, thinned, in other axes; and things in view that are not on the table."""

from functools import partial

import numpy as np
import pytest

from drawn_tables import TABLE_HALF_M, Can, draw
from halfseen.errors import CloudError
from halfseen.perception import Cloud, View, perceive, read_cloud
from halfseen.perception.picture import sentence
from halfseen.perception.tracking import matched
from halfseen.perception.view import hidden_by_others
from halfseen.scene import table_paths

PAIR = (Can(0.0, -0.05, 0.035, 0.09), Can(0.02, 0.10, 0.04, 0.11))
FOUR = (*PAIR, Can(-0.16, 0.05, 0.04, 0.12), Can(0.2, 0.1, 0.03, 0.07))


def centroids(view: View) -> np.ndarray:
    return np.array([seen.centroid_m for seen in view.objects])


@pytest.mark.parametrize("number", [0, 1])
def test_what_reaches_the_end_of_a_cloud_without_a_grid_is_not_cut(number):
    """The uppermost points of these tables are those of a cup."""
    cloud = read_cloud(table_paths()[number])
    view = perceive(Cloud(cloud.points_m))
    assert (len(view.objects), view.num_cut) == (len(perceive(cloud).objects), 0)


def voxels(points, side_m):
    """The mean of the points in each cube, as voxel filters have it."""
    _, cube = np.unique(np.floor(points / side_m), axis=0, return_inverse=True)
    return np.stack([np.bincount(cube.ravel(), of_axis) for of_axis in points.T], axis=1) / np.bincount(cube)[:, None]


@pytest.mark.parametrize(
    "thin",
    [
        *(partial(voxels, side_m=side_m) for side_m in (0.004, 0.006, 0.01)),
        *(lambda points, share=share: np.random.default_rng(0).permutation(points)[::share] for share in (2, 5)),
        lambda points: points[::2],
    ],
    ids=["4 mm", "6 mm", "10 mm", "half", "a fifth", "every other"],
)
def test_a_thinned_cloud_shows_the_objects_that_the_whole_one_does(thin):
    drawn = draw(*FOUR)
    points, view = drawn.cloud.points_m[np.isfinite(drawn.cloud.points_m[:, 2])], perceive(drawn.cloud)
    seen = perceive(Cloud(thin(points)))
    apart_m, occlusion = 0.012, [each.occlusion for each in view.objects]
    match = matched(view.places_m, seen.places_m, apart_m)
    assert sorted(match.now.tolist()) == [0, 1, 2, 3]
    np.testing.assert_allclose([seen.objects[k].occlusion for k in match.now], occlusion, atol=0.05)


def test_points_that_are_too_far_apart_for_cups_are_refused():
    points = draw(*FOUR).cloud.points_m
    with pytest.raises(
        CloudError, match=r"its points on the table are [23][0-9] mm apart, and cups take 20 mm at most"
    ):
        perceive(Cloud(voxels(points[np.isfinite(points[:, 2])], 0.03)))


@pytest.mark.parametrize(
    "axes", [np.diag([1.0, -1.0, -1.0]), [[0, -1, 0], [0, 0, -1], [1, 0, 0]]], ids=["OpenGL", "ROS"]
)
def test_points_in_axes_of_other_programs_show_the_same(axes):
    drawn = draw(*PAIR)
    view = perceive(drawn.cloud)
    for shape in (None, drawn.cloud.shape):
        seen = perceive(Cloud(drawn.cloud.points_m @ axes, shape))
        match = matched(centroids(view) @ axes, centroids(seen), 0.005)
        assert sorted(match.now.tolist()) == [0, 1]


@pytest.mark.parametrize(
    ("other", "num_cut"), [(Can(-0.43, -0.08, 0.06, 0.14), 1), (Can(0.0, -0.40, 0.03, 0.16), 0)], ids=["cut", "beside"]
)
def test_what_is_cut_or_beside_the_table_hides_and_is_no_object(other, num_cut):
    """A can that nothing else hides; where the other thing counted for nothing, it was hidden by 0."""
    can = Can(-0.40, 0.02, 0.04, 0.10) if num_cut else Can(0.03, -0.26, 0.04, 0.10)
    drawn = draw(can, other)
    assert 0.2 < drawn.occlusion[0] < 0.8
    view = perceive(drawn.cloud)
    assert (len(view.objects), view.num_cut) == (1, num_cut)
    assert (drawn.labels.ravel()[view.objects[0].pixels] == 0).mean() > 0.95
    assert view.labels.min() == -1
    assert view.objects[0].occlusion == pytest.approx(drawn.occlusion[0], abs=0.04)
    assert hidden_by_others(view, view.objects[0]) == view.objects[0].occlusion
    assert "object 0 is hidden most, by something cut by the image border or beside the table" in sentence(view)


def test_a_wall_behind_the_table_is_no_object_that_the_border_cuts():
    view = perceive(draw(*PAIR, wall_m=TABLE_HALF_M[1] + 0.04).cloud)
    assert (len(view.objects), view.num_cut) == (2, 0)
