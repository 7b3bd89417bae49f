import numpy as np
import pytest

from halfseen.errors import SceneError
from halfseen.world import Scene, WorldConfig
from halfseen.world.state import initial_state, pad_scenes

HIDES = np.array([[0.0, 0.5], [0.0, 0.0]])


def test_a_scene_that_says_nothing_of_grips_sets_no_object_apart():
    assert Scene(HIDES).grip.tolist() == [0.0, 0.0]


def test_what_shows_of_grips_reaches_the_state_and_padding_holds_none():
    layouts = pad_scenes([Scene(HIDES, grip=np.array([-1.5, 0.5])), Scene(np.zeros((1, 1)))])
    states = initial_state(WorldConfig(), layouts)
    assert np.isnan(np.asarray(layouts.grip)[1, 1])
    assert np.asarray(states.grip).tolist() == [[-1.5, 0.5], [0.0, 0.0]]
    assert not np.asarray(states.seen).any()


def test_a_grip_that_is_no_number_is_refused():
    with pytest.raises(SceneError, match=r"scene: grip\[1\] is nan; give a finite offset"):
        Scene(HIDES, grip=np.array([0.0, np.nan]))


def test_a_scene_keeps_its_own_copy():
    grip = np.ones(2)
    scene = Scene(HIDES, grip=grip)
    grip[0] = 9.0
    assert scene.grip.tolist() == [1.0, 1.0]
    with pytest.raises(ValueError, match="read-only"):
        scene.grip[0] = 2.0
