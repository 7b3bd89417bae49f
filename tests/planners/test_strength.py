import numpy as np
import pytest

from halfseen.planners import GreedyPolicy, POMDPPolicy
from halfseen.world import Scene, WorldConfig, random
from halfseen.world.rollout import evaluate
from halfseen.world.state import pad_scenes

CONFIG = WorldConfig()
NUM_EPISODES = 3000


@pytest.mark.slow
def test_looking_further_ahead_earns_more_on_the_same_tables():
    rng = np.random.default_rng(0)
    scenes = [Scene(rng.uniform(0, 0.5, (n, n)) * (rng.random((n, n)) < 0.4) * ~np.eye(n, dtype=bool)) for n in (4, 6)]
    layouts = pad_scenes(scenes)

    def rewards(policy):
        return np.asarray(evaluate(CONFIG, layouts, policy, random.key_of(0), NUM_EPISODES).reward)

    heuristics = [
        rewards(GreedyPolicy(CONFIG, uses_history=h, counts_penalty=p)) for h in (False, True) for p in (False, True)
    ]
    best = max(heuristics, key=np.mean)
    one, two = rewards(POMDPPolicy(CONFIG, 1)), rewards(POMDPPolicy(CONFIG, 2, 32))

    assert np.mean(one - best) > 3 * standard_error(one - best)
    assert np.mean(two - one) > 3 * standard_error(two - one)


@pytest.mark.slow
def test_more_simulations_earn_no_less_on_the_same_tables():
    rng, config = np.random.default_rng(1), WorldConfig(horizon=5)
    scenes = [Scene(rng.uniform(0, 0.5, (4, 4)) * (rng.random((4, 4)) < 0.4) * ~np.eye(4, dtype=bool)) for _ in "abc"]
    layouts = pad_scenes(scenes)

    def rewards(policy):
        return np.asarray(evaluate(config, layouts, policy, random.key_of(0), 300).reward, dtype=float)

    myopic, few, many = (rewards(POMDPPolicy(config, h, n)) for h, n in ((1, 1), (5, 16), (5, 128)))

    assert np.mean(many - few) > -2 * standard_error(many - few)
    assert np.mean(many - myopic) > -2 * standard_error(many - myopic)


def standard_error(values):
    return np.std(values) / np.sqrt(len(values))
