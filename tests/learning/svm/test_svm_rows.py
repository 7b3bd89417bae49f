"""Targets in every form of y, weights that recover Kaplan and Meier, and rows held out: λ and chances by them."""

import warnings

import numpy as np
import pandas as pd
import pytest
from convex_oracle import cut_log
from scipy.optimize import minimize
from scipy.special import expit
from sklearn.model_selection import KFold, RepeatedKFold, StratifiedKFold
from sksurv.datasets import load_gbsg2, load_veterans_lung_cancer, load_whas500
from sksurv.nonparametric import kaplan_meier_estimator

from halfseen.censoring import KaplanMeier
from halfseen.errors import ArgumentError
from halfseen.learning import CensoredSVC, CensoredSVR, survival_array
from halfseen.learning.svm.kernels import VectorKernel
from halfseen.learning.svm.losses import named_loss
from halfseen.learning.svm.newton import Gram
from halfseen.learning.svm.rows import as_ends, fit_sigmoid
from halfseen.learning.svm.solver import Problem, solve

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
        ("exp", "target is 'exp'; give 'identity', 'log'"),
        (lambda time: np.where(time > 1, np.nan, 0.0), r"y, row \d+: the target of .* is nan"),
        (lambda time: time[:3], r"target\(time\) has 3 rows for 80 times"),
        (lambda time: "late", "not numeric"),
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


GAMMA = 2.0


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(5)
    rows = rng.uniform(size=(240, 2))
    time = np.exp(np.sin(5 * rows[:, 0]) + 0.4 * rng.normal(size=240))
    cut = rng.exponential(4.0, size=240)
    return rows, survival_array(np.minimum(time, cut), time <= cut)


def naive_losses(rows, y, weights, loss, regs, splits):
    """A fit for every fold and λ, each from nothing."""
    kernel, seen = VectorKernel("rbf", GAMMA), weights > 0
    losses = np.zeros(len(regs))
    for fitted, held in splits:
        fitted, held = fitted[seen[fitted]], held[seen[held]]
        num_rows = len(rows) * len(fitted) / seen.sum()
        for k, reg in enumerate(regs):
            space = Gram(kernel(rows[fitted], rows[fitted]))
            found = solve(Problem(space, y[fitted], weights[fitted] / num_rows, loss, float(reg), True))
            f = kernel(rows[held], rows[fitted]) @ found.coefficients + found.offset
            losses[k] += weights[held] @ loss.value(y[held], f)
    return losses / sum(weights[held].sum() for _, held in splits)


SPLITS = {
    "folds": list(KFold(4, shuffle=True, random_state=3).split(np.zeros(240))),
    "repeated": list(RepeatedKFold(n_splits=3, n_repeats=2, random_state=0).split(np.zeros(240))),
    "some are never held out": [(np.arange(120, 240), np.arange(60))],
}


@pytest.mark.parametrize(
    ("loss", "splits"),
    [("absolute", "folds"), ("huber", "folds"), *(("squared", name) for name in SPLITS)],
)
def test_losses_are_those_of_a_naive_loop_and_the_least_is_chosen(log, loss, splits):
    rows, y = log
    model = CensoredSVR(loss, gamma=GAMMA, cv=SPLITS[splits]).fit(rows, y)
    naive = naive_losses(rows, y["time"], model.weights_, named_loss(loss), model.cv_regs_, SPLITS[splits])
    tried = np.isfinite(model.cv_losses_[0])
    np.testing.assert_allclose(model.cv_losses_[0][tried], naive[tried], rtol=1e-6 if loss == "squared" else 2e-3)
    assert model.reg_ == model.cv_regs_[np.argmin(naive)]


@pytest.mark.slow
@pytest.mark.parametrize("loss", ["absolute", "epsilon-insensitive"])
def test_giving_up_spares_work_and_changes_no_choice(log, loss, monkeypatch):
    rows, y = log
    quick = CensoredSVR(loss, gamma="cv").fit(rows, y)
    monkeypatch.setattr("halfseen.learning.svm.rows.HOPELESS", np.inf)
    patient = CensoredSVR(loss, gamma="cv").fit(rows, y)
    assert np.isinf(quick.cv_losses_).any()
    assert np.isfinite(patient.cv_losses_).all()
    assert (quick.reg_, quick.gamma_) == (patient.reg_, patient.gamma_)
    np.testing.assert_array_equal(quick.predict(rows), patient.predict(rows))


def test_splits_without_rows_that_were_seen(log):
    rows, y = log
    cut, seen = np.flatnonzero(~y["is_finished"]), np.flatnonzero(y["is_finished"])
    telling = [(seen[:80], seen[80:])]
    alone = CensoredSVR("squared", gamma=GAMMA, cv=telling).fit(rows, y)
    beside = CensoredSVR("squared", gamma=GAMMA, cv=[(seen, cut), *telling]).fit(rows, y)
    np.testing.assert_array_equal(beside.cv_losses_, alone.cv_losses_)
    with pytest.raises(ArgumentError, match="cv: split 1 trains on no observed row"):
        CensoredSVR("squared", gamma=GAMMA, cv=[*telling, (cut, seen)]).fit(rows, y)
    with pytest.raises(ArgumentError, match="cv: no split holds out an observed row"):
        CensoredSVR("squared", gamma=GAMMA, cv=[(seen, cut)]).fit(rows, y)


