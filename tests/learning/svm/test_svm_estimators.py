"""Both estimators in scikit-learn's hands; and each mistake gets one line that names it and the remedy."""

import re
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from convex_oracle import cut_log
from sklearn.model_selection import GridSearchCV, KFold, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import check_estimator

from halfseen.errors import ArgumentError, HalfseenError, HalfseenWarning, PositivityError
from halfseen.learning import CensoredSVC, CensoredSVR, SetKernel, survival_array
from halfseen.learning.svm import machine
from halfseen.learning.svm.machine import advised_landmarks, check_gram_fits, free_bytes
from refusals import refused_type

EQUIVALENCE = "check_sample_weight_equivalence_on_dense_data"
DEALT = "rows are dealt into folds one by one, so a row that is there twice is dealt otherwise than one of weight 2"

CONSTRUCTOR = "check_do_not_raise_errors_in_init_or_set_params"
TYPED = "where the test run executes the constructor's types, a wrong type fails before fit can say why"
"""So it does under .ci/run."""

EVERYWHERE = {CONSTRUCTOR: TYPED} if hasattr(CensoredSVR.__init__, "__wrapped__") else {}
EXPECTED_FAILURES = {"calibrated": {EQUIVALENCE: DEALT}}
"""What scikit-learn asks and is not kept, and why."""

ESTIMATORS = {
    "regressor": CensoredSVR(reg=1e-3),
    "classifier": CensoredSVC(reg=1e-3, calibrate=False),
    "calibrated": CensoredSVC(reg=1e-3),
    "regressor-cv": CensoredSVR(),
    "classifier-cv": CensoredSVC(calibrate=False),
}

X, TIME, IS_FINISHED = cut_log()
Y = survival_array(TIME, IS_FINISHED)


# A cast inside scikit-learn, of the infinite labels that it hands out to be refused.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:invalid value encountered in cast:RuntimeWarning")
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.SkipTestWarning")
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n not in ("regressor", "classifier"))) for n in ESTIMATORS]
)
def test_scikit_learns_own_checks(name):
    expected = EVERYWHERE | EXPECTED_FAILURES.get(name, {})
    logs = check_estimator(ESTIMATORS[name], expected_failed_checks=expected, on_fail=None)
    failed = {log["check_name"]: str(log["exception"]) for log in logs if log["status"] == "failed"}
    assert not failed
    assert {log["check_name"] for log in logs if log["status"] == "xfail"} == set(expected)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["structured", "frame"])
def test_pipeline_search_and_cross_validation(form):
    X, time, is_finished = cut_log(200)
    table = pd.DataFrame({"time_s": time, "is_finished": is_finished})
    y = survival_array(time, is_finished) if form == "structured" else table
    pipeline = make_pipeline(StandardScaler(), CensoredSVR("absolute", reg=1e-2))
    search = GridSearchCV(pipeline, {"censoredsvr__reg": [1e-2, 1e3]}, cv=3).fit(X, y)
    assert search.best_params_ == {"censoredsvr__reg": 1e-2}
    scores = cross_val_score(search.best_estimator_, X, y, cv=KFold(3))
    assert scores.shape == (3,)
    assert scores.mean() > 0.2
    classifier = make_pipeline(StandardScaler(), CensoredSVC(tau=1.0, reg=1e-2, calibrate=False))
    assert cross_val_score(classifier, X, y, cv=KFold(3)).mean() > 0.65


def test_predict_proba_is_there_only_if_asked_for():
    assert not hasattr(CensoredSVC(calibrate=False), "predict_proba")
    model = CensoredSVC(tau=1.0, reg=1e-2).fit(X, Y)
    chances = model.predict_proba(X)
    np.testing.assert_allclose(chances.sum(axis=1), 1.0)
    assert (np.diff(chances[np.argsort(model.decision_function(X)), 1]) >= 0).all()
    assert list(model.classes_) == [False, True]


