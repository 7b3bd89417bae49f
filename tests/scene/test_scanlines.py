"""What rays meet, row by row, beside asking every ray about every facet."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from halfseen.scene import Camera, Pose
from halfseen.scene.moving import projector_columns_px, shaded_within, shown_within
from halfseen.scene.rays import RowRays, first_met

INTRINSICS = np.array([[50.0, 0.0, 30.0], [0.0, 52.0, 20.0], [0.0, 0.0, 1.0]])
TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def solids(rng, num_solids, middle_m):
    """Outward facets of tetrahedra, none of which holds the origin."""
    facets = []
    while len(facets) < num_solids:
        corners = rng.normal(size=(4, 3)) * 0.4 + rng.uniform(*middle_m)
        if np.linalg.det(corners[1:] - corners[0]) < 0:
            corners[[0, 1]] = corners[[1, 0]]
        sides = corners[TETRAHEDRON]
        is_outside = np.linalg.det(sides) < 0  # the origin is before this side
        if is_outside.any():
            facets.append(sides)
    return np.concatenate(facets)


def met_by_brute_force(corners, rays):
    """Depth at which each ray meets any side of any facet first."""
    directions = np.column_stack([rays.column, rays.row, np.ones(len(rays.row))]) @ np.linalg.inv(INTRINSICS).T
    # Each direction as a sum of the three corners of each facet.
    shares = np.einsum("fij,rj->fri", np.linalg.inv(np.moveaxis(corners, 1, 2)), directions)
    is_met = (shares >= 0).all(axis=2)
    depth = np.where(is_met, 1.0 / np.where(is_met, shares.sum(axis=2), 1.0), np.inf)
    return depth.min(axis=0), depth.argmin(axis=0)


@pytest.mark.parametrize(
    "middle_m",
    [([-1, -1, 1.5], [1, 1, 4]), ([-2, -2, -1], [2, 2, 1])],
    ids=["before the camera", "on both sides of its plane"],
)
@given(seed=st.integers(0, 2**32 - 1))
def test_as_asking_every_ray_about_every_facet(middle_m, seed):
    rng = np.random.default_rng(seed)
    corners = solids(rng, 12, middle_m)
    rays = RowRays(rng.integers(0, 40, 500), rng.uniform(-40, 100, 500))
    met = first_met(corners, INTRINSICS, rays)
    depth_m, facet = met_by_brute_force(corners, rays)
    np.testing.assert_allclose(met.depth_m, depth_m, rtol=1e-7)
    np.testing.assert_array_equal(met.facet, np.where(np.isfinite(depth_m), facet, -1))


def test_a_level_side_bounds_no_column():
    corners = np.array([[[-0.2, -0.1, 1.0], [-0.2, 0.1, 1.0], [0.2, 0.1, 1.0]]])
    row, column = (each.ravel() for each in np.mgrid[:40, :60])
    met = first_met(corners, INTRINSICS, RowRays(row, column.astype(float)))
    x, y = (column - 30) / 50, (row - 20) / 52
    is_within = (x >= -0.2) & (y <= 0.1) & (y >= x / 2)
    is_edge = (np.abs(y - x / 2) < 1e-9) | (np.abs(x + 0.2) < 1e-9)
    np.testing.assert_array_equal((met.facet == 0)[~is_edge], is_within[~is_edge])
    np.testing.assert_allclose(met.depth_m[met.facet == 0], 1.0)


CAMERA = Camera(Pose((0.0, 0.0, 0.0)), (100.0, 100.0), (49.5, 39.5), 80, 100)
BOX_M = np.array(list(product((-0.05, 0.05), (-0.1, 0.1), (1.0, 1.2))))[None]
BASELINE_M = 0.1


def test_a_box_shows_within_its_outline_and_little_more_and_beside_the_picture_nowhere():
    row, column = np.nonzero(shown_within(BOX_M, CAMERA))
    assert (column.min(), column.max()) == (42, 57)
    assert (row.min(), row.max()) == (27, 52)
    for aside_m in (-5.0, 5.0):
        assert not shown_within(BOX_M + np.array([aside_m, 0.0, 0.0]), CAMERA).any()
    assert not shown_within(np.zeros((0, 8, 3)), CAMERA).any()


def test_shadows_fall_to_the_left_of_what_makes_them():
    depth_m = np.full((80, 100), 2.0)
    depth_m[:, :3] = np.nan
    shaded = shaded_within(BOX_M, CAMERA, BASELINE_M, depth_m)
    # The projector's picture of the box is 10 columns to the left (at 1 m), that of a wall at 2 m is 5.
    row, column = np.nonzero(shaded[:, 8:])
    assert (column.min() + 8, column.max() + 8) == (37, 53)
    assert (row.min(), row.max()) == (27, 52)
    # What is beyond the left border of the projector's picture may be dark; what is nowhere is not.
    assert shaded[0, 3:5].all()
    assert not shaded[:, :3].any()
    np.testing.assert_allclose(projector_columns_px(CAMERA, BASELINE_M, depth_m)[0, 5], 0.0)
