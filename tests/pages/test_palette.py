"""Colours of figures: words on them can be read, and shades can be told apart."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from halfseen.pages.palette import GAINS, HUES, INK, learned_shades

LEAST_CONTRAST = 4.5


def luminance(colour) -> float:
    """Relative luminance, by the Web Content Accessibility Guidelines 2.2."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)]
    return float(np.dot([0.2126, 0.7152, 0.0722], linear))


def contrast(one, other) -> float:
    low, high = sorted([luminance(one), luminance(other)])
    return (high + 0.05) / (low + 0.05)


def test_numbers_on_the_map_of_gains_can_be_read():
    steps = GAINS(np.linspace(0.0, 1.0, 10))
    assert all(contrast(step, "white") > LEAST_CONTRAST for step in [*steps[:2], *steps[-2:]])
    assert all(contrast(step, INK) > LEAST_CONTRAST for step in steps[2:-2])


@pytest.mark.parametrize("num", [1, 4, 7])
def test_shades_of_what_was_learned_grow_lighter(num: int):
    shades = learned_shades(num)
    assert np.all(np.diff([luminance(shade) for shade in shades]) > 0.0)
    assert all(contrast(shade, "white") > 2.0 for shade in shades)


def test_each_kind_of_policy_has_a_hue_of_its_own():
    assert len({to_rgb(colour) for colour in HUES.values()}) == len(HUES)
    assert all(contrast(colour, "white") > 3.0 for colour in HUES.values())
