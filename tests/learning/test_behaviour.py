"""The behaviour policy beside scikit-learn, and what it waives of a margin."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize, rosen, rosen_der, rosen_hess
from sklearn.linear_model import LogisticRegression
from trials import log_of

from halfseen.learning import CensoredQLearner, DiscretePolicy
from halfseen.learning.behaviour import (
    MAX_STEPS,
    choice_probabilities,
    conditional_logit,
    excess_propensity,
    fit_choice,
    minimise_each,
)


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
    np.testing.assert_allclose(excess_propensity(utility, possible), expected, atol=1e-6)
    only = np.asarray([False, False, True, False])
    np.testing.assert_allclose(excess_propensity(utility, only)[:, 2], 1.0)


FLAT = DiscretePolicy(
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
    return log_of(np.where(flipped, "A", "B"), rng.normal(size=num_trajectories), x=x)


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


# Newton steps on several functions at once


def rosenbrocks(theta):
    return tuple(np.array([of(each) for each in theta]) for of in (rosen, rosen_der, rosen_hess))


def test_curved_valleys_are_followed_to_their_end():
    start = np.array([[-1.2, 1.0, 0.5], [2.0, -1.5, 0.0], [1.0, 1.0, 1.0]])
    np.testing.assert_allclose(minimise_each(rosenbrocks, start), 1.0, atol=1e-8)


def test_functions_that_bend_down_are_left_downhill():
    def wells(theta):
        """Two minima, and a top between them at which the first begins; the second is a bowl."""
        x = theta[:, 0]
        value = np.array([(x[0] ** 2 - 1.0) ** 2, (x[1] - 3.0) ** 2])
        slope = np.array([4.0 * x[0] * (x[0] ** 2 - 1.0), 2.0 * (x[1] - 3.0)])
        bend = np.array([12.0 * x[0] ** 2 - 4.0, 2.0])
        return value, slope[:, None], bend[:, None, None]

    np.testing.assert_allclose(minimise_each(wells, np.array([[0.1], [50.0]])), [[1.0], [3.0]], atol=1e-8)


def test_it_agrees_with_scipy_where_logits_saturate():
    rng = np.random.default_rng(1)
    design, sign = rng.normal(size=(60, 2)), np.where(rng.random((5, 60)) < 0.9, 1.0, -1.0)

    def logistic(theta, sign=sign):
        margin = sign * (theta @ design.T)
        wrong = 1.0 / (1.0 + np.exp(margin))
        value = np.logaddexp(0.0, -margin).sum(axis=1) + (theta**2).sum(axis=1) / 200.0
        bend = (wrong * (1.0 - wrong))[:, :, None, None] * design[:, :, None] * design[:, None, :]
        return value, theta / 100.0 - (sign * wrong) @ design, bend.sum(axis=1) + np.eye(2) / 100.0

    found = minimise_each(logistic, np.full((5, 2), 8.0))
    for k, theta in enumerate(found):
        of_one = [lambda at, i=i, k=k: logistic(at[None], sign[k : k + 1])[i][0] for i in range(2)]
        peer = minimize(of_one[0], np.zeros(2), jac=of_one[1], options={"gtol": 1e-9})
        np.testing.assert_allclose(theta, peer.x, atol=1e-6)


@pytest.mark.parametrize("value", [np.inf, np.nan])
def test_what_cannot_be_lowered_ends(value):
    asked = []

    def cliff(theta):
        asked.append(1)
        is_start = theta[:, 0] == 0.0
        return np.where(is_start, 0.0, value), np.ones_like(theta), np.ones((len(theta), 1, 1))

    assert minimise_each(cliff, np.zeros((1, 1))).tolist() == [[0.0]]
    assert len(asked) < MAX_STEPS


def test_without_pessimism_there_is_nothing_to_waive():
    learner = CensoredQLearner(1, ["A", "B"], ["x"], pessimism=0.0).fit(logs_of(True))
    assert learner.policy_.behaviour is None


@pytest.mark.parametrize("same", [0.1, 0.7, 1 / 3])
def test_what_never_differed_says_nothing_where_it_does(same):
    """The mean of 1,000 equal numbers may be off by a rounding, which is no deviation."""
    num = 1001
    features = np.full((num, 2, 1), same)
    features[0] += 1.0
    taken = (np.random.default_rng(num).random(num) < 0.5).astype(int)
    weight, allowed = (np.arange(num) > 0).astype(float), np.ones((num, 2), dtype=bool)
    found = conditional_logit(features, allowed, taken, np.arange(2), weight)
    np.testing.assert_allclose(found[0], found[1], atol=1e-6)
