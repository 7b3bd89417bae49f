"""The small models of a rule against scikit-learn's of the same kind."""

import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression
from sklearn.preprocessing import PolynomialFeatures, StandardScaler
from sklearn.tree import DecisionTreeClassifier

from halfseen.evaluation import logging_rule as rule_models
from halfseen.evaluation.logging_rule import forest_shares, logit_shares

NUM_ROWS, NUM_ACTIONS = 400, 3
RNG = np.random.default_rng(0)
# States that float32 holds exactly, noisy actions, and weights.
STATES = RNG.normal(size=(NUM_ROWS, 3)).astype(np.float32).astype(np.float64)
BY_RULE = np.where(STATES[:, 0] > 0.2, 0, np.where(STATES[:, 1] * STATES[:, 2] > 0.0, 1, 2))
ACTION = np.where(RNG.random(NUM_ROWS) < 0.2, RNG.integers(NUM_ACTIONS, size=NUM_ROWS), BY_RULE)
WEIGHT = RNG.uniform(0.5, 2.0, size=NUM_ROWS)
VOTES = WEIGHT[:, None] * (ACTION[:, None] == np.arange(NUM_ACTIONS))
EACH = np.arange(NUM_ROWS)


@pytest.mark.parametrize("least", [1, 3, 20])
def test_a_tree_is_that_of_scikit_learn(least, monkeypatch):
    monkeypatch.setattr(rule_models, "PURE", 1.0 - 1e-12)
    fitted = EACH < 250
    found = rule_models._tree_shares(STATES[fitted], VOTES[fitted], STATES, least)
    tree = DecisionTreeClassifier(min_samples_leaf=least, random_state=0)
    expected = tree.fit(STATES[fitted], ACTION[fitted], sample_weight=WEIGHT[fitted]).predict_proba(STATES)
    np.testing.assert_allclose(found[fitted], expected[fitted], atol=1e-12)
    # Between rows of a small leaf several features part the votes equally well, and either takes its own.
    alike = np.isclose(found, expected, atol=1e-12).all(axis=1)
    assert alike.all() if least == 20 else alike.mean() > 0.98


def test_the_logit_is_that_of_scikit_learn(monkeypatch):
    monkeypatch.setattr(rule_models, "TOLERANCE", 1e-7)
    monkeypatch.setattr(rule_models, "MOST_STEPS", 5000)
    design = PolynomialFeatures(2, include_bias=False).fit_transform(StandardScaler().fit_transform(STATES))
    logit = LogisticRegression(C=1.0 / rule_models.RIDGE, tol=1e-9, max_iter=5000)
    expected = logit.fit(design, ACTION, sample_weight=WEIGHT).predict_proba(design)
    np.testing.assert_allclose(logit_shares(STATES, VOTES, EACH), expected, atol=1e-4)


@pytest.mark.parametrize("shares", [forest_shares, logit_shares])
def test_as_it_stands_it_is_close_the_same_again_and_finite_where_values_are_alike_or_huge(shares):
    found = shares(STATES, VOTES, EACH)
    np.testing.assert_allclose(found.sum(axis=1), 1.0)
    np.testing.assert_array_equal(found, shares(STATES, VOTES, EACH))
    assert (found.argmax(axis=1) == ACTION).mean() > 0.75
    found = shares(np.column_stack([np.ones(NUM_ROWS), np.where(ACTION == 0, 1e150, -1e150)]), VOTES, EACH)
    assert (found.argmax(axis=1)[ACTION == 0] == 0).all()
    assert np.isfinite(found).all()
