import mujoco
import numpy as np
import pytest

from halfseen.scene import Camera, Pose
from halfseen.scene.camera import look_at
from halfseen.scene.poses import about_axis, compose
from halfseen.scene.view import IdealView, ideal_view
from halfseen.scene.xtion import (
    XTION,
    depth_from_disparity_m,
    disparity_noise_px,
    noisy_disparity_px,
    sense,
    xtion_at,
)


def test_camera_looks_at_its_target_and_is_level():
    target_m = np.array([0.3, 0.2, 0.8])
    camera = xtion_at(look_at(np.array([-0.4, -0.9, 1.4]), target_m))
    assert camera.project(target_m[None])[0] == pytest.approx([319.5, 239.5], abs=1e-3)
    right, down, _ = camera.world_from_camera.rotation.T
    assert right[2] == pytest.approx(0.0, abs=1e-6)
    assert down[2] < 0


def test_field_of_view_is_the_sensors():
    camera = xtion_at(Pose((0.0, 0.0, 0.0)))
    across_rad, along_rad = 2 * np.arctan(320 / camera.focal_px[0]), 2 * np.arctan(240 / camera.focal_px[1])
    assert np.rad2deg([across_rad, along_rad]) == pytest.approx([58, 45], abs=1e-4)


def test_pixel_rays_are_what_project_undoes(rng):
    camera = Camera(
        Pose((0.1, -0.2, 0.3), about_axis((0.0, 1.0, 0.0), 0.4)),
        (100.0, 110.0),
        (31.5, 23.5),
        num_rows=48,
        num_columns=64,
    )
    row, column = 7, 50
    depth_m = rng.uniform(0.5, 2.0)
    point_m = camera.world_from_camera.apply(depth_m * camera.pixel_rays()[row, column][None])
    assert camera.project(point_m)[0] == pytest.approx([column, row], abs=1e-9)


def test_pose_inverse_and_composition(rng):
    points_m = rng.normal(size=(5, 3))
    first, then = about_axis((1.0, 0.0, 0.0), 0.7), about_axis((0.0, 0.0, 1.0), -1.1)
    pose = Pose((1.0, 2.0, 3.0), compose(first, then))
    assert np.allclose(pose.apply_inverse(pose.apply(points_m)), points_m)
    one_by_one = Pose((0.0, 0.0, 0.0), then).apply(Pose((0.0, 0.0, 0.0), first).apply(points_m))
    assert np.allclose(pose.apply(points_m) - [1.0, 2.0, 3.0], one_by_one)


FOCAL_PX = 577.0
SHAPE = (480, 640)


def flat_view(depth_m: float, cosine: float = 1.0) -> IdealView:
    return IdealView(
        depth_m=np.full(SHAPE, depth_m),
        body=np.zeros(SHAPE, dtype=np.int64),
        incidence_cosine=np.full(SHAPE, cosine),
        is_lit=np.ones(SHAPE, dtype=bool),
    )


def boxes_model(centres_m, half_sizes_m):
    """A world of fixed boxes, along the axes, whose picture can be worked out by hand; body i + 1 is box i."""
    spec = mujoco.MjSpec()
    for centre_m, half_m in zip(centres_m, half_sizes_m, strict=True):
        body = spec.worldbody.add_body(pos=list(centre_m))
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=list(half_m))
    return spec.compile()


def test_noise_grows_as_the_square_of_depth(rng):
    depths_m = np.array([0.7, 1.0, 1.5, 2.2, 3.0])
    spread_m = np.array([np.std(sense(flat_view(z), FOCAL_PX, rng)) for z in depths_m])
    slope = np.polyfit(np.log(depths_m), np.log(spread_m), 1)[0]
    assert slope == pytest.approx(2.0, abs=0.1)
    disparity_spread_px = np.hypot(0.1, XTION.disparity_step_px / np.sqrt(12))
    assert spread_m == pytest.approx(depths_m**2 / (FOCAL_PX * XTION.baseline_m) * disparity_spread_px, rel=0.1)


def test_noise_is_shared_by_neighbours_only(rng):
    noise_px = disparity_noise_px(SHAPE, rng)
    near = np.corrcoef(noise_px[:, :-1].ravel(), noise_px[:, 1:].ravel())[0, 1]
    far = np.corrcoef(noise_px[:, :-40].ravel(), noise_px[:, 40:].ravel())[0, 1]
    assert near > 0.5
    assert abs(far) < 0.05
    assert np.std(noise_px) == pytest.approx(0.1, rel=0.05)


