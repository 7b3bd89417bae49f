"""Policies of tables: what they would have done in the states of a log, and what they earn in the simulated world."""

import numpy as np
import pytest

from halfseen.evaluation.simulation import compare_in_world, evaluate_in_world
from halfseen.evaluation.targets import target_probabilities
from halfseen.learning.rows import trajectory_arrays
from halfseen.planners import GreedyPolicy
from halfseen.tables import TableTask
from halfseen.world import ExploringPolicy, Scene, TableWorld, UniformPolicy, WorldConfig

pytestmark = pytest.mark.slow

CONFIG = WorldConfig()
SCENE = Scene(np.array([[0.0, 0.5], [0.0, 0.0]]))
TASK = TableTask()
LOGGER = ExploringPolicy(GreedyPolicy(CONFIG, uses_history=True, counts_penalty=True), 0.4)


@pytest.fixture(scope="module")
def laid_out():
    logs = TableWorld().simulate(SCENE, LOGGER, episodes=40, seed=0, cut_share=0.3)
    return logs, trajectory_arrays(logs, TASK.encode(logs, 10), None)


def test_the_logging_policy_would_have_done_it_as_likely_as_it_was_logged(laid_out):
    logs, trajectories = laid_out
    chances = target_probabilities(LOGGER, logs, trajectories, TASK)
    np.testing.assert_allclose(chances.sum(axis=2)[trajectories.is_begun], 1.0, rtol=1e-6)
    taken = np.take_along_axis(chances, trajectories.action[..., None], axis=2)[..., 0]
    np.testing.assert_allclose(taken[trajectories.is_begun], trajectories.probability[trajectories.is_begun], rtol=1e-5)


def test_a_policy_without_chance_takes_one_possible_action(laid_out):
    logs, trajectories = laid_out
    chances = target_probabilities(LOGGER.base, logs, trajectories, TASK)
    assert set(np.unique(chances)) == {0.0, 1.0}
    np.testing.assert_array_equal(chances.sum(axis=2), trajectories.is_begun)
    assert not (chances[~trajectories.is_possible] > 0).any()
    # The uniform policy shares among what is possible.
    chances = target_probabilities(UniformPolicy(), logs, trajectories, TASK)[trajectories.is_begun]
    possible = trajectories.is_possible[trajectories.is_begun]
    np.testing.assert_allclose(chances, possible / possible.sum(axis=1, keepdims=True), rtol=1e-6)


def test_the_world_pays_what_its_episodes_hold():
    found = evaluate_in_world(UniformPolicy(), [SCENE], CONFIG, episodes=2500, seed=1)
    logs = TableWorld().simulate(SCENE, UniformPolicy(), episodes=2500, seed=7)
    mean = logs.stages.groupby("trajectory")["reward"].sum().mean()
    assert abs(found.value.value - mean) < 4.0 * found.value.standard_error
    assert found.value.low < found.value.value < found.value.high


def test_heuristics_meet_the_same_episodes():
    others = {"itself": LOGGER.base, "chance": UniformPolicy()}
    found, (itself, chance) = compare_in_world(LOGGER.base, others, [SCENE], CONFIG, episodes=300, seed=1)
    assert found == evaluate_in_world(LOGGER.base, [SCENE], CONFIG, episodes=300, seed=1)
    assert (itself.value, itself.difference.value, itself.difference.standard_error) == (found.value, 0.0, 0.0)
    assert chance.difference.value == pytest.approx(found.value.value - chance.value.value)
    assert chance.difference.low > 0
