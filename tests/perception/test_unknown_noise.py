"""Cameras that err more than they are said to: the table shows it, and nothing is invented."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from drawn_tables import Can, K, draw
from halfseen.perception import XTION, Cloud, perceive
from halfseen.perception.plane import find_table, noise_factor
from halfseen.perception.range_image import range_image

SPREAD_PX = 1.5
CANS = (Can(-0.15, 0.0, 0.04, 0.11), Can(0.0, 0.08, 0.035, 0.09), Can(0.14, -0.05, 0.04, 0.10))


def cloud_of(cans, factor, seed=0):
    """Cans as a camera sees them that errs by this multiple of an Xtion's noise, alike in neighbouring pixels."""
    depth = draw(*cans).depth_m
    error = gaussian_filter(np.random.default_rng(seed).standard_normal(depth.shape), SPREAD_PX, mode="wrap")
    error *= np.sqrt(4 * np.pi) * SPREAD_PX
    return Cloud.from_depth(depth + factor * XTION.noise_m(depth) * error, K, "noisy")


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0, 4.0])
def test_the_noise_of_a_table_is_measured_whatever_stands_there(factor):
    for cans in (CANS, ()):
        image = range_image(cloud_of(cans, factor))
        assert noise_factor(find_table(image), image) == pytest.approx(factor, rel=0.2)


@pytest.mark.parametrize("factor", [2.0, 3.0, 4.0])
def test_what_is_only_noise_is_no_object_and_no_can_is_several(factor):
    """At 4 there were five bumps on an empty table, and cans in pieces."""
    assert len(perceive(cloud_of((), factor)).objects) == 0
    heights_m = sorted(seen.height_m for seen in perceive(cloud_of(CANS, factor, seed=1)).objects)
    assert heights_m == pytest.approx([0.09, 0.10, 0.11], abs=0.015)


def test_depths_in_steps_of_two_centimetres_are_noise():
    depth = np.round(draw(*CANS).depth_m / 0.02) * 0.02
    assert len(perceive(Cloud.from_depth(depth, K, "steps")).objects) == 3
