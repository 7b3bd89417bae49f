"""How strong an unrecorded cause of cuts undoes a verdict: a linear programme, extremes, a world with such a cause."""

import numpy as np
import pytest
from scipy.optimize import linprog

from halfseen.evaluation.estimate import around
from halfseen.evaluation.sensitivity import STRONGEST, shift, undone_at


@pytest.fixture
def stages():
    rng = np.random.default_rng(0)
    excess = np.where(rng.random((40, 3)) < 0.3, 0.0, rng.exponential(size=(40, 3)))
    return excess, rng.normal(size=(40, 3)).round(1)


def by_linear_programme(excess, error, gamma):
    """Each weight within its bounds, the sum of each stage what it was."""
    total = 0.0
    for w, v in zip(excess.T, error.T, strict=True):
        bounds = [(-(1.0 - 1.0 / gamma) * each, (gamma - 1.0) * each) for each in w]
        total += linprog(v, A_eq=np.ones((1, len(v))), b_eq=[0.0], bounds=bounds).fun
    return total / len(excess)


@pytest.mark.parametrize("gamma", [1.0, 1.3, 2.0, 7.0])
def test_it_is_the_worst_of_all_weights_that_are_allowed(stages, gamma):
    assert shift(*stages, gamma) == pytest.approx(by_linear_programme(*stages, gamma), abs=1e-9)


def test_the_interval_ends_at_zero_where_it_says(stages):
    excess, error = stages
    above, below = around(0.5, 0.1, 40, 39, 0.95), around(-0.5, 0.1, 40, 39, 0.95)
    gamma = undone_at(above, excess, error)
    assert above.low + shift(excess, error, gamma) == pytest.approx(0.0, abs=1e-9)
    assert undone_at(below, excess, -error) == pytest.approx(gamma)


def test_what_holds_zero_needs_no_cause_and_what_no_weight_touches_none_undoes(stages):
    excess, error = stages
    assert undone_at(around(0.1, 0.1, 40, 39, 0.95), excess, error) == 1.0
    assert undone_at(around(0.5, 0.1, 40, 39, 0.95), excess, np.ones_like(error)) == STRONGEST
    assert undone_at(around(0.5, 0.1, 40, 39, 0.95), np.zeros_like(excess), error) == STRONGEST


def test_a_hidden_cause_of_that_strength_shifts_the_mean_by_no_more():
    """A hidden z doubles and halves the odds of being cut, and moves the outcome; weights know but their mean."""
    rng = np.random.default_rng(1)
    z, strength = rng.integers(0, 2, 400_000), 2.0
    outcome = rng.normal(size=len(z)) + z
    odds = np.where(z == 1, strength, 1.0 / strength)
    is_seen = rng.random(len(z)) < 1.0 / (1.0 + odds)
    weight = np.where(is_seen, 1.0 / is_seen.mean(), 0.0)
    excess = np.where(is_seen, weight - 1.0, 0.0)[:, None]
    marginal = (1.0 - is_seen.mean()) / is_seen.mean()
    gamma = max(odds.max() / marginal, marginal / odds.min())
    bias = outcome.mean() - np.mean(weight * outcome)
    assert bias > 0.1
    assert bias < -shift(excess, -outcome[:, None], gamma)
    assert bias > -shift(excess, -outcome[:, None], 1.1)
