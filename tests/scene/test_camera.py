"""The camera: its geometry, what it would see without noise, and what its sensor makes of that."""

import mujoco
import numpy as np
import pytest

from halfseen.scene import Camera, Pose
from halfseen.scene.poses import about_axis, compose
from halfseen.scene.table import look_at
from halfseen.scene.view import IdealView, ideal_view
from halfseen.scene.xtion import (
    XTION,
    depth_from_disparity_m,
    disparity_noise_px,
    noisy_disparity_px,
    sense,
    xtion_at,
)

FOCAL_PX, SHAPE = 577.0, (480, 640)
ORIGIN = Pose((0.0, 0.0, 0.0))
SMALL = Camera(ORIGIN, (160.0, 160.0), (79.5, 59.5), 120, 160)
"""A coarse camera whose frame is the world's: looks along z, y down."""


def test_camera_looks_at_its_target_is_level_and_sees_as_far_aside_as_the_sensor():
    target_m = np.array([0.3, 0.2, 0.8])
    camera = xtion_at(look_at(np.array([-0.4, -0.9, 1.4]), target_m))
    assert camera.project(target_m[None])[0] == pytest.approx([319.5, 239.5], abs=1e-3)
    right, down, _ = camera.world_from_camera.rotation.T
    assert right[2] == pytest.approx(0.0, abs=1e-6)
    assert down[2] < 0
    field_rad = 2 * np.arctan(np.array([320, 240]) / camera.focal_px)
    assert np.rad2deg(field_rad) == pytest.approx([58, 45], abs=1e-4)


def test_inverse_and_composition_of_poses_and_pixel_rays_are_what_project_undoes(rng):
    points_m = rng.normal(size=(5, 3))
    first, then = about_axis((1.0, 0.0, 0.0), 0.7), about_axis((0.0, 0.0, 1.0), -1.1)
    pose = Pose((1.0, 2.0, 3.0), compose(first, then))
    assert np.allclose(pose.apply_inverse(pose.apply(points_m)), points_m)
    one_by_one = Pose((0.0, 0.0, 0.0), then).apply(Pose((0.0, 0.0, 0.0), first).apply(points_m))
    assert np.allclose(pose.apply(points_m) - [1.0, 2.0, 3.0], one_by_one)
    camera = Camera(pose, (100.0, 110.0), (31.5, 23.5), num_rows=48, num_columns=64)
    point_m = pose.apply(rng.uniform(0.5, 2.0) * camera.pixel_rays()[7, 50][None])
    assert camera.project(point_m)[0] == pytest.approx([50, 7], abs=1e-9)


def seen_of_boxes(camera, *boxes_m):
    """The ideal view of fixed boxes (centre, half sizes) along the axes; body i + 1 is box i."""
    spec = mujoco.MjSpec()
    for centre_m, half_m in boxes_m:
        spec.worldbody.add_body(pos=centre_m).add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half_m)
    return ideal_view(spec.compile(), camera, XTION.baseline_m)


def test_ideal_depth_of_a_wall_is_its_distance_along_the_axis_and_of_nothing_nan():
    wall = seen_of_boxes(SMALL, ([0.0, 0.0, 2.05], [9.0, 9.0, 0.05]))
    assert wall.depth_m == pytest.approx(np.full((120, 160), 2.0), abs=1e-9)
    assert wall.incidence_cosine == pytest.approx(1 / np.linalg.norm(SMALL.pixel_rays(), axis=2), abs=1e-9)
    assert wall.is_lit.all()
    nothing = seen_of_boxes(SMALL, ([0.0, 0.0, -1.0], [0.1, 0.1, 0.1]))
    assert np.isnan(nothing.depth_m).all()
    assert (nothing.labels == -1).all()
    assert not nothing.is_lit.any()


