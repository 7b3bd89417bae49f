"""Arms, grippers and what they hold, over a table of cans: none of them stands there."""

import numpy as np
import pytest

from drawn_tables import EYE_M, Can, K, hit_can, hit_room, rays
from halfseen.perception import Cloud, perceive

FAR_EYE_M = np.array([0.0, -1.2, 0.85])  # sees what is over half a metre high
STANDING = (Can(-0.15, 0.0, 0.035, 0.09), Can(0.0, -0.02, 0.035, 0.09), Can(0.14, 0.05, 0.04, 0.11))
GRIPPER = ((Can(0.0, -0.02, 0.045, 0.07, is_open=False), 0.17), (Can(0.0, -0.02, 0.03, 0.6, is_open=False), 0.22))


def seen(standing, floating=(), eye_m=EYE_M):
    """Objects as the can that each is; floating cans have a height of their lower end [m]."""
    way = rays()
    origin = np.broadcast_to(eye_m, way.shape)
    things = [(can, 0.0) for can in standing] + list(floating)
    alone = np.array([hit_can(can, origin - [0.0, 0.0, begin_m], way) for can, begin_m in things])
    stacked = np.concatenate([hit_room(origin, way, False, 1.4)[None], alone])
    depth, labels = stacked.min(axis=0), stacked.argmin(axis=0) - 1
    view = perceive(Cloud.from_depth(np.where(np.isfinite(depth), depth, np.nan), K, "arm"))
    return sorted(int(np.bincount(labels.ravel()[one.pixels] + 1).argmax()) - 1 for one in view.objects)


@pytest.mark.parametrize("eye_m", [EYE_M, FAR_EYE_M], ids=["near", "far"])
def test_a_gripper_over_a_can_is_no_object_and_the_can_is_one(eye_m):
    """The can was taken for a part of the gripper, which the border cuts, and both were left out."""
    assert seen(STANDING, GRIPPER, eye_m) == [0, 1, 2]


@pytest.mark.parametrize("eye_m", [EYE_M, FAR_EYE_M], ids=["near", "far"])
def test_a_can_in_a_gripper_is_not_on_the_table(eye_m):
    """It was an object that stands there, as high as the gripper; so was its inner wall alone."""
    held = (Can(0.0, -0.02, 0.035, 0.09), 0.10)
    assert seen((STANDING[0], STANDING[2]), [*GRIPPER, held], eye_m) == [0, 1]


@pytest.mark.parametrize(
    ("arm", "eye_m"),
    [(Can(0.02, 0.1, 0.02, 0.9, is_open=False), EYE_M), (Can(0.02, 0.1, 0.03, 0.9, is_open=False), FAR_EYE_M)],
    ids=["cut by the border", "higher than objects are"],
)
def test_an_arm_that_reaches_the_table_is_no_object(arm, eye_m):
    """It was one if it is longer than four times its width, or goes on above half a metre."""
    assert seen((STANDING[0], STANDING[2]), [(arm, 0.0)], eye_m) == [0, 1]


def test_what_stands_behind_others_is_no_floating_thing():
    front = (Can(-0.1, -0.1, 0.05, 0.13), Can(0.1, -0.1, 0.05, 0.13))
    assert seen((*front, Can(-0.1, 0.05, 0.04, 0.15), Can(0.1, 0.05, 0.035, 0.15))) == [0, 1, 2, 3]