def test_score_is_the_share_of_the_weighted_loss_that_is_explained():
    model = CensoredSVR("squared", reg=1e-3).fit(X, Y)
    weights = model.weights_
    mean = np.average(TIME, weights=weights)
    left, most = weights @ (TIME - model.predict(X)) ** 2, weights @ (TIME - mean) ** 2
    assert model.score(X, Y) == pytest.approx(1 - left / most, abs=1e-10)
    classifier = CensoredSVC(tau=1.0, reg=1e-2, calibrate=False).fit(X, Y)
    right = classifier.predict(X) == (TIME <= 1.0)
    assert classifier.score(X, Y) == pytest.approx(classifier.weights_ @ right / classifier.weights_.sum(), abs=1e-12)


def sets(num_sets=60, seed=0):
    rng = np.random.default_rng(seed)
    rows = [rng.normal(rng.uniform(-1, 1), 0.3, size=(k, 2)) for k in rng.integers(1, 6, size=num_sets)]
    rows[7] = np.empty((0, 2))
    level = np.array([s[:, 0].mean() if len(s) else 0.0 for s in rows])
    time = np.exp(level + 0.1 * rng.normal(size=num_sets))
    cut = rng.exponential(4.0, size=num_sets)
    return rows, survival_array(np.minimum(time, cut), time <= cut)


def test_sets_of_any_number_of_objects_even_none():
    rows, y = sets()
    model = CensoredSVR("squared", kernel="set", reg=1e-4, target="log").fit(rows, y)
    assert model.score(rows, y) > 0.8
    one, none = model.predict([np.array([[0.5, 0.0]]), np.empty((0, 2))])
    assert none == model.intercept_
    assert one != none
    linear = CensoredSVR("squared", kernel=SetKernel("linear", pooling="sum"), reg=1e-4).fit(rows, y)
    np.testing.assert_allclose(
        linear.predict([np.ones((2, 2))]) - linear.intercept_,
        2 * (linear.predict([np.ones((1, 2))]) - linear.intercept_),
    )


def test_sets_in_a_search():
    rows, y = sets()
    kernels = [SetKernel(gamma=gamma) for gamma in (1e-9, 1.0)]
    search = GridSearchCV(CensoredSVR("squared", reg=1e-3, target="log"), {"kernel": kernels}, cv=3).fit(rows, y)
    assert search.best_params_["kernel"] == kernels[1]


MODELS = [
    CensoredSVR(cv=2),
    CensoredSVR("absolute", reg=1e-3, num_landmarks=10),
    CensoredSVC(tau=1.0, reg=1e-2, cv=3),
]


@pytest.mark.parametrize("model", MODELS)
def test_same_seed_same_bytes_and_the_global_seed_neither_counts_nor_changes(model):
    results = set()
    for seed in (1, 2):
        np.random.seed(seed)  # noqa: NPY002
        state = np.random.get_state()[1].tobytes()  # noqa: NPY002
        results.add(model.fit(X, Y).predict(X).tobytes())
        assert np.random.get_state()[1].tobytes() == state  # noqa: NPY002
    assert len(results) == 1


@pytest.mark.parametrize("loss", ["squared", "absolute"])
def test_rows_of_weight_0_change_nothing(loss):
    junk = survival_array(np.full(20, 0.01), np.arange(20) % 2 == 0)
    both = np.concatenate([X, np.full((20, 3), 9.0)])
    model = CensoredSVR(loss, reg=1e-3)
    alone = model.fit(X, Y).predict(X)
    weights = np.repeat([1.0, 0.0], [len(X), 20])
    np.testing.assert_array_equal(model.fit(both, np.concatenate([Y, junk]), sample_weight=weights).predict(X), alone)


def test_cut_rows_count_in_n_only():
    # Cut before anything was seen: nobody else's weight changes but for n.
    early = survival_array(np.full(15, 1e-3), np.zeros(15, dtype=bool))
    model = CensoredSVR("squared", reg=1e-3, gamma=0.5, censoring="none")
    alone = model.fit(X, Y).predict(X)
    more = model.fit(np.concatenate([X, X[:15]]), np.concatenate([Y, early])).predict(X)
    assert np.abs(more - alone).max() > 1e-6
    scaled = CensoredSVR("squared", reg=1e-3 * 95 / 80, gamma=model.gamma, censoring="none").fit(X, Y)
    np.testing.assert_allclose(scaled.predict(X), more, atol=1e-9)


