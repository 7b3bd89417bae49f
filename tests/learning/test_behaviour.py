"""The behaviour policy beside scikit-learn, and what it waives of a margin, by hand."""

from dataclasses import replace

import numpy as np
import pandas as pd
from sklearn.linear_model import LogisticRegression

from halfseen.learning import CensoredQLearner, FlatPolicy
from halfseen.learning.behaviour import choice_probabilities, conditional_logit, fit_choice, leaning
from halfseen.logs import Logs

COVARIATES = ["x1", "x2"]


def chosen(num_rows=300, seed=0):
    """Three actions on two covariates, one of them far from 0 and on another scale."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(num_rows, 2)) * [1.0, 20.0] + [0.0, 500.0]
    utility = np.stack([x[:, 0], -x[:, 0], 0.05 * (x[:, 1] - 500.0)], axis=1)
    return x, (utility + rng.gumbel(size=utility.shape)).argmax(axis=1)


def test_of_named_actions_it_is_scikit_learns_multinomial_regression():
    x, taken = chosen()
    features = np.repeat(x[:, None], 3, axis=1)
    ours = conditional_logit(features, np.ones((300, 3), dtype=bool), taken, np.arange(3))
    z = (x - x.mean(axis=0)) / x.std(axis=0)
    theirs = LogisticRegression(C=1.0, tol=1e-10, max_iter=10_000).fit(z, taken).predict_proba(z)
    np.testing.assert_allclose(ours, theirs, atol=1e-4)


def test_rows_that_weigh_nothing_are_answered_and_not_fitted_to():
    x, taken = chosen()
    features, possible = np.repeat(x[:, None], 3, axis=1), np.ones((300, 3), dtype=bool)
    weight = (np.arange(300) < 200).astype(float)
    other = np.where(weight > 0, taken, 0)
    one, two = (conditional_logit(features, possible, each, np.arange(3), weight) for each in (taken, other))
    np.testing.assert_array_equal(one, two)
    alone = fit_choice(features[:200], possible[:200], taken[:200], np.arange(3))
    np.testing.assert_allclose(
        one[250], choice_probabilities(alone[:, 0] + alone[:, 1:] @ x[250], np.ones(3, dtype=bool)), rtol=1e-12
    )


def test_what_is_not_possible_is_never_chosen_and_no_choice_is_certain():
    utility = np.array([1.0, 5.0, 1.0])
    np.testing.assert_allclose(choice_probabilities(utility, np.array([True, False, True])), [0.5, 0.0, 0.5])
    np.testing.assert_allclose(choice_probabilities(utility, np.array([False, True, False])), [0.0, 1.0, 0.0])


def test_leaning_is_nothing_at_chance_and_all_at_certainty():
    possible = np.asarray([True, True, True, False])
    utility = np.log(np.asarray([[1.0, 1.0, 1.0, 9.0], [4.0, 1.0, 1.0, 9.0], [1e30, 1.0, 1.0, 9.0]]))
    expected = [[0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]]
    np.testing.assert_allclose(leaning(utility, possible), expected, atol=1e-6)
    only = np.asarray([False, False, True, False])
    np.testing.assert_allclose(leaning(utility, only)[:, 2], 1.0)


FLAT = FlatPolicy(
    actions=("A", "B"),
    covariates=("x",),
    is_possible=np.ones((1, 2), dtype=bool),
    coefficients=np.array([[[1.0, 0.0], [1.2, 0.0]]]),
    margin=np.array([[[[0.5, 0.0], [0.0, 0.0]], [[1.0, 0.0], [0.0, 0.0]]]]),
    behaviour=np.array([[0.0, 0.0], [0.0, 1.0]]),
)


def test_a_margin_counts_as_far_as_the_log_does_something_else():
    frame = pd.DataFrame({"x": [0.0, np.log(3.0), np.log(19.0)]})
    # The log takes B in 1/2, 3/4 and 19/20 of the times: its margin of 1 counts in full, half and a tenth.
    np.testing.assert_allclose(FLAT.scores(frame, 1), [[0.5, 0.2], [0.5, 0.7], [0.5, 1.1]], atol=1e-12)
    np.testing.assert_allclose(FLAT.lower_bounds(frame, 1), [[0.5, 0.2]] * 3)
    assert FLAT.decide(frame, 1).tolist() == ["A", "B", "B"]
    unknown = replace(FLAT, behaviour=None)
    np.testing.assert_array_equal(unknown.scores(frame, 1), unknown.lower_bounds(frame, 1))


def logs_of(habit, num_trajectories=40, seed=0):
    """One stage; rewards are noise alone, and the log takes an action by whether x is positive, or by lot."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=num_trajectories)
    taken = x > 0 if habit else rng.random(num_trajectories) < 0.5
    flipped = taken ^ (rng.random(num_trajectories) < 0.1)
    stages = {
        "trajectory": np.arange(num_trajectories),
        "stage": [1] * num_trajectories,
        "elapsed_s": [1.0] * num_trajectories,
    }
    stages |= {"action": np.where(flipped, "A", "B"), "reward": rng.normal(size=num_trajectories), "x": x}
    trajectories = {
        "trajectory": np.arange(num_trajectories),
        "end_s": [1.0] * num_trajectories,
        "ending": ["finished"] * num_trajectories,
    }
    return Logs(pd.DataFrame(stages), trajectories)


def test_where_nothing_else_is_known_the_policy_does_what_the_log_does():
    frame = pd.DataFrame({"x": [-2.0, 2.0]})
    agreed = []
    for seed in range(10):
        learner = CensoredQLearner(1, ["A", "B"], ["x"], pessimism=6.0).fit(logs_of(True, seed=seed))
        agreed.append((learner.decide(frame, 1) == ["B", "A"]).mean())
    assert np.mean(agreed) > 0.9


def test_a_log_by_lot_waives_almost_nothing():
    learner = CensoredQLearner(1, ["A", "B"], ["x"]).fit(logs_of(False, num_trajectories=400))
    frame = pd.DataFrame({"x": [-1.0, 0.0, 1.0]})
    q, low, score = (getattr(learner.policy_, name)(frame, 1) for name in ("q_values", "lower_bounds", "scores"))
    assert ((score - low) <= 0.2 * (q - low)).all()


def test_without_pessimism_there_is_nothing_to_waive():
    learner = CensoredQLearner(1, ["A", "B"], ["x"], pessimism=0.0).fit(logs_of(True))
    assert learner.policy_.behaviour is None
