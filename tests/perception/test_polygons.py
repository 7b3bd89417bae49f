"""Pixels of convex polygons beside scikit-image's, also where corners and sides lie on pixels."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from skimage.draw import polygon2mask

from halfseen.perception.polygons import convex_pixels

SHAPE = (50, 60)


@pytest.mark.parametrize("err_px", [None, 0.0, 1e-13, 1e-7], ids=["anywhere", "on pixels", "nearly", "about"])
@given(seed=st.integers(0, 2**32 - 1))
def test_the_same_pixels_as_asking_each(err_px, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-10, 70, (rng.integers(4, 30), 2))
    if err_px is not None:
        points = np.round(points) + err_px * rng.normal(size=points.shape)
    corners = points[ConvexHull(points).vertices]
    np.testing.assert_array_equal(convex_pixels(corners, SHAPE), np.flatnonzero(polygon2mask(SHAPE, corners[:, ::-1])))


@pytest.mark.parametrize("shift_px", [(-200.0, 0.0), (200.0, 0.0), (0.0, -200.0), (0.0, 200.0)])
def test_a_polygon_beside_the_image_has_none(shift_px):
    corners = np.array([[10.0, 10.0], [20.0, 10.0], [20.0, 20.0]])
    assert len(convex_pixels(corners, SHAPE))
    assert not len(convex_pixels(corners + shift_px, SHAPE))
