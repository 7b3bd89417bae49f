"""Means of tables that were cut are told with what they are worth, and not where nothing came to its end."""

import itertools

import numpy as np
import pytest

from halfseen.cell import summary
from halfseen.cell.account import Run
from halfseen.cell.luck import luck_of_table, luck_of_washing
from halfseen.cell.summary import EPISODES_OF_A_PLANNER, EPISODES_PER_TABLE, summarised
from halfseen.logs import Logs
from halfseen.planners import POMDPPolicy
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.world import WorldConfig
from halfseen.world.rollout import evaluate

DECIDED = {"FINISH": 1}
CONFIG = WorldConfig()


def logs(num_tables):
    """First views of tables of two objects, the second half hidden by the first."""
    number = np.arange(num_tables)
    objects = {"path": np.repeat(number, 2), "stage": [1] * 2 * num_tables, "object": [0, 1] * num_tables}
    objects |= {"hidden_by": [[0.0, 0.0], [0.5, 0.0]] * num_tables, "grip": [0.0] * 2 * num_tables}
    stages = {
        "path": number,
        "stage": [1] * num_tables,
        "elapsed_s": [1.0] * num_tables,
        "action": ["FINISH"] * num_tables,
    }
    paths = {"path": number, "end_s": [1.0] * num_tables, "ending": ["finished"] * num_tables}
    return Logs(stages | {"reward": [0.0] * num_tables}, paths, objects)


def told(runs):
    return summarised(runs, logs(len(runs)), GreedyPolicy(CONFIG), CONFIG, 0)


def test_without_cuts_the_mean_is_the_mean():
    found = told([Run(verbs=DECIDED, reward=reward, seconds=10.0 + reward) for reward in (1.0, 3.0, 8.0)])
    assert found.reward.value == pytest.approx(4.0)
    assert found.reward.standard_error == pytest.approx(np.std([1, 3, 8], ddof=1) / np.sqrt(3))
    assert found.gap.value == pytest.approx(4.0 - found.predicted.value)


def test_a_cut_table_is_stood_for_by_longer_ones():
    runs = [
        Run(verbs=DECIDED, reward=1.0, seconds=10.0),
        Run(verbs=DECIDED, seconds=20.0, cause="battery"),
        Run(verbs=DECIDED, reward=7.0, seconds=30.0),
    ]
    assert told(runs).reward.value == pytest.approx((1.0 + 2 * 7.0) / 3)
    assert told(runs).causes == {"battery": 1}


@pytest.mark.parametrize("num_finished", [0, 1])
def test_where_nearly_all_was_cut_nothing_is_said(num_finished):
    runs = [Run(verbs=DECIDED, reward=2.0, seconds=5.0)] * num_finished + [
        Run(verbs=DECIDED, seconds=9.0, cause="battery")
    ] * (4 - num_finished)
    assert told(runs).reward is None
    assert told(runs).gap is None


@pytest.mark.parametrize(
    ("policy", "per_table"),
    [(GreedyPolicy(CONFIG), EPISODES_PER_TABLE), (POMDPPolicy(CONFIG, planning_horizon=1), EPISODES_OF_A_PLANNER)],
)
def test_a_planner_which_is_slow_foretells_from_few_episodes(policy, per_table, monkeypatch):
    played = []

    def counted(config, layouts, policy, key, num_episodes):
        played.append(num_episodes)
        return evaluate(config, layouts, policy, key, num_episodes)

    monkeypatch.setattr(summary, "evaluate", counted)
    runs = [Run(verbs=DECIDED, reward=reward, seconds=1.0) for reward in (1.0, 3.0)]
    found = summarised(runs, logs(2), policy, CONFIG, 0)
    assert played == [2 * per_table]
    assert np.isfinite(found.predicted.value)


def test_luck_is_told_apart_from_the_rest():
    runs = [Run(verbs=DECIDED, reward=r, luck=2.0 * r - 9.0, seconds=10.0 + r) for r in (1.0, 3.0, 8.0)]
    found = told(runs)
    assert (found.luck.value, found.without_luck.value) == pytest.approx((-1.0, 5.0))
    assert found.without_luck.standard_error == pytest.approx(np.std([1, 3, 8], ddof=1) / np.sqrt(3))
    assert found.gap.value == pytest.approx(4.0 - found.predicted.value)
    assert found.gap_without_luck.value == pytest.approx(5.0 - found.predicted.value)


def test_its_mean_over_what_may_be_dirty_is_zero():
    chances, total = np.array([0.2, 0.7, 0.55]), 0.0
    for dirty in itertools.product([False, True], repeat=4):
        # The first two seen cups are washed, the third is left, and the fourth is never seen.
        believed = np.append(chances, CONFIG.dirty_share)
        weight = np.prod(np.where(dirty, believed, 1.0 - believed))
        luck = luck_of_table(sum(dirty), 4, chances, CONFIG)
        luck += sum(luck_of_washing([dirty[k]], chances[k], CONFIG) for k in range(2))
        total += weight * luck
    assert total == pytest.approx(0.0, abs=1e-6)


def test_without_it_the_reward_is_the_expected_one_whatever_is_dirty():
    chances = np.array([0.2, 0.7, 0.55])
    found = set()
    for dirty in itertools.product([False, True], repeat=3):
        washed = sum(float(CONFIG.reward_wash_dirty if one else CONFIG.reward_wash_clean) for one in dirty[:2])
        reward = washed + float(CONFIG.reward_dirty_left) * dirty[2]
        luck = luck_of_table(sum(dirty), 3, chances, CONFIG)
        luck += sum(luck_of_washing([dirty[k]], chances[k], CONFIG) for k in range(2))
        found.add(round(reward - luck, 4))
    expected = sum(p * float(CONFIG.reward_wash_dirty) + (1 - p) * float(CONFIG.reward_wash_clean) for p in chances[:2])
    assert found == {round(expected + float(CONFIG.reward_dirty_left) * chances[2], 4)}
