"""Clouds as others record them: cropped, thinned, in other axes; and things in view that are not on the table."""

from contextlib import nullcontext
from functools import partial

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from drawn_tables import EYE_M, TABLE_HALF_M, Can, K, camera_point, draw, hit_box, hit_can, hit_room, rays
from halfseen.errors import CloudError, HalfseenWarning
from halfseen.perception import Cloud, View, perceive, read_cloud
from halfseen.perception.picture import sentence
from halfseen.perception.tracking import matched
from halfseen.perception.vessel_fits import divided
from halfseen.perception.view import hidden_by_others
from halfseen.scene import table_paths

PAIR = (Can(0.0, -0.05, 0.035, 0.09), Can(0.02, 0.10, 0.04, 0.11))
FOUR = (*PAIR, Can(-0.16, 0.05, 0.04, 0.12), Can(0.2, 0.1, 0.03, 0.07))


def centroids(view: View) -> np.ndarray:
    return np.array([seen.centroid_m for seen in view.objects])


@pytest.mark.slow
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


@pytest.mark.slow
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
        CloudError, match=r"its points on the table are [23][0-9] mm apart, but cups need 20 mm at most"
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


def front(radius_m, height_m, x_m, y_m, rng, num=900):
    """Points of the half of a standing cylinder's wall that faces the camera, with noise."""
    way, height = rng.uniform(np.pi, 2 * np.pi, num), rng.uniform(0.01, height_m, num)
    across = radius_m + rng.normal(0.0, 0.001, num)
    return np.stack([x_m + across * np.cos(way), y_m + across * np.sin(way), height], axis=1)


@pytest.mark.parametrize("num", [2, 3, 4, 5])
@pytest.mark.parametrize("seed", range(3))
def test_cups_that_touch_are_divided_each_point_to_its_own(num, seed):
    rng = np.random.default_rng(seed)
    x_m = np.cumsum(rng.uniform(0.07, 0.08, num))
    y_m = 0.03 * (np.arange(num) % 2)
    cups = [front(rng.uniform(0.034, 0.036), rng.uniform(0.08, 0.13), *at, rng) for at in zip(x_m, y_m, strict=True)]
    owner = np.repeat(np.arange(num), 900)
    order = rng.permutation(len(owner))
    found = divided(np.concatenate(cups)[order])
    assert found is not None
    pairs = np.zeros((num, num))
    np.add.at(pairs, (owner[order], found), 1)
    assert pairs[linear_sum_assignment(-pairs)].sum() > 0.98 * len(owner)


@pytest.mark.parametrize("shape_m", [(0.2, 0.1, 0.12), (0.15, 0.15, 0.06), (0.12, 0.05, 0.16)])
def test_the_faces_of_a_box_are_not_divided(shape_m):
    rng, (width, _, height) = np.random.default_rng(0), shape_m
    points = rng.uniform(0.0, 1.0, (3000, 3)) * shape_m
    points[:1000, 1], points[1000:2000, 0], points[2000:, 2] = 0.0, width, height
    assert divided(points + rng.normal(0.0, 0.001, points.shape)) is None


def test_five_cans_that_touch_are_five_objects():
    """Without a step in depth between them; three of them were one, and no vessel by its shape."""
    ways = (0.4, 1.6, 3.0, 4.6)
    cans = [Can(0.0, 0.0), *(Can(0.081 * np.cos(way), 0.081 * np.sin(way)) for way in ways)]
    view = perceive(draw(*cans, noise_m=0.0015).cloud)
    middles_m = np.array([camera_point(np.array([can.x_m, can.y_m, can.height_m / 2])) for can in cans])
    assert sorted(matched(middles_m, centroids(view), 0.005).now.tolist()) == list(range(5))


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


FAR_EYE_M = np.array([0.0, -1.2, 0.85])  # sees what is over half a metre high
STANDING = (Can(-0.15, 0.0, 0.035, 0.09), Can(0.0, -0.02, 0.035, 0.09), Can(0.14, 0.05, 0.04, 0.11))
BESIDE = (STANDING[0], STANDING[2])
GRIPPER = ((Can(0.0, -0.02, 0.045, 0.07, is_open=False), 0.17), (Can(0.0, -0.02, 0.03, 0.6, is_open=False), 0.22))
HELD = (*GRIPPER, (Can(0.0, -0.02, 0.035, 0.09), 0.10))
BEHIND = (Can(-0.1, 0.05, 0.04, 0.15), Can(0.1, 0.05, 0.035, 0.15))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("standing", "floating", "eye_m"),
    [
        # The can below was taken for a part of the gripper, which the border cuts, and both were left out.
        *((STANDING, GRIPPER, eye_m) for eye_m in (EYE_M, FAR_EYE_M)),
        # What is held was an object that stands there, as high as the gripper; so was its inner wall alone.
        *((BESIDE, HELD, eye_m) for eye_m in (EYE_M, FAR_EYE_M)),
        # An arm was one if it is longer than four times its width, or goes on above half a metre.
        (BESIDE, [(Can(0.02, 0.1, 0.02, 0.9, is_open=False), 0.0)], EYE_M),
        (BESIDE, [(Can(0.02, 0.1, 0.03, 0.9, is_open=False), 0.0)], FAR_EYE_M),
        ((Can(-0.1, -0.1, 0.05, 0.13), Can(0.1, -0.1, 0.05, 0.13), *BEHIND), (), EYE_M),
    ],
    ids=["near", "far", "holding, near", "holding, far", "cut arm", "high arm", "no arm, but one behind the other"],
)
def test_cans_stand_on_the_table_and_arms_grippers_and_what_they_hold_do_not(standing, floating, eye_m):
    """Floating cans have a height of their lower end [m]."""
    way = rays()
    origin = np.broadcast_to(eye_m, way.shape)
    things = [*((can, 0.0) for can in standing), *floating]
    alone = np.array([hit_can(can, origin - [0.0, 0.0, begin_m], way) for can, begin_m in things])
    stacked = np.concatenate([hit_room(origin, way, False, 1.4)[None], alone])
    depth, labels = stacked.min(axis=0), stacked.argmin(axis=0) - 1
    view = perceive(Cloud.from_depth(np.where(np.isfinite(depth), depth, np.nan), K, "arm"))
    found = sorted(int(np.bincount(labels.ravel()[one.pixels] + 1).argmax()) - 1 for one in view.objects)
    assert found == list(range(len(standing)))


