"""What tells grasps where nothing is said: held-out attempts decide, against naive sums; what cannot decide keeps."""

import numpy as np
import pytest
from scipy.optimize import minimize
from tried import beta_attempts, cut_some

from halfseen.censoring import censoring_weights
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.tables import BetaGrasp
from halfseen.tables.grasp.choice import FEWEST_ATTEMPTS, NUM_FOLDS, choose_by, choose_grasp, fit_grip_effect
from halfseen.tables.grasp.grasp_table import GraspTable, tabulate
from halfseen.world import Scene, TableWorld, UniformPolicy

HORIZON = 10


def attempts_of(num_objects, intercept, slope, seed=0):
    """Two objects a path."""
    tried = cut_some(beta_attempts(num_objects, intercept=intercept, slope=slope, seed=seed))
    return tried.assign(path=tried["object"] // 2, stage=1, grip=0.0)


def naive_beta(attempts):
    """Chances by the intercept, slope and log s that a search without gradients finds, sum by sum."""

    def chance(theta, occlusion, k, misses):
        strength = np.exp(theta[2])
        return (strength / (1 + np.exp(-theta[0] - theta[1] * occlusion)) + k) / (strength + k + misses)

    def loss(theta):
        total = (theta[0] / 5) ** 2 / 2 + (theta[1] / 5) ** 2 / 2 + ((theta[2] - np.log(2)) / 2) ** 2 / 2
        for occlusion, k, misses, held, weight in attempts:
            p = chance(theta, occlusion, k, misses)
            total -= weight * np.log(p if held else 1 - p)
        return total

    options = {"xatol": 1e-4, "fatol": 1e-4, "maxiter": 400}
    theta = minimize(loss, [0.0, 0.0, np.log(2)], method="Nelder-Mead", options=options).x
    return lambda *of: chance(theta, *of)


def by_hand(tried):
    """Squared errors of the rule and of the Beta, path by path."""
    tried = tried.assign(weight=censoring_weights(tried["time_s"], tried["is_finished"]))
    paths = sorted(set(tried["path"]))
    columns = ["occlusion", "successes", "failures", "succeeded", "weight"]
    rows = {path: tried[(tried["path"] == path) & tried["is_finished"]][columns].to_numpy(float) for path in paths}
    errors = np.zeros((len(paths), 2))
    for k in range(NUM_FOLDS):
        beta = naive_beta([row for rank, path in enumerate(paths) if rank % NUM_FOLDS != k for row in rows[path]])
        for rank in range(k, len(paths), NUM_FOLDS):
            for occlusion, successes, failures, held, weight in rows[paths[rank]]:
                rule = (1 - occlusion) * (1 + successes) / (1 + successes + failures)
                said = np.array([rule, beta(occlusion, successes, failures)])
                errors[rank] += weight * (said - held) ** 2
    return errors.T


@pytest.mark.parametrize(("intercept", "slope"), [(6.0, 0.0), (3.0, 0.0), (1.5, -3.0)])
def test_a_beta_is_taken_where_it_halves_the_error_of_held_out_attempts_beyond_noise(intercept, slope):
    tried = attempts_of(60, intercept, slope)
    rule, beta = by_hand(tried)
    lead = rule / 2 - beta
    chosen = choose_by(tried, HORIZON)
    assert f"{beta.sum() / rule.sum():.0%} of its squared error" in chosen.sentence
    assert (chosen.grasp is not None) == (lead.mean() > 2 * lead.std(ddof=1) / np.sqrt(len(lead))) == (slope == 0.0)


def test_where_what_is_hidden_is_as_easy_a_beta_is_taken_and_fitted_to_all():
    tried = attempts_of(60, 3.0, 0.0)
    chosen = choose_by(tried, HORIZON)
    assert chosen.grasp is not None
    beta = BetaGrasp().fit(tried)
    expected = tabulate(beta, HORIZON, fit_grip_effect(beta, tried))
    np.testing.assert_array_equal(chosen.grasp.probabilities, expected.probabilities)
    assert "learned from the log’s attempts" in chosen.sentence


def test_where_the_rule_is_as_good_it_is_kept():
    rng = np.random.default_rng(3)
    tried = attempts_of(40, 3.0, 0.0).assign(successes=0.0, failures=0.0)
    succeeded = rng.random(len(tried)) < 1.0 - tried["occlusion"]
    kept = tried.assign(succeeded=succeeded.astype("boolean").mask(~tried["is_finished"]))
    chosen = choose_by(kept, HORIZON)
    assert chosen.grasp is None
    assert "does not clearly halve its error" in chosen.sentence


def test_few_attempts_decide_nothing():
    tried = attempts_of(60, 3.0, 0.0)
    few = tried[np.cumsum(tried["is_finished"]) < FEWEST_ATTEMPTS]
    chosen = choose_by(few, HORIZON)
    assert chosen.grasp is None
    assert f"{FEWEST_ATTEMPTS - 1} decided attempts are too few" in chosen.sentence


@pytest.fixture(scope="module")
def logs():
    hides = np.zeros((4, 4))
    hides[1, 0], hides[2, 1], hides[3, 2] = 0.7, 0.45, 0.33
    return TableWorld().simulate(Scene(hides), UniformPolicy(), episodes=60, seed=0, cut_share=0.3)


def test_the_learner_chooses_by_itself_and_says_why(logs):
    chosen = choose_grasp(logs, HORIZON)
    learner = CensoredQLearner.for_table(reg=1.0).fit(logs)
    assert learner.chosen_ == (chosen.sentence,)
    assert isinstance(learner.policy_.grasp, GraspTable) == (chosen.grasp is not None)


def test_a_log_that_does_not_tell_its_outcomes_keeps_the_rule(logs):
    silent = Logs(logs.stages, logs.paths, logs.objects.assign(successes=0, failures=0))
    chosen = choose_grasp(silent, HORIZON)
    assert chosen.grasp is None
    assert "mend the counts" in chosen.sentence
