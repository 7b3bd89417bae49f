"""Thumbnails show the objects of a view close up, all of them."""

import io

import numpy as np
import pytest
from PIL import Image

from drawn_tables import Can, draw
from halfseen.perception import perceive
from halfseen.perception.picture import COLOURS, DOTS_PER_INCH, THUMBNAIL_INCHES, thumbnail


def pixels_of(view):
    with Image.open(io.BytesIO(thumbnail(view))) as image:
        return np.asarray(image.convert("RGB"), dtype=float) / 255.0


def is_colour(pixels, place):
    wanted = np.array([int(COLOURS[place][k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    return np.abs(pixels - wanted).max(axis=-1) < 0.02


@pytest.mark.parametrize("places_m", [[(0.0, 0.0)], [(-0.2, 0.0), (0.2, 0.1)], [(0.0, -0.15), (0.02, 0.2)]])
def test_all_objects_are_within_the_frame_and_fill_it(places_m):
    view = perceive(draw(*(Can(*place) for place in places_m)).cloud)
    pixels = pixels_of(view)
    assert pixels.shape[:2] == (THUMBNAIL_INCHES[1] * DOTS_PER_INCH, THUMBNAIL_INCHES[0] * DOTS_PER_INCH)
    outlines = np.logical_or.reduce([is_colour(pixels, place) for place in range(len(places_m))])
    inner = outlines[1:-1, 1:-1]
    assert inner.sum() == outlines.sum()
    extents = [np.ptp(each) / size for each, size in zip(np.nonzero(outlines), outlines.shape, strict=True)]
    assert max(extents) > 0.75
