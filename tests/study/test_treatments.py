from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from halfseen.errors import ArgumentError
from halfseen.study.design import TREATMENTS
from halfseen.study.treatments import treat
from halfseen.world import Scene, UniformPolicy, WorldConfig
from halfseen.world.cuts import CutEpisodes
from halfseen.world.episodes import play
from halfseen.world.state import pad_scenes

CONFIG = WorldConfig(horizon=3)
FINISH, WASH_0, LIFT_1 = 0, 1, 4


def cut_by_hand(is_cut=True):
    """Five paths of two dirty cups: 0 finished; others cut in stage 1 (WASH), 2 (LIFT), 2 (FINISH), 1 (LIFT)."""
    scene = Scene(np.zeros((2, 2)))
    episodes = play(CONFIG, pad_scenes([scene]), UniformPolicy(), jax.random.key(0), 5)
    there = np.ones((5, 3, 2), dtype=bool)
    there[0, 1:, 0] = there[3, 1:, 0] = False
    action = np.array([[WASH_0, LIFT_1, FINISH], [WASH_0] * 3, [WASH_0, LIFT_1, FINISH], [WASH_0, FINISH, 0], [4] * 3])
    reward = [[5, -0.2, -5], [9, 9, 9], [-1, 9, 9], [5, 9, 9], [9, 9, 9]]
    episodes = replace(
        episodes,
        states=replace(episodes.states, is_on_table=jnp.asarray(there)),
        action=jnp.asarray(action),
        reward=jnp.asarray(reward, dtype=jnp.float32),
        duration_s=jnp.full((5, 3), 2.0),
        is_taken=jnp.ones((5, 3), dtype=bool),
        hidden=replace(episodes.hidden, is_dirty=jnp.ones((5, 2), dtype=bool)),
    )
    num_completed = np.array([3, 0, 1, 1, 0]) if is_cut else np.full(5, 3)
    stage = np.arange(3)
    is_completed = stage < num_completed[:, None]
    is_finished = num_completed == 3
    end_s = np.array([6.0, 1.0, 3.0, 3.5, 1.0]) if is_cut else np.full(5, 6.0)
    return CutEpisodes(episodes, end_s, is_finished, is_completed, is_completed | (stage == num_completed[:, None]))


def test_weighted_gives_completed_stages_the_inverse_of_what_was_left_uncut():
    treated = treat(cut_by_hand(), "weighted", CONFIG)

    # At 2 s two of five were cut; at 3 s one more of three, at 3.5 s one of the last two.
    np.testing.assert_allclose(
        treated.weight, [[5 / 3, 5, 5], [0, 0, 0], [5 / 3, 0, 0], [5 / 3, 0, 0], [0, 0, 0]], rtol=1e-12
    )
    np.testing.assert_allclose(treated.reward, [[5, -0.2, -5], [0] * 3, [-1, 0, 0], [5, 0, 0], [0] * 3], rtol=1e-6)
    np.testing.assert_array_equal(np.argwhere(treated.is_last), [[0, 2]])


def test_unweighted_counts_completed_stages_alike():
    treated = treat(cut_by_hand(), "unweighted", CONFIG)

    np.testing.assert_array_equal(treated.weight, [[1, 1, 1], [0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 0, 0]])
    np.testing.assert_array_equal(np.argwhere(treated.is_last), [[0, 2]])


def test_dropped_leaves_only_what_finished():
    treated = treat(cut_by_hand(), "dropped", CONFIG)

    np.testing.assert_array_equal(treated.weight, [[1, 1, 1]] + 4 * [[0, 0, 0]])
    np.testing.assert_array_equal(np.argwhere(treated.is_last), [[0, 2]])


def test_failures_make_the_stage_of_the_cut_a_failed_last_one():
    treated = treat(cut_by_hand(), "failures", CONFIG)

    np.testing.assert_array_equal(treated.weight, [[1, 1, 1], [1, 0, 0], [1, 1, 0], [1, 1, 0], [1, 0, 0]])
    np.testing.assert_array_equal(np.argwhere(treated.is_last), [[0, 2], [1, 0], [2, 1], [3, 1], [4, 0]])
    # WASH failed with two dirty left; LIFT for 1 s with two left; FINISH with one left; LIFT for 1 s with two left.
    expected = [[5, -0.2, -5], [-11, 0, 0], [-1, -10.1, 0], [5, -5, 0], [-10.1, 0, 0]]
    np.testing.assert_allclose(treated.reward, expected, rtol=1e-6)


@pytest.mark.parametrize("treatment", TREATMENTS)
def test_where_nothing_was_cut_all_treatments_are_one(treatment):
    plain = treat(cut_by_hand(is_cut=False), "unweighted", CONFIG)

    for ours, other in zip(treat(cut_by_hand(is_cut=False), treatment, CONFIG), plain, strict=True):
        np.testing.assert_array_equal(ours, other)


def test_an_unknown_treatment_is_refused_with_those_that_are_known():
    with pytest.raises(ArgumentError, match="'ignored'; it is one of weighted, unweighted, dropped, failures"):
        treat(cut_by_hand(), "ignored", CONFIG)
