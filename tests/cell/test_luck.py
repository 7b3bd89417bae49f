"""The luck of which cups are dirty: nothing in expectation, and most of what rewards vary by."""

import itertools

import numpy as np
import pytest

from halfseen.cell.luck import luck_of_table, luck_of_washing
from halfseen.world import WorldConfig

CONFIG = WorldConfig()


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
