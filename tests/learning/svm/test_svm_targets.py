"""Targets Y(T) in every form of y, restricted times, and weights that recover what Kaplan and Meier say."""

import warnings

import numpy as np
import pandas as pd
import pytest
from convex_oracle import cut_log
from sksurv.datasets import load_gbsg2, load_veterans_lung_cancer, load_whas500
from sksurv.nonparametric import kaplan_meier_estimator

from halfseen.censoring import KaplanMeier
from halfseen.errors import ArgumentError
from halfseen.learning import CensoredSVC, CensoredSVR, survival_array
from halfseen.learning.svm.rows import as_ends

X, TIME, IS_FINISHED = cut_log()
Y = survival_array(TIME, IS_FINISHED)
FORMS = {
    "structured": Y,
    "fields swapped": Y[["time", "is_finished"]],
    "other names": np.array(list(zip(IS_FINISHED, TIME, strict=True)), dtype=[("event", "?"), ("days", "<f8")]),
    "tuple": (TIME, IS_FINISHED),
    "frame": pd.DataFrame({"time": TIME, "is_finished": IS_FINISHED}),
    "seconds": pd.DataFrame({"is_finished": IS_FINISHED.astype(int), "note": "x", "time_s": TIME}, index=range(5, 85)),
    "lists": (list(TIME), list(IS_FINISHED)),
}


@pytest.mark.parametrize("form", list(FORMS))
def test_every_form_of_y_is_read_alike(form):
    expected = CensoredSVR(reg=1e-2).fit(X, Y)
    model = CensoredSVR(reg=1e-2).fit(X, FORMS[form])
    np.testing.assert_array_equal(model.weights_, expected.weights_)
    np.testing.assert_array_equal(model.predict(X), expected.predict(X))
    assert model.score(X, FORMS[form]) == expected.score(X, Y)


@pytest.mark.parametrize("form", [TIME, list(TIME), pd.Series(TIME), TIME[:, None], pd.DataFrame({"time": TIME})])
def test_a_plain_column_was_seen_in_full(form):
    assert as_ends(form) is None
    with warnings.catch_warnings():
        # scikit-learn's word on a column where it wants a row.
        warnings.simplefilter("ignore")
        model = CensoredSVR(reg=1e-2).fit(X, form)
    assert (model.weights_ == 1).all()
    assert model.censoring_ is None
    all_seen = CensoredSVR(reg=1e-2).fit(X, (TIME, np.ones(80, dtype=bool)))
    np.testing.assert_allclose(model.predict(X), all_seen.predict(X), atol=1e-10)


@pytest.mark.parametrize(
    ("target", "values"),
    [("identity", TIME), ("log", np.log(TIME)), (np.sqrt, np.sqrt(TIME)), (lambda time: list(time > 1), TIME > 1)],
)
def test_target_is_the_function_of_the_time(target, values):
    model = CensoredSVR("squared", reg=1e-2, gamma=0.5, target=target).fit(X, Y)
    # By hand: weights as sample weights, whose sum is n then, so that λ is in another unit.
    by_hand = CensoredSVR("squared", reg=1e-2 / model.weights_.mean(), gamma=0.5)
    by_hand.fit(X, values.astype(float), sample_weight=model.weights_)
    np.testing.assert_allclose(by_hand.predict(X), model.predict(X), atol=1e-9)


@pytest.mark.parametrize(
    ("target", "says"),
    [
        ("exp", "target is 'exp'; it is 'identity', 'log'"),
        (lambda time: np.where(time > 1, np.nan, 0.0), r"y, row \d+: the target of .* is nan"),
        (lambda time: time[:3], r"target\(time\) has 3 rows for 80 times"),
        (lambda time: "late", "not made of numbers"),
        (lambda time: time[:, None], r"shape \(80, 1\)"),
    ],
)
def test_refuses_targets_that_are_none(target, says):
    with pytest.raises(ArgumentError, match=says) as refusal:
        CensoredSVR(reg=1e-2, target=target).fit(X, Y)
    assert "\n" not in str(refusal.value)