def test_disparity_comes_in_eighths_of_a_pixel(picture):
    focal_px = picture.cloud.intrinsics[0, 0]
    eighths = 8 * focal_px * XTION.baseline_m / picture.depth_m[np.isfinite(picture.depth_m)]
    assert np.max(np.abs(eighths - np.round(eighths))) < 1e-6
    assert len(np.unique(np.round(eighths))) > 100


@pytest.mark.parametrize(("depth_m", "is_returned"), [(0.4, False), (0.6, True), (3.2, True), (4.0, False)])
def test_returns_come_from_the_range_only(depth_m, is_returned, rng):
    returned = np.isfinite(sense(flat_view(depth_m), FOCAL_PX, rng))
    assert np.all(returned == is_returned)


@pytest.mark.parametrize(("angle_deg", "share"), [(70, 0.0), (78 + 3.5, 0.5), (86, 1.0)])
def test_grazing_rays_are_lost(angle_deg, share, rng):
    lost = np.isnan(sense(flat_view(1.0, float(np.cos(np.deg2rad(angle_deg)))), FOCAL_PX, rng))
    assert np.mean(lost) == pytest.approx(share, abs=0.01)


def test_shadow_of_the_projector_is_where_geometry_puts_it(rng):
    """A thin plate before a wall; the projector at x = +7.5 cm leaves a shadow on the plate's left, and only there."""
    camera = Camera(Pose((0.0, 0.0, 0.0)), (FOCAL_PX, FOCAL_PX), (319.5, 20.0), num_rows=41, num_columns=640)
    model = boxes_model([(0.0, 0.0, 1.05), (0.0, 0.0, 0.8005)], [(2.0, 2.0, 0.05), (0.05, 0.2, 0.0005)])
    view = ideal_view(model, camera, XTION.baseline_m)
    wall_x_m = (np.arange(640) - 319.5) / FOCAL_PX
    is_plate = np.abs(wall_x_m) <= 0.05 / 0.8
    shadow_edge_m = XTION.baseline_m - (XTION.baseline_m + 0.05) / 0.8
    is_shadow = ~is_plate & (wall_x_m > shadow_edge_m) & (wall_x_m < 0)
    assert is_shadow.sum() > 5
    assert np.array_equal(view.body[20] == 2, is_plate)
    assert np.array_equal(~view.is_lit[20], is_shadow)
    returned = np.isfinite(sense(view, FOCAL_PX, rng)[20])
    assert np.array_equal(~returned, is_shadow)


def test_ideal_depth_of_a_wall_is_its_distance_along_the_axis(small_camera):
    view = ideal_view(boxes_model([(0.0, 0.0, 2.05)], [(9.0, 9.0, 0.05)]), small_camera, XTION.baseline_m)
    assert view.depth_m == pytest.approx(np.full((120, 160), 2.0), abs=1e-9)
    angle = np.linalg.norm(small_camera.pixel_rays(), axis=2)
    assert view.incidence_cosine == pytest.approx(1 / angle, abs=1e-9)
    assert view.is_lit.all()


def test_ideal_view_of_nothing_is_nan(small_camera):
    view = ideal_view(boxes_model([(0.0, 0.0, -1.0)], [(0.1, 0.1, 0.1)]), small_camera, XTION.baseline_m)
    assert np.isnan(view.depth_m).all()
    assert (view.labels == -1).all()
    assert not view.is_lit.any()


def test_disparity_without_noise_is_the_nearest_eighth():
    depth_m = np.array([[0.6, 1.0, 3.0, np.nan]])
    measured_px = noisy_disparity_px(depth_m, np.zeros((1, 4)), FOCAL_PX)
    exact_px = FOCAL_PX * XTION.baseline_m / depth_m
    assert np.all(np.abs(measured_px - exact_px)[:, :3] <= XTION.disparity_step_px / 2)
    assert np.isnan(measured_px[0, 3])


def test_no_depth_without_positive_disparity():
    depth_m = depth_from_disparity_m(np.array([[0.0, -0.125, 43.275, np.nan]]), FOCAL_PX)
    assert np.isnan(depth_m[0, [0, 1, 3]]).all()
    assert depth_m[0, 2] == pytest.approx(1.0)