LABELS = TIME > 1
SETS = [row[:, None] for row in X]
TWICE, CONSTANT = np.column_stack([X, X[:, 0] + X[:, 1]]), np.column_stack([X, np.full(80, 3.0)])


def refusal(call, error=HalfseenError):
    with pytest.raises(error) as raised:
        call()
    assert "\n" not in str(raised.value)
    return str(raised.value)


def but(values, row, value):
    changed = np.array(values, dtype=float)
    changed[row] = value
    return changed


class NobodyIsWatched:
    def fit(self, time, is_finished, covariates=None):
        self.is_fitted_ = True
        return self

    def survival(self, u, covariates=None):
        return np.where(np.asarray(u) > 0.5, 0.0, 1.0)


LINEAR = {"loss": "squared", "kernel": "linear", "reg": 0}
REGRESSOR = [
    ({"loss": "hinge"}, Y, r"loss is 'hinge'; CensoredSVR has squared, absolute, pinball"),
    ({"censoring": "km"}, Y, r"censoring is 'km'; give 'kaplan-meier', 'cox', 'kernel'"),
    *(({"gamma": g}, Y, rf"gamma is {g}; a kernel's width .*'scale' or 'cv'") for g in (0, -1.0, np.nan, True, None)),
    ({"gamma": "banana"}, Y, r"gamma is 'banana'.*'scale' or 'cv'"),
    *(({"reg": reg}, Y, rf"reg is {reg}; give a λ ≥ 0, or 'cv'") for reg in (-1, np.nan, np.inf, True, None)),
    ({"reg": 0}, Y, r"reg is 0, so the solution with an intercept .*fit_intercept=False"),
    ({"reg": 0, "fit_intercept": False, "gamma": 1e-12}, Y, r"reg is 0 and the kernel matrix .* singular.*reg > 0"),
    ({"loss": "pinball", "quantile": 0}, Y, r"quantile is 0; give a number in \(0, 1\)"),
    *(({"tau": tau}, Y, rf"tau is {tau}; give a time > 0 s") for tau in (0, -2.0, np.nan, np.inf)),
    *(({"tol": tol}, Y, rf"tol is {tol}; give a share") for tol in (0.0, np.nan)),
    ({"truncate_at": 0.5}, Y, r"truncate_at is 0.5; weights are at least 1"),
    ({"kernel": lambda x, z: np.ones((2, 2))}, Y, r"the kernel gives shape \(2, 2\)"),
    *(({"reg": "cv", "cv": cv}, Y, rf"cv is {cv}; cross-validation needs at least 2 folds") for cv in (0, 1)),
    ({"censoring": NobodyIsWatched()}, Y, r"trajectory \d+: finished at .* \(Ĝ = 0\).*shorten.*truncate"),
    ({}, (TIME, np.zeros(80, dtype=bool)), r"all 80 .* were cut before their target was seen; record until some"),
]
CLASSIFIER = [
    ({}, Y, "y holds times and tau is None; give the tau"),
    ({}, np.arange(80) % 3, "y has 3 classes; choose two"),
    ({}, np.ones(80), "only one class"),
    ({"tau": 1e9}, Y, "only one class, .*True.*, was observed among 80 rows"),
    ({"tau": 1e-9}, Y, "only one class, .*False.*, was observed"),
    ({"tau": 100.0}, (TIME, np.zeros(80, dtype=bool)), "all 80 .* were cut before their target was seen"),
    ({"loss": "squared"}, LABELS, "loss is 'squared'; CensoredSVC has hinge, squared-hinge, logistic"),
    ({"cv": 1}, LABELS, "cv is 1"),
]


@pytest.mark.parametrize(
    ("make", "parameters", "y", "says"),
    [(CensoredSVR, *each) for each in REGRESSOR] + [(CensoredSVC, *each) for each in CLASSIFIER],
)
def test_parameters_and_targets_are_refused(make, parameters, y, says):
    error = PositivityError if says.startswith(("all 80", r"trajectory \d")) else ArgumentError
    message = refusal(lambda: make(**{"reg": 1e-2} | parameters).fit(X, y), error)
    assert re.search(says, message), message


