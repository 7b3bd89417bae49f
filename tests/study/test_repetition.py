import jax
import numpy as np
import pytest

from halfseen.learners import CensoredQLearner
from halfseen.learners.q_learning.encoding import Encoded, encode_states
from halfseen.study.learning import learn
from halfseen.study.policies import logging_policy
from halfseen.study.repetition import cut_rates
from halfseen.study.treatments import treat
from halfseen.world import Scene
from halfseen.world.cuts import cut
from halfseen.world.episodes import evaluate, play
from halfseen.world.recording import to_logs
from halfseen.world.state import pad_scenes

pytestmark = pytest.mark.slow

NUM_PATHS = 40


@pytest.fixture(scope="module")
def scenes():
    rng = np.random.default_rng(0)
    return [Scene(rng.uniform(0, 0.4, (n, n)) * ~np.eye(n, dtype=bool), name=f"table {n}") for n in (3, 4)]


@pytest.fixture(scope="module")
def layouts(scenes):
    return pad_scenes(scenes)


@pytest.fixture(scope="module")
def rates(tiny_design, layouts):
    return cut_rates(tiny_design, layouts)


def test_a_batch_of_treatments_is_what_the_estimator_learns_from_the_same_logs(tiny_design, scenes, layouts, rates):
    world = tiny_design.world
    episodes = play(world, layouts, logging_policy(tiny_design), jax.random.key(3), NUM_PATHS)
    cuts = cut(episodes, rates["independent", 0.5], "independent", np.random.default_rng(0))
    features, is_possible = (np.asarray(leaf) for leaf in encode_states(episodes.states))
    # The folds that the estimator deals with random_state=0.
    fold = np.random.default_rng(0).permutation(NUM_PATHS) % 5
    treated = [treat(cuts, treatment, world) for treatment in ("weighted", "unweighted")]

    together = learn(Encoded(features, is_possible, np.asarray(episodes.action)), treated, fold)

    logs = to_logs(cuts, "independent", scenes)
    for coefficients, censoring in zip(together.coefficients, ("kaplan-meier", "none"), strict=True):
        alone = CensoredQLearner.for_table(world.horizon, censoring=censoring).fit(logs)
        np.testing.assert_allclose(coefficients, alone.policy_.coefficients, rtol=1e-5, atol=1e-6)


def test_the_rates_cut_the_wanted_share(tiny_design, layouts, rates):
    episodes = play(tiny_design.world, layouts, logging_policy(tiny_design), jax.random.key(4), 2000)
    shares = {
        key: 1 - cut(episodes, rate, key[0], np.random.default_rng(1)).is_finished.mean() for key, rate in rates.items()
    }

    assert set(rates) == {("independent", 0.0), ("independent", 0.5), ("attempt", 0.5)}
    assert shares["independent", 0.0] == 0.0
    assert shares["independent", 0.5] == pytest.approx(0.5, abs=0.04)
    assert shares["attempt", 0.5] == pytest.approx(0.5, abs=0.04)


def test_all_policies_meet_the_same_tables(tiny_design, layouts):
    policy, key = logging_policy(tiny_design), jax.random.key(5)
    once, again = (evaluate(tiny_design.world, layouts, policy, key, 6) for _ in range(2))
    other = play(tiny_design.world, layouts, policy.base, key, 6)
    ours = play(tiny_design.world, layouts, policy, key, 6)

    np.testing.assert_array_equal(once.reward, again.reward)
    for leaf, same in zip(jax.tree.leaves(ours.hidden), jax.tree.leaves(other.hidden), strict=True):
        np.testing.assert_array_equal(leaf, same)
    np.testing.assert_array_equal(ours.states.log_odds[:, 0], other.states.log_odds[:, 0])
