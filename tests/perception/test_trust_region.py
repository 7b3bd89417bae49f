"""Fits beside SciPy's, to the last bit; walls beside plain geometry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from halfseen.perception.trust_region import Bounds, fitted
from halfseen.perception.walls import LYING_BOUNDS, STANDING_BOUNDS, WALL_NOISE_M, LyingWalls, StandingWalls

STANDING = np.array([[-0.1, -0.1, 0.0, -1.6], [0.1, 0.1, 0.14, 1.6]])
LYING = np.array([[-0.05, 0.0, 0.0, -1.6, -3.0, -0.3], [0.05, 0.1, 0.14, 1.6, 3.0, 0.3]])


def points_of(rng, count):
    """Half of a wall, noise, and points of another thing."""
    angle, height = rng.uniform(np.pi, 2 * np.pi, count), rng.uniform(0.0, 0.1, count)
    radius = rng.uniform(0.02, 0.06) + rng.uniform(-0.2, 0.3) * height
    wall = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
    turned = wall[:, rng.permutation(3)] + rng.normal(0, 0.002, wall.shape)
    return np.where(rng.random((count, 1)) < 0.1, rng.uniform(-0.1, 0.1, wall.shape), turned)


def walls_of(kind, rng):
    points = points_of(rng, int(rng.integers(8, 300)))
    if kind == "standing":
        return StandingWalls(points, float(np.median(points[:, 2]))), STANDING, STANDING_BOUNDS
    return LyingWalls(points, np.median(points, axis=0), 0.0005, 0.005), LYING, LYING_BOUNDS


def by_scipy(misses, start, bounds):
    return least_squares(
        lambda p: misses.at(p[None])[0][0],
        start,
        jac="2-point",
        bounds=(bounds.low, bounds.high),
        loss="soft_l1",
        max_nfev=30,
    )


@pytest.mark.parametrize("kind", ["standing", "lying"])
@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_two_fits_side_by_side_are_those_of_scipy_each(kind, seed):
    rng = np.random.default_rng(seed)
    walls, usual, bounds = walls_of(kind, rng)
    starts = [rng.uniform(*usual) for _ in range(2)]
    starts = [np.clip(start, bounds.low + 1e-6, bounds.high - 1e-6) for start in starts]
    for place, start in zip(fitted(walls, starts, bounds), starts, strict=True):
        found = by_scipy(walls, start, bounds)
        np.testing.assert_array_equal(place.p, found.x)
        np.testing.assert_array_equal(place.residuals, found.fun)
        assert place.cost == found.cost


class Decay:
    """An exponential beside numbers that no such curve within the bounds fits: steps are mirrored at them."""

    time = np.linspace(0.0, 3.0, 20)

    def __init__(self, rng):
        self.seen = rng.normal(size=20) * 3 + rng.uniform(-9, 9) * np.exp(rng.uniform(-2, 2) * self.time)

    def at(self, p):
        rows = np.array([each[0] * np.exp(each[1] * self.time) + each[2] - self.seen for each in p])
        step = np.sqrt(np.finfo(float).eps) * np.where(p >= 0, 1.0, -1.0) * np.maximum(1.0, np.abs(p))
        step = np.where((p + step < LEAST) | (p + step > -LEAST), -step, step)
        slopes = np.empty((len(p), 3, 20))
        for k, each in enumerate(p):
            for i in range(3):
                there = each.copy()
                there[i] += step[k, i]
                other = there[0] * np.exp(there[1] * self.time) + there[2] - self.seen
                slopes[k, i] = (other - rows[k]) / (there[i] - each[i])
        return rows, slopes


LEAST = np.array([-2.0, -0.5, -1.0])


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_at_bounds_steps_are_those_of_scipy(seed):
    rng = np.random.default_rng(seed)
    curve, start = Decay(rng), rng.uniform(0.99 * LEAST, -0.99 * LEAST)
    bounds = Bounds(LEAST, -LEAST)
    (place,) = fitted(curve, [start], bounds)
    np.testing.assert_array_equal(place.p, by_scipy(curve, start, bounds).x)


@pytest.mark.parametrize("kind", ["standing", "lying"])
def test_points_miss_the_wall_that_a_vessel_has(kind):
    rng = np.random.default_rng(0)
    walls, usual, bounds = walls_of(kind, rng)
    p = np.clip(rng.uniform(*usual), bounds.low, bounds.high)
    centre, axis = np.array([*p[:2], getattr(walls, "middle_height_m", 0.0)]), np.array([0.0, 0.0, 1.0])
    if kind == "lying":
        (centre,), (axis,) = walls.places(p[None])
    offset = walls.points_m - centre
    radius = p[2] + p[3] * (offset @ axis)
    outside = np.linalg.norm(np.cross(offset, axis), axis=1) - (radius if kind == "standing" else radius.clip(0))
    residuals = walls.at(p[None])[0][0, : len(outside)]
    np.testing.assert_allclose(residuals * WALL_NOISE_M, outside, atol=1e-12)
