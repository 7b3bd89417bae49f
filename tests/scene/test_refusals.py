"""What no scene can be is refused, and said."""

from functools import partial

import numpy as np
import pytest

import halfseen.scene
from halfseen.errors import ArgumentError, SceneError
from halfseen.scene import Camera, Cup, Pose, Table, capture, read_table, read_truth
from halfseen.scene.cups import handle_mesh

CUP, HERE = Cup(0.1, 0.04, 0.04), Pose((0.0, 0.0, 0.0))
CAMERA = Camera(HERE, (160.0, 160.0), (79.5, 59.5), 120, 160)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (partial(CAMERA.project, np.array([[0.0, 0.0, -1.0]])), SceneError, "behind"),
        (partial(Pose, (0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0)), SceneError, "pose"),
        (partial(Pose, (0.0, 0.0, 0.0), (np.nan, 0.0, 0.0, 0.0)), SceneError, "pose"),
        (partial(Cup, 0.0, 0.04, 0.04), SceneError, "height_m"),
        (partial(Cup, 0.1, np.nan, 0.04), SceneError, "rim_radius_m"),
        (partial(Cup, 0.004, 0.04, 0.04), SceneError, "hollow"),
        (partial(handle_mesh, CUP), SceneError, "handle_m"),
        (partial(Table, (CUP,), (), CAMERA), SceneError, "one pose for every cup"),
        (partial(capture, read_table(5), 3, surfaces=[]), SceneError, "0 surfaces and 5 cups"),
        (partial(read_truth, -1), ArgumentError, "numbered from 0 to 9"),
        (partial(read_truth, 10), ArgumentError, "numbered from 0 to 9"),
        (partial(getattr, halfseen.scene, "nonsense"), AttributeError, "random_table"),
    ],
)
def test_what_cannot_be_is_refused(make, error, message):
    with pytest.raises(error, match=message):
        make()