ROWS = [
    (but(X, (4, 1), np.nan), {}, "X, row 4, column 1 is NaN; fill it in"),
    (but(X, (4, 2), -np.inf), {}, "X, row 4, column 2 is infinity"),
    (X, {"kernel": "set"}, r"set in row 0 has shape \(3,\)"),
    (SETS, {"kernel": "set", "censoring": "cox"}, "censoring uses covariates, and X holds sets"),
    (CONSTANT, {"censoring": "cox"}, "column 3: 3 in every row"),
    (TWICE, LINEAR, r"reg is 0 and the 5 columns of X, the intercept counted, have rank 4"),
    (CONSTANT, LINEAR | {"loss": "absolute"}, "the solution is not unique; leave columns out, or give reg > 0"),
]


@pytest.mark.parametrize(("rows", "parameters", "says"), ROWS)
def test_rows_are_refused(rows, parameters, says):
    assert re.search(says, refusal(lambda: CensoredSVR(**{"reg": 1e-2} | parameters).fit(rows, Y), ArgumentError))


def test_a_constant_covariate_is_no_trouble_elsewhere():
    assert np.isfinite(CensoredSVR(reg=1e-2).fit(CONSTANT, Y).predict(CONSTANT)).all()
    CensoredSVR(**LINEAR, fit_intercept=False).fit(CONSTANT, Y)


INPUTS = [
    (X, (but(TIME, 3, 0.0), IS_FINISHED), "time, row 3: 0.0 is not the end of a trajectory"),
    (X, (but(TIME, 3, -1.0), IS_FINISHED), "time, row 3: -1.0"),
    (X, (but(TIME, 5, np.nan), IS_FINISHED), "time, row 5: nan"),
    (X, (but(TIME, 5, np.inf), IS_FINISHED), "time, row 5: inf"),
    (X, (TIME, but(IS_FINISHED, 2, 7)), "is_finished, row 2: 7.0 is neither"),
    (X, (TIME[:-1], IS_FINISHED), "time has 79 rows and is_finished has 80"),
    (X[:-1], Y, "X has 79 rows and y has 80; give one target a row"),
    (SETS, Y, None),
    (X, np.zeros(80, dtype=[("a", "?"), ("b", "?")]), "one boolean .* and one of times"),
    (X, pd.DataFrame({"time": TIME, "finished": IS_FINISHED}), "y has the columns .*give is_finished"),
    (X, pd.DataFrame({"time": TIME, "time_s": TIME, "is_finished": IS_FINISHED}), "one of time and time_s"),
]


@pytest.mark.parametrize(("rows", "y", "says"), INPUTS)
@pytest.mark.parametrize("model", [CensoredSVR(reg=1e-2), CensoredSVC(tau=1.0, reg=1e-2)])
def test_data_are_refused_where_they_are_wrong(model, rows, y, says):
    with pytest.raises(ValueError, match=says or "samples|dim") as raised:
        model.fit(rows, y)
    if says is not None:
        assert isinstance(raised.value, HalfseenError)
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize("weights", [np.zeros(80), -np.ones(80), np.full(80, np.nan), np.ones(79)])
def test_sample_weights_that_are_none(weights):
    with pytest.raises((ValueError, PositivityError)):
        CensoredSVR(reg=1e-2).fit(X, Y, sample_weight=weights)


def test_one_row():
    with pytest.warns(HalfseenWarning, match="effective sample size") as caught:
        model = CensoredSVR("squared", reg=1e-2).fit(X[:1], (TIME[:1], [True]))
    assert model.predict(X)[5] == pytest.approx(TIME[0])
    assert "\n" not in str(caught[0].message)
    with pytest.warns(HalfseenWarning):
        assert "1 sample was observed" in refusal(lambda: CensoredSVR().fit(X[:1], (TIME[:1], [True])))


