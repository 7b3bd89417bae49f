"""Clouds that are no image: each pixel has its nearest point, whatever their order."""

import numpy as np
import pytest

from halfseen.perception import Cloud
from halfseen.perception.range_image import VIRTUAL_PIXEL_SCALE, range_image


def cloud_of(rng, num_points=1500):
    """Points of few coordinates, so that rays and depths are shared by some."""
    across = rng.integers(-20, 20, (num_points, 2)) / 32
    depth = rng.integers(4, 7, num_points) / 4
    return np.column_stack([across * depth[:, None], depth])


@pytest.mark.parametrize("seed", range(5))
def test_a_pixel_has_the_nearest_of_its_points(seed):
    rng = np.random.default_rng(seed)
    points = cloud_of(rng)
    image = range_image(Cloud(points))
    pixels = image.points_m.reshape(-1, 3)
    for pixel in range(len(pixels)):
        its = points[image.pixel_of_point == pixel]
        nearest = min(its[:, [2, 0, 1]].tolist(), default=[np.nan] * 3)
        np.testing.assert_array_equal(pixels[pixel, [2, 0, 1]], nearest)
    assert max(np.bincount(image.pixel_of_point[image.pixel_of_point >= 0])) > 1
    again = range_image(Cloud(rng.permutation(points)))
    np.testing.assert_array_equal(again.points_m, image.points_m)


@pytest.mark.parametrize("seed", range(5))
def test_a_pixel_is_as_wide_as_rays_are_apart(seed):
    points = cloud_of(np.random.default_rng(seed), 600)
    rays = np.unique(points[:, :2] / points[:, 2:], axis=0)
    apart = np.linalg.norm(rays[:, None] - rays, axis=2) + np.diag(np.full(len(rays), np.inf))
    pitch = VIRTUAL_PIXEL_SCALE * np.median(apart.min(axis=1))
    assert 1 / range_image(Cloud(points)).intrinsics[0, 0] == pytest.approx(pitch, rel=1e-12)