def test_a_stratified_splitter_deals_early_late_and_cut_rows_evenly():
    classifier, stratified = CensoredSVC(tau=np.median(TIME), gamma=GAMMA, calibrate=False), StratifiedKFold(3)
    early = IS_FINISHED & (classifier.tau >= TIME)
    groups = np.where(early, 1, np.where(classifier.tau <= TIME, 2, 3))
    given = list(stratified.split(X, groups))
    found, expected = (classifier.set_params(cv=cv).fit(X, Y).cv_losses_.copy() for cv in (stratified, given))
    np.testing.assert_array_equal(found, expected)


TAU = 1.5


def truth(rows):
    """P(T ≤ τ | z) of the simulated logs."""
    return 1.0 - np.exp(-TAU * np.exp(1.2 * rows[:, 0]))


def simulated(num_rows, seed, mean_cut=1.5):
    rng = np.random.default_rng(seed)
    rows = rng.uniform(-1.5, 1.5, size=(num_rows, 2))
    time = rng.exponential(np.exp(-1.2 * rows[:, 0]))
    cut = rng.exponential(mean_cut, size=num_rows)
    return rows, survival_array(np.minimum(time, cut), time <= cut)


def test_sigmoid_is_the_weighted_maximum_likelihood_with_platts_targets():
    rng = np.random.default_rng(0)
    f = rng.normal(size=300)
    y = np.where(rng.uniform(size=300) < expit(2 * f - 0.5), 1.0, -1.0)
    positive, negative = (y > 0).sum(), (y < 0).sum()
    sure = np.where(y > 0, (positive + 1) / (positive + 2), 1 / (negative + 2))

    def loss(theta):
        z = theta[0] * f + theta[1]
        return np.mean(np.logaddexp(0, z) - sure * z)

    best = minimize(loss, [1.0, 0.0], tol=1e-12).x
    found = fit_sigmoid(f, y, np.ones(300))
    assert found.slope == pytest.approx(best[0], abs=1e-3)
    assert found.offset == pytest.approx(best[1], abs=1e-3)
    again = fit_sigmoid(np.append(f, np.nan), np.append(y, 1.0), np.full(301, 7.0))
    assert again.slope == pytest.approx(found.slope, rel=1e-6)


def test_values_that_tell_nothing_or_all():
    y = np.array([1.0, 1.0, 1.0, -1.0] * 10)
    wrong = fit_sigmoid(-y, y, np.ones(40))
    assert wrong.slope == 0.0
    np.testing.assert_allclose(wrong.probability(np.array([-5.0, 5.0])), 0.75)
    y = np.repeat([1.0, -1.0], 10)
    chance = fit_sigmoid(y, y, np.ones(20)).probability(np.array([1.0, -1.0]))
    assert 0.85 < chance[0] < 0.95
    assert 0.05 < chance[1] < 0.15


def test_chances_do_not_come_from_the_fit_to_the_same_rows():
    # Labels that no covariate tells: a fit that has seen them separates them, held-out rows do not.
    rng = np.random.default_rng(0)
    rows, labels = rng.normal(size=(80, 5)), rng.uniform(size=80) < 0.5
    model = CensoredSVC(reg=1e-6, gamma=5.0).fit(rows, labels)
    assert (model.predict(rows) == labels).mean() > 0.95
    assert np.abs(model.predict_proba(rows)[:, 1] - 0.5).max() < 0.25


@pytest.mark.slow
def test_chances_are_reliable_in_spite_of_cuts():
    rows, y = simulated(3000, 0)
    assert 0.4 < 1 - y["is_finished"].mean() < 0.6
    model = CensoredSVC("logistic", tau=TAU, reg=1e-4, gamma=0.5).fit(rows, y)
    fresh = np.random.default_rng(1).uniform(-1.5, 1.5, size=(20_000, 2))
    chance, true = model.predict_proba(fresh)[:, 1], truth(fresh)
    for low in np.arange(0.2, 1.0, 0.1):
        in_bin = (chance >= low) & (chance < low + 0.1)
        if in_bin.sum() > 200:
            assert chance[in_bin].mean() == pytest.approx(true[in_bin].mean(), abs=0.07)


@pytest.mark.slow
def test_weights_recover_chances_that_ignoring_cuts_does_not():
    fresh = np.random.default_rng(1).uniform(-1.5, 1.5, size=(5000, 2))
    errors = {}
    for censoring in ("kaplan-meier", "none"):
        found = [
            CensoredSVC("logistic", tau=TAU, reg=1e-3, gamma=0.5, censoring=censoring)
            .fit(*simulated(1000, seed))
            .predict_proba(fresh)[:, 1]
            for seed in range(5)
        ]
        errors[censoring] = np.mean([np.abs(chance - truth(fresh)).mean() for chance in found])
        bias = np.mean(found, axis=0).mean() - truth(fresh).mean()
        errors[censoring, "bias"] = abs(bias)
    assert errors["kaplan-meier"] < 0.6 * errors["none"]
    assert errors["kaplan-meier", "bias"] < 0.02 < errors["none", "bias"]
