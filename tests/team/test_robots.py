"""What a team reaches, and where two robots are in each other's way."""

import numpy as np
import pytest

from halfseen.errors import ArgumentError, HalfseenWarning
from halfseen.team.robots import Robot, workspace_of

PLACES = np.array([[-0.3, 0.0], [0.0, 0.0], [0.05, 0.0], [0.3, 0.0]])
TEAM = (Robot((-0.6, 0.0), 0.62, name="left"), Robot((0.6, 0.0), 0.62, name="right"))


def test_each_reaches_its_side_and_both_the_middle():
    space = workspace_of(TEAM, PLACES)
    assert np.asarray(space.is_in_reach).tolist() == [[True, True, False, False], [False, True, True, True]]


def test_what_is_nearer_than_the_clearance_is_near_and_each_object_to_itself():
    near = np.asarray(workspace_of(TEAM, PLACES, clearance_m=0.1).is_near)
    assert np.argwhere(np.triu(near, 1)).tolist() == [[1, 2]]
    assert near.diagonal().all()
    np.testing.assert_array_equal(near, near.T)


def test_what_nobody_reaches_is_told():
    with pytest.warns(HalfseenWarning, match=r"object 1 at \(0, 2\) m is in no robot's reach, so it counts as left"):
        workspace_of(TEAM, np.array([[0.0, 0.0], [0.0, 2.0]]))


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: Robot((0.0, np.nan), 1.0), "base_m"),
        (lambda: Robot((0.0, 0.0), 0.0), "reach_m is 0.0"),
        (lambda: Robot((0.0, 0.0), 1.0, speed=-1.0), "speed is -1.0"),
        (lambda: workspace_of((), PLACES), "robots is empty"),
        (lambda: workspace_of(TEAM, np.array([[0.0, np.inf]])), "object 0 stands at"),
        (lambda: workspace_of(TEAM, PLACES, clearance_m=-0.1), "clearance_m is -0.1"),
    ],
)
def test_what_cannot_be_is_refused(make, told):
    with pytest.raises(ArgumentError, match=told):
        make()
