"""The small models of a rule against scikit-learn's of the same kind."""

import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression
from sklearn.preprocessing import PolynomialFeatures, StandardScaler
from sklearn.tree import DecisionTreeClassifier

from halfseen.evaluation import rule_models
from halfseen.evaluation.rule_models import forest_shares, logit_shares

NUM_ROWS, NUM_ACTIONS = 400, 3


@pytest.fixture(scope="module")
def rows():
    """States that float32 holds exactly, noisy actions, and weights."""
    rng = np.random.default_rng(0)
    states = rng.normal(size=(NUM_ROWS, 3)).astype(np.float32).astype(np.float64)
    by_rule = np.where(states[:, 0] > 0.2, 0, np.where(states[:, 1] * states[:, 2] > 0.0, 1, 2))
    action = np.where(rng.random(NUM_ROWS) < 0.2, rng.integers(NUM_ACTIONS, size=NUM_ROWS), by_rule)
    return states, action, rng.uniform(0.5, 2.0, size=NUM_ROWS)


def votes_of(action, weight):
    return weight[:, None] * (action[:, None] == np.arange(NUM_ACTIONS))


@pytest.mark.parametrize("least", [1, 3, 20])
def test_a_tree_is_that_of_scikit_learn(rows, least, monkeypatch):
    monkeypatch.setattr(rule_models, "PURE", 1.0 - 1e-12)
    states, action, weight = rows
    fitted = np.arange(NUM_ROWS) < 250
    found = rule_models._tree_shares(states[fitted], votes_of(action, weight)[fitted], states, least)
    tree = DecisionTreeClassifier(min_samples_leaf=least, random_state=0)
    expected = tree.fit(states[fitted], action[fitted], sample_weight=weight[fitted]).predict_proba(states)
    np.testing.assert_allclose(found[fitted], expected[fitted], atol=1e-12)
    # Between rows of a small leaf several features part the votes equally well, and either takes its own.
    alike = np.isclose(found, expected, atol=1e-12).all(axis=1)
    assert alike.all() if least == 20 else alike.mean() > 0.98


def test_the_logit_is_that_of_scikit_learn(rows, monkeypatch):
    monkeypatch.setattr(rule_models, "TOLERANCE", 1e-7)
    monkeypatch.setattr(rule_models, "MOST_STEPS", 5000)
    states, action, weight = rows
    design = PolynomialFeatures(2, include_bias=False).fit_transform(StandardScaler().fit_transform(states))
    logit = LogisticRegression(C=1.0 / rule_models.RIDGE, tol=1e-9, max_iter=5000)
    expected = logit.fit(design, action, sample_weight=weight).predict_proba(design)
    found = logit_shares(states, votes_of(action, weight), np.arange(NUM_ROWS))
    np.testing.assert_allclose(found, expected, atol=1e-4)


@pytest.mark.parametrize("shares", [forest_shares, logit_shares])
def test_as_it_stands_it_is_close_and_the_same_again(rows, shares):
    states, action, weight = rows
    found = shares(states, votes_of(action, weight), np.arange(NUM_ROWS))
    np.testing.assert_allclose(found.sum(axis=1), 1.0)
    np.testing.assert_array_equal(found, shares(states, votes_of(action, weight), np.arange(NUM_ROWS)))
    assert (found.argmax(axis=1) == action).mean() > 0.75


@pytest.mark.parametrize("shares", [forest_shares, logit_shares])
def test_values_that_are_all_alike_or_huge_split_nothing_and_are_finite(rows, shares):
    _, action, weight = rows
    states = np.column_stack([np.ones(NUM_ROWS), np.where(action == 0, 1e150, -1e150)])
    found = shares(states, votes_of(action, weight), np.arange(NUM_ROWS))
    assert (found.argmax(axis=1)[action == 0] == 0).all()
    assert np.isfinite(found).all()