def test_shadow_of_the_projector_is_where_geometry_puts_it(rng):
    """A thin plate before a wall; the projector at x = +7.5 cm leaves a shadow on the plate's left, and only there."""
    camera = Camera(ORIGIN, (FOCAL_PX, FOCAL_PX), (319.5, 20.0), num_rows=41, num_columns=640)
    view = seen_of_boxes(camera, ([0.0, 0.0, 1.05], [2.0, 2.0, 0.05]), ([0.0, 0.0, 0.8005], [0.05, 0.2, 0.0005]))
    wall_x_m = (np.arange(640) - 319.5) / FOCAL_PX
    is_plate = np.abs(wall_x_m) <= 0.05 / 0.8
    shadow_edge_m = XTION.baseline_m - (XTION.baseline_m + 0.05) / 0.8
    is_shadow = ~is_plate & (wall_x_m > shadow_edge_m) & (wall_x_m < 0)
    assert is_shadow.sum() > 5
    assert np.array_equal(view.body[20] == 2, is_plate)
    assert np.array_equal(~view.is_lit[20], is_shadow)
    assert np.array_equal(np.isnan(sense(view, FOCAL_PX, rng)[20]), is_shadow)


def sensed(depth_m, rng, angle_deg=0.0):
    """What the sensor makes of a wall that is everywhere as deep, and met at an angle."""
    cosine = np.full(SHAPE, np.cos(np.deg2rad(angle_deg)))
    nowhere, everywhere = np.zeros(SHAPE, dtype=np.int64), np.ones(SHAPE, dtype=bool)
    return sense(IdealView(np.full(SHAPE, depth_m), nowhere, cosine, everywhere), FOCAL_PX, rng)


def test_noise_grows_as_the_square_of_depth(rng):
    depths_m = np.array([0.7, 1.0, 1.5, 2.2, 3.0])
    spread_m = np.array([np.std(sensed(z, rng)) for z in depths_m])
    assert np.polyfit(np.log(depths_m), np.log(spread_m), 1)[0] == pytest.approx(2.0, abs=0.1)
    disparity_spread_px = np.hypot(0.1, XTION.disparity_step_px / np.sqrt(12))
    assert spread_m == pytest.approx(depths_m**2 / (FOCAL_PX * XTION.baseline_m) * disparity_spread_px, rel=0.1)


def test_noise_is_shared_by_neighbours_only(rng):
    noise_px = disparity_noise_px(SHAPE, rng)
    near, far = (np.corrcoef(noise_px[:, :-k].ravel(), noise_px[:, k:].ravel())[0, 1] for k in (1, 40))
    assert near > 0.5
    assert abs(far) < 0.05
    assert np.std(noise_px) == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize(
    ("depth_m", "angle_deg", "lost"),
    [(0.4, 0, 1.0), (0.6, 0, 0.0), (3.2, 0, 0.0), (4.0, 0, 1.0), (1.0, 70, 0.0), (1.0, 81.5, 0.5), (1.0, 86, 1.0)],
)
def test_returns_come_from_the_range_only_and_grazing_rays_are_lost(depth_m, angle_deg, lost, rng):
    share = np.isnan(sensed(depth_m, rng, angle_deg)).mean()
    assert share == pytest.approx(lost, abs=0.01 if angle_deg else 0.0)


def test_disparity_comes_in_eighths_of_a_pixel_the_nearest_without_noise(picture):
    focal_px = picture.cloud.intrinsics[0, 0]
    eighths = 8 * focal_px * XTION.baseline_m / picture.depth_m[np.isfinite(picture.depth_m)]
    assert np.max(np.abs(eighths - np.round(eighths))) < 1e-6
    assert len(np.unique(np.round(eighths))) > 100
    depth_m = np.array([[0.6, 1.0, 3.0, np.nan]])
    measured_px = noisy_disparity_px(depth_m, np.zeros((1, 4)), FOCAL_PX)
    exact_px = FOCAL_PX * XTION.baseline_m / depth_m
    assert np.all(np.abs(measured_px - exact_px)[:, :3] <= XTION.disparity_step_px / 2)
    assert np.isnan(measured_px[0, 3])
    # No depth without positive disparity.
    depth_m = depth_from_disparity_m(np.array([[0.0, -0.125, 43.275, np.nan]]), FOCAL_PX)
    assert np.isnan(depth_m[0, [0, 1, 3]]).all()
    assert depth_m[0, 2] == pytest.approx(1.0)
