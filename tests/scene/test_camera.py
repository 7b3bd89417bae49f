import numpy as np
import pytest

from halfseen.scene import Camera, Pose
from halfseen.scene.camera import look_at
from halfseen.scene.poses import about_axis, compose
from halfseen.scene.xtion import xtion_at


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
