"""How much what shows of a grip counts beside a model that does not look at it: against scikit-learn and simulation."""

import numpy as np
import pandas as pd
import pytest
from scipy.special import expit, logit
from tried import beta_attempts, cut_some

from halfseen.censoring import censoring_weights
from halfseen.errors import ArgumentError
from halfseen.tables import BetaGrasp
from halfseen.tables.grasp.choice import GRIP_SPREAD as SPREAD
from halfseen.tables.grasp.choice import fit_grip_effect
from halfseen.tables.grasp.grasp_table import GripEffect


class Even:
    """Says the same of every attempt."""

    def fit(self, frame):
        return self

    def predict_proba(self, frame):
        return np.full((len(frame), 2), 0.5)


def gripped(num_attempts, shift, per_grip, seed=0):
    """Attempts that hold with log-odds shift + per_grip · grip."""
    rng = np.random.default_rng(seed)
    tried = beta_attempts(num_attempts, num_tries=1, seed=seed)
    grip = rng.normal(0.0, 2.0, num_attempts)
    succeeded = rng.random(num_attempts) < expit(shift + per_grip * grip)
    return tried.assign(grip=grip, succeeded=succeeded)


def test_it_is_a_ridge_regression_whose_offset_is_the_model():
    """scikit-learn's penalty is the same for all coefficients, so the columns are scaled by their spreads."""
    from sklearn.linear_model import LogisticRegression

    tried = cut_some(gripped(300, 0.4, 0.7))
    weight = censoring_weights(tried["time_s"], tried["is_finished"])
    seen = tried["is_finished"].to_numpy()
    columns = np.column_stack([np.ones(len(tried)), tried["grip"]]) * SPREAD
    peer = LogisticRegression(C=1.0, fit_intercept=False, tol=1e-10, max_iter=1000)
    peer.fit(columns[seen], tried["succeeded"][seen].astype(bool), sample_weight=weight[seen])
    np.testing.assert_allclose(fit_grip_effect(Even(), tried), peer.coef_[0] * SPREAD, atol=1e-5)


def test_many_attempts_tell_what_is_true():
    effect = fit_grip_effect(Even(), gripped(20_000, -0.5, 0.4))
    np.testing.assert_allclose(effect, (-0.5, 0.4), atol=0.05)


def test_attempts_that_a_grip_tells_apart_do_not_run_away():
    few = gripped(12, 0.0, 1.0)
    assert 0.0 < fit_grip_effect(Even(), few.assign(succeeded=few["grip"] > 0)).per_grip < 3 * SPREAD[1]


def test_where_no_grip_was_seen_there_is_no_effect():
    tried = gripped(100, 1.0, 0.5).assign(grip=0.0)
    assert fit_grip_effect(Even(), tried) == GripEffect(0.0, 0.0)


def test_a_spread_about_the_mean_pulls_it_together():
    rng, spread = np.random.default_rng(1), 3.6
    tried = gripped(40_000, 0.0, 1.0, seed=1)
    succeeded = rng.random(len(tried)) < expit(tried["grip"] + rng.normal(0.0, spread, len(tried)))
    per_grip = fit_grip_effect(Even(), tried.assign(succeeded=succeeded)).per_grip
    assert per_grip == pytest.approx(1.0 / np.sqrt(1.0 + 0.346 * spread**2), abs=0.03)


def test_it_moves_log_odds():
    effect = GripEffect(0.3, 0.5)
    np.testing.assert_allclose(logit(effect.moved(np.array([0.2, 0.9]), np.array([1.0, -2.0]))), [
        logit(0.2) + 0.8, logit(0.9) - 0.7,
    ])  # fmt: skip
    assert np.isfinite(effect.moved(np.array([0.0, 1.0]), 0.0)).all()


def test_a_model_that_knows_the_grip_on_average_is_improved_by_it():
    train, fresh = gripped(2_000, 1.0, 0.8), gripped(2_000, 1.0, 0.8, seed=9)
    beta = BetaGrasp().fit(train)
    said = beta.predict_proba(fresh)[:, 1]
    moved = fit_grip_effect(beta, train).moved(said, fresh["grip"].to_numpy())

    def loss(probability):
        return -np.mean(np.log(np.where(fresh["succeeded"], probability, 1.0 - probability)))

    assert loss(moved) < loss(said) - 0.05


def test_a_grip_that_is_no_number_is_refused():
    tried = pd.DataFrame(gripped(50, 0.0, 0.5))
    tried.loc[3, "grip"] = np.nan
    with pytest.raises(ArgumentError, match=r"row 3: grip is nan; give a finite number"):
        fit_grip_effect(Even(), tried)
