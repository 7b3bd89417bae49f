import naive_planner
import numpy as np
import pytest
from naive_planner import CONFIG, Cup

from halfseen.arrays import record
from halfseen.errors import ArgumentError
from halfseen.planners import GreedyPolicy
from halfseen.planners.heuristics import TrueGrasp
from halfseen.planners.named import HEURISTICS
from halfseen.world import random
from halfseen.world.actions import FINISH
from tables import state_of

OPEN = np.zeros((2, 2))
HISTORY = GreedyPolicy(CONFIG, uses_history=True)
ALL = [GreedyPolicy(CONFIG, *how) for how in HEURISTICS.values()]


def chosen(policy, cups, hides=OPEN):
    return int(policy.decide(state_of(cups, hides), random.key_of(0)).action)


@pytest.mark.parametrize("policy", ALL)
def test_the_choice_is_the_best_of_all_expected_rewards(policy):
    rng, actions = np.random.default_rng(0), set()
    for least_dirty in np.repeat([0.3, 0.0], 15):
        cups = [
            Cup(p, tuple(zip(rng.random(k), rng.random(k) < 0.5, strict=True)), is_on_table)
            for p, k, is_on_table in zip(
                rng.uniform(least_dirty, least_dirty + 0.6, 4), [0, 1, 2, 3], rng.random(4) < 0.8, strict=True
            )
        ]
        hides = rng.uniform(0, 0.5, (4, 4)) * ~np.eye(4, dtype=bool)
        worth = [0.0, *(_worth(policy, cups, hides, i) for i in range(4))]
        actions.add(chosen(policy, cups, hides))
        assert chosen(policy, cups, hides) == int(np.argmax(worth))
    assert FINISH in actions
    assert len(actions) > 2


def _worth(policy, cups, hides, i):
    if not cups[i].is_on_table:
        return -np.inf
    cup = cups[i] if policy.uses_history else Cup(cups[i].is_dirty)
    grasped = naive_planner.chance(cup, naive_planner.occlusion(cups, hides, i))
    dirty = 10 if policy.counts_penalty else 5
    return grasped * (dirty * cup.is_dirty - 10 * (1 - cup.is_dirty)) - (1 - grasped)


@record
class Fixed:
    """A grasp model that says what it was told."""

    probabilities: np.ndarray

    def probability(self, state):
        return self.probabilities


@pytest.mark.parametrize("hidden", [0.0, 0.5])
def test_the_true_probability_is_that_of_plain_python(hidden):
    cups, hides = [Cup(0.9, ((0.2, False), (0.6, True))), Cup(0.9)], np.array([[0.0, hidden], [0.0, 0.0]])
    for uses_history in (True, False):
        known = TrueGrasp(CONFIG, uses_history).probability(state_of(cups, hides))
        expected = [
            naive_planner.chance(cup if uses_history else Cup(0.9), naive_planner.occlusion(cups, hides, i))
            for i, cup in enumerate(cups)
        ]
        np.testing.assert_allclose(known, expected, rtol=1e-5)


def test_another_grasp_model_replaces_the_true_probability():
    cups = [Cup(0.95), Cup(0.95)]
    for best in (0, 1):
        believed = Fixed(np.where(np.arange(2) == best, 0.9, 0.1))
        assert chosen(GreedyPolicy(CONFIG, uses_history=True, grasp=believed), cups) == 1 + best
    hopeless = Fixed(np.full(2, 0.01))
    assert chosen(GreedyPolicy(CONFIG, uses_history=True, grasp=hopeless), cups) == FINISH


def test_a_grasp_model_without_history_is_refused():
    with pytest.raises(ArgumentError, match="uses_history is False"):
        GreedyPolicy(CONFIG, grasp=Fixed(np.ones(2)))
