import os

import jax
import numpy as np
import pytest

from halfseen.study.timing import decision_times_ms, one_core
from halfseen.world import Scene, UniformPolicy, WorldConfig
from halfseen.world.episodes import play
from halfseen.world.state import pad_scenes


def test_every_policy_has_a_positive_time_for_every_state():
    episodes = play(WorldConfig(), pad_scenes([Scene(np.zeros((1, 1)))]), UniformPolicy(), jax.random.key(0), 3)
    states = jax.tree.map(lambda leaf: leaf[:, 0], episodes.states)

    times = decision_times_ms({"one": UniformPolicy(), "two": UniformPolicy()}, states, 3)

    assert set(times) == {"one", "two"}
    assert all(values.shape == (3,) and (values > 0).all() for values in times.values())


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="the system cannot pin threads")
def test_cores_come_back_even_after_an_error():
    before = os.sched_getaffinity(0)
    with one_core():
        assert len(os.sched_getaffinity(0)) == 1
    assert os.sched_getaffinity(0) == before
    with pytest.raises(KeyError), one_core():
        raise KeyError
    assert os.sched_getaffinity(0) == before
