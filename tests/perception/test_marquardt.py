"""Fits beside SciPy's; walls beside plain geometry, and how they change beside small differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.optimize import least_squares

from halfseen.arrays import percentiles
from halfseen.perception.marquardt import Bounds, fitted, soft_l1
from halfseen.perception.walls import LYING_BOUNDS, STANDING_BOUNDS, WALL_NOISE_M, LyingWalls, StandingWalls

STANDING = np.array([[-0.1, -0.1, 0.01, -1.4], [0.1, 0.1, 0.12, 1.4]])
LYING = np.array([[-0.05, 0.0, 0.01, -1.4, -3.0, -0.3], [0.05, 0.1, 0.12, 1.4, 3.0, 0.3]])
KINDS = {"standing": (STANDING, STANDING_BOUNDS), "lying": (LYING, LYING_BOUNDS)}


def points_of(rng, count):
    """Half of a wall, noise, and points of another thing."""
    angle, height = rng.uniform(np.pi, 2 * np.pi, count), rng.uniform(0.0, 0.1, count)
    radius = rng.uniform(0.02, 0.06) + rng.uniform(-0.2, 0.3) * height
    wall = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
    turned = wall[:, rng.permutation(3)] + rng.normal(0, 0.002, wall.shape)
    return np.where(rng.random((count, 1)) < 0.1, rng.uniform(-0.1, 0.1, wall.shape), turned)


def walls_of(kind, sets):
    middles = [np.median(points, axis=0) for points in sets]
    if kind == "standing":
        return StandingWalls.of(sets, [float(middle[2]) for middle in middles])
    return LyingWalls.of(sets, middles, 0.0005, 0.005)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_many_fits_side_by_side_cost_no_more_than_those_of_scipy_and_each_is_as_if_alone(kind, seed):
    rng, (usual, bounds) = np.random.default_rng(seed), KINDS[kind]
    sets = [points_of(rng, int(rng.integers(60, 300))) for _ in range(6)]
    starts = np.array([rng.uniform(*usual) for _ in sets])
    found = fitted(walls_of(kind, sets), starts, bounds)
    costs = soft_l1(walls_of(kind, sets).at(found)[0]).sum(axis=1)
    theirs = np.zeros(len(sets))
    for k, points in enumerate(sets):
        alone = walls_of(kind, [points])
        # Padding counts for nothing: to the last bits that sums of other lengths have.
        np.testing.assert_allclose(soft_l1(alone.at(found[[k]])[0]).sum(), costs[k], rtol=1e-12)
        by_scipy = least_squares(
            lambda p, alone=alone: alone.at(p[None])[0][0],
            found[k].clip(bounds.low + 1e-9, bounds.high - 1e-9),
            bounds=(bounds.low, bounds.high),
            loss="soft_l1",
        )
        theirs[k] = 2 * by_scipy.cost
    # From where we end SciPy finds nothing better, but for a rare fit that had not settled.
    assert np.sort(costs / theirs)[len(sets) // 2] < 1.0 + 1e-4
    assert (soft_l1(walls_of(kind, sets).at(starts)[0]).sum(axis=1) >= costs).all()
    assert ((found >= bounds.low) & (found <= bounds.high)).all()


class Decay:
    """An exponential beside numbers that no such curve within the bounds fits: some parameters end at them."""

    time = np.linspace(0.0, 3.0, 20)

    def __init__(self, seen):
        self.seen = seen

    def at(self, p):
        curve = np.exp(p[:, 1:2] * self.time)
        slopes = np.stack([curve, p[:, :1] * self.time * curve, np.ones_like(curve)], axis=1)
        return p[:, :1] * curve + p[:, 2:3] - self.seen, slopes

    def some(self, which):
        return Decay(self.seen[which])


LEAST = np.array([-2.0, -0.5, -1.0])


def test_at_bounds_fits_end_where_nothing_within_them_is_better():
    rng, bounds = np.random.default_rng(5), Bounds(LEAST, -LEAST)
    seen = rng.normal(size=(40, 20)) * 3 + rng.uniform(-9, 9, (40, 1)) * np.exp(
        rng.uniform(-2, 2, (40, 1)) * Decay.time
    )
    found = fitted(Decay(seen), rng.uniform(0.9 * LEAST, -0.9 * LEAST, (40, 3)), bounds)
    residuals, slopes = Decay(seen).at(found)
    slope = np.einsum("kpr,kr->kp", slopes, residuals / np.sqrt(1 + residuals**2))
    outward = np.where(found <= LEAST, np.minimum(slope, 0), np.where(found >= -LEAST, np.maximum(slope, 0), slope))
    cost = soft_l1(residuals).sum(axis=1)
    assert (np.abs(outward).max(axis=1) < 1e-3 * cost).all()
    is_at_bound = (found <= LEAST) | (found >= -LEAST)
    assert is_at_bound.any(axis=1).sum() > 10


@pytest.mark.parametrize("kind", KINDS)
def test_points_miss_the_wall_that_a_vessel_has_and_slopes_are_those_of_small_differences(kind):
    rng, (usual, _) = np.random.default_rng(0), KINDS[kind]
    sets = [points_of(rng, count) for count in (40, 90, 70)]
    p = np.array([rng.uniform(*usual) for _ in sets])
    walls = walls_of(kind, sets)
    residuals, slopes = walls.at(p)
    for k, points in enumerate(sets):
        centre, axis = np.array([*p[k, :2], np.median(points[:, 2])]), np.array([0.0, 0.0, 1.0])
        if kind == "lying":
            centre, axis = (each[k] for each in walls.places(p))
        offset = points - centre
        radius = p[k, 2] + p[k, 3] * (offset @ axis)
        outside = np.linalg.norm(np.cross(offset, axis), axis=1) - (radius if kind == "standing" else radius.clip(0))
        np.testing.assert_allclose(residuals[k, : len(points)] * WALL_NOISE_M, outside, atol=1e-12)
        assert not residuals[k, len(points) : 90].any()
    for which in range(p.shape[1]):
        step = np.eye(p.shape[1])[which] * 1e-6
        differences = (walls.at(p + step)[0] - walls.at(p - step)[0]) / 2e-6
        np.testing.assert_allclose(slopes[:, which], differences, rtol=1e-4, atol=1e-3)


@given(arrays(float, array_shapes(min_dims=1, max_dims=2, max_side=9), elements=st.floats(-9, 9)), st.floats(0, 100))
def test_percentiles_are_those_of_numpy(values, percent):
    found = percentiles(values, percent, 100 - percent)
    np.testing.assert_allclose(found, np.percentile(values, [percent, 100 - percent], axis=0), rtol=0, atol=1e-12)