@pytest.mark.parametrize("height_m", [0.011, 0.02, 0.03])
def test_a_tray_is_an_object_of_its_own_that_hides_little_of_what_stands_on_it(height_m):
    """A tray of 40 by 36 cm hides nothing, but cups are taken to reach the table: it hides their foot, no more."""
    way, lifted = rays(), EYE_M - [0.0, 0.0, height_m]
    eye, on_tray = (np.broadcast_to(each, way.shape) for each in (EYE_M, lifted))
    tray = hit_box(np.array([0.0, 0.02, 0.20, 0.18, height_m]), way)
    alone = np.stack([hit_can(can, on_tray, way) for can in PAIR])
    depth = np.minimum.reduce([hit_room(eye, way, False, 1.4), tray, *alone])
    view = perceive(Cloud.from_depth(depth + 0.001 * np.random.default_rng(0).standard_normal(depth.shape), K, "tray"))
    assert len(view.objects) == 3
    low, *cans = sorted(view.objects, key=lambda seen: (seen.height_m > 0.05, seen.solid.middle_m[1]))
    truth = [0.0, np.mean(alone[0][np.isfinite(alone[1])] < alone[1][np.isfinite(alone[1])])]
    assert low.height_m == pytest.approx(height_m, abs=0.004)
    np.testing.assert_allclose([seen.height_m - height_m for seen in cans], [0.09, 0.11], atol=0.003)
    foot = 0.06 + 5.0 * height_m
    assert all(0.0 <= seen.occlusion - true <= foot for seen, true in zip(cans, truth, strict=True))


@pytest.mark.parametrize("noise_m", [0.0, 0.003])
def test_distances_along_rays_are_warned_of(tmp_path, noise_m):
    depth_m = draw(Can(0.0, 0.0)).depth_m + np.random.default_rng(0).normal(0.0, 1.0, (240, 320)) * noise_m
    row, column = np.indices(depth_m.shape)
    ranges_m = depth_m * np.sqrt(1.0 + ((column - K[0, 2]) / K[0, 0]) ** 2 + ((row - K[1, 2]) / K[1, 1]) ** 2)
    np.savez(tmp_path / "depth.npz", depth_m=depth_m, K=K)
    np.savez(tmp_path / "range.npz", depth_m=ranges_m, K=K)
    read_cloud(tmp_path / "depth.npz")
    with pytest.warns(HalfseenWarning, match=r"range\.npz: depth_m seems to hold distances along the rays"):
        read_cloud(tmp_path / "range.npz")


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_the_largest_of_16_bits_is_no_return(kind):
    depth_m = (np.array([[65535, 800], [0, 65534]]) / kind(1000)).astype(kind)
    assert np.isfinite(Cloud.from_depth(depth_m, K).points_m[:, 2]).tolist() == [False, True, False, True]


def test_a_matrix_of_another_resolution_is_warned_of(tmp_path):
    """Every other pixel with the matrix of all of them makes cups of half their size; a cut-out image has its own."""
    drawn = draw(Can(0.0, 0.0))
    message = (
        r"table.npz: the centre of K is \(159.5, 119.5\) px, as of an image of 240 rows by 320, but depth_m has 120"
    )
    for step, cut in ((1, np.s_[40:, 60:300]), (2, np.s_[:, :])):
        matrix = K - np.array([[0.0, 0.0, 60.0], [0.0, 0.0, 40.0], [0.0, 0.0, 0.0]]) if step == 1 else K
        np.savez(tmp_path / "table.npz", depth_m=drawn.depth_m[::step, ::step][cut], K=matrix)
        with nullcontext() if step == 1 else pytest.warns(HalfseenWarning, match=message):
            assert read_cloud(tmp_path / "table.npz").num_returns