def test_few_effective_rows_are_warned_of():
    with pytest.warns(HalfseenWarning, match=r"6 of 12 weights are above 0.* too few .*record more") as caught:
        CensoredSVR(reg=1e-2).fit(X[:12], (TIME[:12], np.arange(12) % 2 == 0))
    assert len(caught) == 1


@pytest.mark.parametrize("model", [CensoredSVR(reg=1e-2), CensoredSVC(tau=1.0, reg=1e-2)])
def test_rows_of_other_columns_are_refused_at_predict(model):
    model.fit(X, Y)
    with pytest.raises(ValueError, match=r"2 features.* 3 features"):
        model.predict(X[:, :2])
    assert "X, row 0, column 0 is NaN" in refusal(lambda: model.predict(np.full((1, 3), np.nan)))
    assert len(model.predict(X[:0])) == 0
    if isinstance(model, CensoredSVR):
        assert "a constant fits" in refusal(lambda: model.score(X[:3], np.ones(3)), ArgumentError)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"random_state": "x"}, "random_state is 'x'; it is a seed"),
        ({"random_state": -1}, "random_state is -1; it is a seed"),
        ({"tau": "x"}, "tau is 'x'; give a time"),
        ({"tol": "x"}, "tol is 'x'; give a share"),
        ({"loss": "pinball", "quantile": "0.5"}, "quantile is '0.5'; give a number in"),
        ({"num_landmarks": 2.5}, "num_landmarks is 2.5; give at least 1"),
    ],
)
def test_parameters_of_another_type_are_refused(parameters, words):
    with refused_type(words):
        CensoredSVR(reg=1e-2, **parameters).fit(X, Y)


GB = 10**9


def test_a_kernel_matrix_that_does_not_fit_names_the_landmarks_that_would(monkeypatch):
    assert refusal(lambda: check_gram_fits(200_000, 20 * GB), ArgumentError) == (
        "the kernel matrix of 200,000 rows takes 960 GB and 20 GB are free; "
        "give num_landmarks=1000 (a low-rank kernel, 1.6 GB), or kernel='linear'"
    )
    assert refusal(lambda: check_gram_fits(10**9, GB), ArgumentError).endswith("free; give kernel='linear'")
    check_gram_fits(1000, 8 * 3 * 1000**2)
    assert "1,000 rows" in refusal(lambda: check_gram_fits(1000, 8 * 3 * 1000**2 - 1), ArgumentError)
    monkeypatch.setattr(machine, "free_bytes", lambda: 60_000)
    message = refusal(lambda: CensoredSVR(reg=1e-2).fit(X, Y), ArgumentError)
    landmarks = int(message.split("num_landmarks=")[1].split()[0])
    assert np.isfinite(CensoredSVR(reg=1e-2, num_landmarks=landmarks).fit(X, Y).predict(X)).all()
    CensoredSVR(reg=1e-2, kernel="linear").fit(X, Y)


@pytest.mark.parametrize("num_rows", [1, 30, 1234, 200_000, 10**7])
@pytest.mark.parametrize("available", [10**4, 10**7, 20 * GB])
def test_advised_landmarks_fit_and_twice_as_many_are_too_many(num_rows, available):
    landmarks = advised_landmarks(num_rows, available)
    assert 8 * num_rows * landmarks <= available / 2
    too_many = 2 * landmarks if landmarks else 1
    assert landmarks <= min(1000, num_rows)
    assert too_many > min(1000, num_rows) or 8 * num_rows * too_many > available / 2


@pytest.mark.parametrize(("limit", "free"), [(None, 32_768), ("max\n", 32_768), ("1000\n", 1000)])
def test_reads_what_the_machine_and_its_container_have(limit, free, tmp_path, monkeypatch):
    assert free_bytes() > 10**6
    monkeypatch.setattr(machine.psutil, "virtual_memory", lambda: SimpleNamespace(available=32_768))
    monkeypatch.setattr(machine, "CONTAINER_LIMIT", tmp_path / "memory.max")
    if limit:
        machine.CONTAINER_LIMIT.write_text(limit)
    assert free_bytes() == free
