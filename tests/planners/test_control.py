"""Rewards by the control variate: exact by hand, of the same mean as raw ones, and with less noise."""

from dataclasses import replace

import numpy as np
import pytest

from fitted_laws import FITTED
from halfseen.planners import POMDPPolicy, named_policy
from halfseen.planners.control import controlled, controlled_each, start_values
from halfseen.world import AssumedGrasping, Scene, UniformPolicy, WorldConfig, random
from halfseen.world.policy import surely
from halfseen.world.rollout import evaluate_some, play
from halfseen.world.state import pad_scenes

TABLES = pad_scenes([Scene(np.tril(np.full((n, n), 0.4), -1), name=str(n)) for n in (2, 4)])
ALONE = pad_scenes([Scene(np.zeros((1, 1)))])
FINISH, WASH = 0, 1


class Always:
    """Takes the same action at every table."""

    def __init__(self, action):
        self.action = action

    def decide(self, state, key):
        return surely(np.full(len(state.log_odds), self.action))


def washed(config, p, to_go):
    """What trying to wash one object in every step left earns: it is never hidden, and its grip has no offset."""
    law = config.grasping
    holds = 1.0 - np.exp(-law.limit_s / np.exp(law.log_time))
    missed = -1.0 + (-5.0 * p if to_go == 1 else washed(config, p, to_go - 1))
    return holds * (5.0 * p - 10.0 * (1.0 - p)) + (1.0 - holds) * missed


def first_beliefs(config, key, episodes):
    """P(DIRTY) after the first look, right with probability .8."""
    log_odds = play(config, ALONE, Always(FINISH), key, len(episodes)).states.log_odds[:, 0, 0]
    return 1.0 / (1.0 + np.exp(-log_odds.astype(np.float64)))


def test_with_one_object_and_one_step_it_is_what_is_expected_of_the_action():
    config = WorldConfig(grasping=AssumedGrasping(offset_std=0.0), horizon=1)
    episodes, key = np.arange(40), random.key_of(3)
    p = first_beliefs(config, key, episodes)
    assert sorted(set(p.round(6))) == pytest.approx([0.3 / 1.1, 1.2 / 1.4], abs=1e-5)
    for action, expected in ((FINISH, -5.0 * p), (WASH, washed(config, p, 1))):
        assert controlled(config, ALONE, Always(action), key, episodes).reward == pytest.approx(expected, abs=1e-4)


def test_with_two_steps_its_mean_is_what_is_expected_by_hand():
    config = WorldConfig(grasping=AssumedGrasping(offset_std=0.0), horizon=2)
    episodes, key = np.arange(6000), random.key_of(4)
    p = first_beliefs(config, key, episodes)
    gap = controlled(config, ALONE, Always(WASH), key, episodes).reward - washed(config, p, 2)
    for which in (p > 0.5, p < 0.5):
        error = gap[which].std() / np.sqrt(which.sum())
        assert abs(gap[which].mean()) < max(4.0 * error, 1e-4)
        assert error < 0.05


@pytest.mark.parametrize("config", [WorldConfig(horizon=6), replace(FITTED, horizon=6)], ids=["assumed", "fitted"])
@pytest.mark.parametrize("who", ["history-penalty", "one-step", "uniform"])
def test_its_mean_is_that_of_the_rewards_and_its_noise_is_less(config, who):
    policy = {"one-step": POMDPPolicy(config, 1), "uniform": UniformPolicy()}.get(who) or named_policy(who, config)
    episodes, key = np.arange(2000), random.key_of(5)
    ours = controlled(config, TABLES, policy, key, episodes)
    raw = evaluate_some(config, TABLES, policy, key, episodes)
    gap = ours.reward - np.asarray(raw.reward, dtype=np.float64)
    assert abs(gap.mean()) < 4.0 * gap.std() / np.sqrt(len(gap))
    np.testing.assert_allclose(ours.robot_s, raw.robot_s, rtol=1e-5)
    most = 0.9 if who == "uniform" else 0.5
    assert ours.reward.var() < most * np.asarray(raw.reward).var()


def test_several_policies_side_by_side_earn_what_they_earn_alone_and_begin_alike():
    config, key, episodes = replace(FITTED, horizon=4), random.key_of(6), np.array([1, 4, 6, 7])
    policies = [named_policy(name, config) for name in ("greedy", "history-penalty")] + [POMDPPolicy(config, 1)]
    together = controlled_each(config, TABLES, policies, key, episodes)
    begun = start_values(config, TABLES, key, episodes)
    for policy, ours in zip(policies, together, strict=True):
        alone = controlled(config, TABLES, policy, key, episodes)
        for each, other in zip(ours, alone, strict=True):
            np.testing.assert_allclose(each, other, atol=1e-5)
        np.testing.assert_allclose(ours.value, begun, atol=1e-5)