def test_a_trajectory_cut_after_tau_counts_in_full():
    tau = 0.6
    is_late = np.greater_equal(TIME, tau)
    model = CensoredSVR("squared", reg=1e-2, tau=tau).fit(X, Y)
    survival = KaplanMeier().fit(TIME, IS_FINISHED).survival(np.minimum(TIME, tau))
    is_seen = IS_FINISHED | is_late
    assert (is_seen & ~IS_FINISHED).sum() >= 3
    np.testing.assert_allclose(model.weights_, np.where(is_seen, 1 / survival, 0), rtol=1e-12)
    # The target is min(T, τ), whatever came after.
    later = survival_array(np.where(is_late, TIME + 100, TIME), IS_FINISHED)
    np.testing.assert_allclose(CensoredSVR("squared", reg=1e-2, tau=tau).fit(X, later).predict(X), model.predict(X))


def test_ties_at_tau_go_both_ways_in_the_classifier():
    time, is_finished = np.array([1.0, 2.0, 2.0, 3.0, 3.0, 1.0] * 4), np.array([1, 1, 0, 1, 0, 0] * 4, dtype=bool)
    rows = np.tile(np.arange(6.0), 4)[:, None]
    model = CensoredSVC(tau=2.0, reg=1e-6, gamma=5.0, calibrate=False).fit(rows, (time, is_finished))
    # Finished at τ: early. Cut at τ: completions come before cuts, so it had not finished: late, and seen.
    np.testing.assert_array_equal(model.predict(rows[:5]), [True, True, False, False, False])
    survival = KaplanMeier().fit(time, is_finished).survival(np.minimum(time, 2.0))
    np.testing.assert_allclose(model.weights_[:6], np.array([1, 1, 1, 1, 1, 0]) / survival[:6])


def test_plain_times_and_labels_for_the_classifier():
    by_time = CensoredSVC(tau=1.0, reg=1e-2, calibrate=False).fit(X, TIME)
    by_label = CensoredSVC(reg=1e-2, calibrate=False).fit(X, np.where(TIME <= 1.0, "quick", "slow"))
    np.testing.assert_array_equal(by_label.classes_, ["quick", "slow"])
    np.testing.assert_array_equal(by_time.predict(X), by_label.predict(X) == "quick")


def area_under_kaplan_meier(time, is_finished):
    ends, survival = kaplan_meier_estimator(is_finished, time)
    return np.diff(np.concatenate([[0.0], ends])) @ np.concatenate([[1.0], survival[:-1]])


@pytest.mark.parametrize("load", [load_whas500, load_gbsg2, load_veterans_lung_cancer])
def test_one_group_has_the_area_under_kaplan_meier_as_its_mean(load):
    y = load()[1]
    is_finished, time = (y[name] for name in y.dtype.names)
    # The area ends where the last trajectory ends, so all must have ended by then: the target is restricted to it.
    tau = float(np.sort(time)[int(0.9 * len(time))])
    model = CensoredSVR("squared", kernel="linear", reg=0, fit_intercept=False, tau=tau).fit(np.ones((len(y), 1)), y)
    area = area_under_kaplan_meier(np.minimum(time, tau), is_finished & (time <= tau))
    assert model.predict([[1.0]])[0] == pytest.approx(area, rel=1e-10)
    assert model.weights_.sum() == pytest.approx(len(y), rel=1e-10)


def test_each_group_has_its_weighted_mean():
    features, y = load_whas500()
    group = (features["gender"].astype(float) == 1).to_numpy().astype(int)
    model = CensoredSVR("squared", kernel="linear", reg=0, fit_intercept=False, tau=1500.0).fit(np.eye(2)[group], y)
    for k in (0, 1):
        mean = np.average(np.minimum(y["lenfol"], 1500.0)[group == k], weights=model.weights_[group == k])
        assert model.predict(np.eye(2)[[k]])[0] == pytest.approx(mean, rel=1e-12)


@pytest.mark.parametrize("censoring", ["kaplan-meier", "cox", "kernel", KaplanMeier()])
def test_every_model_of_the_cuts_gives_the_weights(censoring):
    model = CensoredSVR("squared", reg=1e-2, censoring=censoring, tau=2.0).fit(X, Y)
    survival = model.censoring_.survival(np.minimum(TIME, 2.0), X if censoring in ("cox", "kernel") else None)
    is_seen = IS_FINISHED | (TIME >= 2.0)
    np.testing.assert_allclose(model.weights_, is_seen / survival, rtol=1e-10)
    assert model.censoring_ is not censoring
    assert model.weights_.mean() == pytest.approx(1.0, abs=0.15)


def test_truncation_bounds_the_weights_and_says_so():
    model = CensoredSVR(reg=1e-2, truncate_at=1.3).fit(X, Y)
    assert model.weights_.max() == pytest.approx(1.3)
    assert model.diagnostics_.share_truncated > 0.1
