"""An interval that allows for a bias of either sign, and the bias that an evaluation allows for."""

import numpy as np
import pytest
from enumerated_trial import StatePolicy, trial
from scipy import stats

from halfseen.evaluation import evaluate
from halfseen.evaluation.estimate import around
from halfseen.evaluation.off_policy import default_q, q_model_of
from halfseen.evaluation.problem import as_logged, problem_of
from halfseen.learning import DoublyRobust

TARGET = StatePolicy((0.1, 0.8))
BOUNDED = DoublyRobust("cox", by="pooled", truncate_at=3)
"""So low a bound that regressions often stand alone."""


@pytest.mark.parametrize("bias", [0.0, 0.01, 0.3, 5.0])
@pytest.mark.parametrize("freedom", [3, 40])
def test_it_holds_the_truth_as_often_as_it_says_at_the_largest_bias(bias, freedom):
    found = around(0.0, 0.5, 50, freedom, 0.9, bias)
    reach = found.high
    held = stats.t.cdf((reach - bias) / 0.5, freedom) - stats.t.cdf((-reach - bias) / 0.5, freedom)
    assert held == pytest.approx(0.9)
    assert -found.low == reach <= stats.t.ppf(0.95, freedom) * 0.5 + bias + 1e-12


@pytest.mark.parametrize("bias", [0.0, 0.2, 1.5])
def test_the_p_value_is_one_less_the_level_whose_interval_ends_at_0(bias):
    found = around(1.7, 0.6, 50, 12, 0.5, bias)
    assert around(1.7, 0.6, 50, 12, 1.0 - found.p_value, bias).low == pytest.approx(0.0, abs=1e-9)


def test_an_estimate_that_nothing_can_change_is_certain():
    assert around(0.0, 0.0, 50, 12, 0.95).p_value == 1.0
    assert around(0.1, 0.0, 50, 12, 0.95).p_value == 0.0
    assert around(0.1, 0.0, 50, 12, 0.95, 0.2).p_value == 1.0
    assert around(0.1, 0.0, 50, 12, 0.95, 0.2).low == pytest.approx(-0.1)


def problem(logs):
    spec, widened = default_q(TARGET, logs)
    model = q_model_of(TARGET, widened, BOUNDED, spec)
    return problem_of(TARGET, widened, model, "logged", np.random.default_rng(0), 5)


def test_what_no_weight_corrects_is_what_the_shares_leave():
    own = as_logged(problem(trial(3, num_paths=400, cut_rate=0.4)))
    given = own.nuisances[-1]
    paths, share, weights = own.paths, given.imputation.share, own.weights(given)
    total = 0.0
    for stage in range(paths.action.shape[1]):
        begun = np.flatnonzero(paths.is_begun[:, stage])
        mean = np.mean(weights.standing[:, stage])
        total += sum(weights.weight[i, stage] / mean * (1.0 - share[i, stage]) for i in begun) / paths.num_paths
    assert own.uncorrected_weight == pytest.approx(max(total, 0.0))


def test_where_nothing_was_cut_no_bias_is_allowed_for():
    assert problem(trial(3, num_paths=200)).uncorrected_weight == 0.0
    assert evaluate(TARGET, trial(3, num_paths=200)).doubly_robust.bias == 0.0


def test_what_two_policies_share_is_not_held_against_their_difference():
    """Half of the paths are cut, and a long stage nearly always: values may be biased, their difference hardly."""
    logs = trial(4, num_paths=400, cut_rate=0.25)
    found = evaluate(StatePolicy((0.3, 0.7)), logs, against="logging", censoring=BOUNDED)
    assert 0.0 < found.difference.bias < 0.2 * found.logging.bias
