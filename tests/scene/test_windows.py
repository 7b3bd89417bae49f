"""Windows of a picture, by a box whose picture is known."""

from itertools import product

import numpy as np

from halfseen.scene import Camera, Pose
from halfseen.scene.windows import projector_columns_px, shaded_within, shown_within

CAMERA = Camera(Pose((0.0, 0.0, 0.0)), (100.0, 100.0), (49.5, 39.5), 80, 100)
BOX_M = np.array(list(product((-0.05, 0.05), (-0.1, 0.1), (1.0, 1.2))))[None]
BASELINE_M = 0.1


def test_a_box_shows_within_its_outline_and_little_more():
    row, column = np.nonzero(shown_within(BOX_M, CAMERA))
    assert (column.min(), column.max()) == (42, 57)
    assert (row.min(), row.max()) == (27, 52)


def test_a_box_beside_the_picture_shows_nowhere():
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
