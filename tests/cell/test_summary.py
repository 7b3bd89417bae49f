"""Means of tables that were cut are reported with what they are worth, and not where nothing came to its end; luck."""

import itertools

import numpy as np
import pytest

from halfseen.cell import summary
from halfseen.cell.rewards import Run, luck_of_table, luck_of_washing
from halfseen.cell.summary import EPISODES_OF_A_PLANNER, EPISODES_PER_TABLE, summarised
from halfseen.logs import Logs
from halfseen.planners import POMDPPolicy
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.world import WorldConfig
from halfseen.world.rollout import evaluate

CONFIG = WorldConfig()
GREEDY = GreedyPolicy(CONFIG)


def logs_of_tables(num):
    """First views of tables of two objects, the second half hidden by the first."""
    number, ones = np.arange(num), [1] * num
    objects = {"trajectory": np.repeat(number, 2), "stage": ones * 2, "object": [0, 1] * num}
    objects |= {"hidden_by": [[0.0, 0.0], [0.5, 0.0]] * num, "grip": [0.0] * 2 * num}
    stages = {"trajectory": number, "stage": ones, "elapsed_s": [1.0] * num, "action": ["FINISH"] * num}
    trajectories = {"trajectory": number, "end_s": [1.0] * num, "ending": ["finished"] * num}
    return Logs(stages | {"reward": [0.0] * num}, trajectories, objects)


def summary_of(*runs, policy=GREEDY):
    """The summary of runs."""
    made = [Run(verbs={"FINISH": 1}, **run) for run in runs]
    return summarised(made, logs_of_tables(len(made)), policy, CONFIG, 0)


def test_without_cuts_the_mean_is_the_mean_and_luck_is_distinguished_from_the_rest():
    found = summary_of(*({"reward": r, "luck": 2.0 * r - 9.0, "seconds": 10.0 + r} for r in (1.0, 3.0, 8.0)))
    error = np.std([1, 3, 8], ddof=1) / np.sqrt(3)
    assert (found.reward.value, found.luck.value, found.without_luck.value) == pytest.approx((4.0, -1.0, 5.0))
    assert (found.reward.standard_error, found.without_luck.standard_error) == pytest.approx((error, error))
    assert found.gap.value == pytest.approx(4.0 - found.predicted.value)
    assert found.gap_without_luck.value == pytest.approx(5.0 - found.predicted.value)


def test_a_cut_table_is_stood_for_by_longer_ones_and_where_nearly_all_was_cut_nothing_is_said():
    cut = {"seconds": 20.0, "cause": "battery"}
    found = summary_of({"reward": 1.0, "seconds": 10.0}, cut, {"reward": 7.0, "seconds": 30.0})
    assert found.reward.value == pytest.approx((1.0 + 2 * 7.0) / 3)
    assert found.causes == {"battery": 1}
    for num_finished in (0, 1):
        found = summary_of(*[{"reward": 2.0, "seconds": 5.0}] * num_finished, *[cut] * (4 - num_finished))
        assert (found.reward, found.gap) == (None, None)


@pytest.mark.parametrize(
    ("policy", "per_table"),
    [(GREEDY, EPISODES_PER_TABLE), (POMDPPolicy(CONFIG, planning_horizon=1), EPISODES_OF_A_PLANNER)],
)
def test_a_planner_which_is_slow_foretells_from_few_episodes(policy, per_table, monkeypatch):
    asked = []
    monkeypatch.setattr(summary, "evaluate", lambda *given: (asked.append(given[-1]), evaluate(*given))[1])
    found = summary_of(*({"reward": reward, "seconds": 1.0} for reward in (1.0, 3.0)), policy=policy)
    assert asked == [2 * per_table]
    assert np.isfinite(found.predicted.value)


CHANCES = np.array([0.2, 0.7, 0.55])


def luck(dirty):
    """Of three seen cups the first two are washed, the third is left; a fourth, if there is one, is never seen."""
    washed = sum(luck_of_washing([dirty[k]], CHANCES[k], CONFIG) for k in range(2))
    return luck_of_table(sum(dirty), len(dirty), CHANCES, CONFIG) + washed


def test_the_mean_of_luck_is_zero_and_without_it_the_reward_is_the_expected_one():
    total, without = 0.0, set()
    for dirty in itertools.product([False, True], repeat=4):
        believed = np.append(CHANCES, CONFIG.dirty_share)
        total += np.prod(np.where(dirty, believed, 1.0 - believed)) * luck(dirty)
    assert total == pytest.approx(0.0, abs=1e-6)
    pays = {True: float(CONFIG.reward_wash_dirty), False: float(CONFIG.reward_wash_clean)}
    left = float(CONFIG.reward_dirty_left)
    for dirty in itertools.product([False, True], repeat=3):
        without.add(round(pays[dirty[0]] + pays[dirty[1]] + left * dirty[2] - luck(dirty), 4))
    expected = sum(p * pays[True] + (1 - p) * pays[False] for p in CHANCES[:2]) + left * CHANCES[2]
    assert without == {round(expected, 4)}
