"""Each mistake gets one line that names it and the remedy."""

import re
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from convex_oracle import cut_log

from halfseen.errors import ArgumentError, HalfseenError, HalfseenWarning, PositivityError
from halfseen.learning import CensoredSVC, CensoredSVR, survival_array
from halfseen.learning.svm import machine
from halfseen.learning.svm.machine import advised_landmarks, check_gram_fits, free_bytes

X, TIME, IS_FINISHED = cut_log()
Y = survival_array(TIME, IS_FINISHED)
LABELS = TIME > 1
SETS = [row[:, None] for row in X]


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


REGRESSOR = [
    ({"loss": "hinge"}, r"loss is 'hinge'; CensoredSVR has squared, absolute, pinball"),
    ({"kernel": "gauss"}, r"kernel 'gauss' is unknown; give one of linear, rbf"),
    ({"censoring": "km"}, r"censoring is 'km'; it is 'kaplan-meier', 'cox', 'kernel'"),
    ({"gamma": 0}, r"gamma is 0; a kernel's width"),
    ({"gamma": -1.0}, r"gamma is -1.0; a kernel's width"),
    ({"gamma": np.nan}, r"gamma is nan"),
    ({"gamma": "banana"}, r"gamma is 'banana'.*'scale' or 'cv'"),
    ({"gamma": True}, r"gamma is True"),
    ({"gamma": None}, r"gamma is None"),
    ({"reg": -1}, r"reg is -1; it is a λ ≥ 0, or 'cv'"),
    ({"reg": np.nan}, r"reg is nan"),
    ({"reg": np.inf}, r"reg is inf"),
    ({"reg": True}, r"reg is True"),
    ({"reg": None}, r"reg is None"),
    ({"reg": 0}, r"reg is 0, and with an intercept .*fit_intercept=False"),
    ({"reg": 0, "fit_intercept": False, "gamma": 1e-12}, r"reg is 0 and the kernel matrix of .* is singular.*reg > 0"),
    ({"loss": "pinball", "quantile": 0}, r"quantile is 0; it lies in \(0, 1\)"),
    ({"epsilon": -1}, r"epsilon is -1"),
    ({"loss": "huber", "delta": 0}, r"delta is 0"),
    ({"tau": 0}, r"tau is 0; it is a time > 0 s"),
    ({"tau": -2.0}, r"tau is -2.0"),
    ({"tau": np.nan}, r"tau is nan"),
    ({"tau": np.inf}, r"tau is inf"),
    ({"tol": 0.0}, r"tol is 0.0; it is a share"),
    ({"tol": np.nan}, r"tol is nan"),
    ({"truncate_at": 0.5}, r"truncate_at is 0.5; weights are at least 1"),
    ({"degree": 0, "kernel": "polynomial"}, r"degree is 0"),
    ({"num_landmarks": 0}, r"num_landmarks is 0; give at least 1"),
    ({"kernel": lambda x, z: np.ones((2, 2))}, r"the kernel gives shape \(2, 2\)"),
    ({"reg": "cv", "cv": 1}, r"cv is 1; cross-validation needs at least 2 folds"),
    ({"reg": "cv", "cv": 0}, r"cv is 0"),
    ({"censoring": NobodyIsWatched()}, r"path \d+: finished at .* \(Ĝ = 0\).*shorten.*truncate"),
]


@pytest.mark.parametrize(("parameters", "says"), REGRESSOR)
def test_regressor_refuses(parameters, says):
    message = refusal(lambda: CensoredSVR(**{"reg": 1e-2} | parameters).fit(X, Y))
    assert re.search(says, message), message


INPUTS = [
    (X, (but(TIME, 3, 0.0), IS_FINISHED), "time, row 3: 0.0 is no end of a path"),
    (X, (but(TIME, 3, -1.0), IS_FINISHED), "time, row 3: -1.0"),
    (X, (but(TIME, 5, np.nan), IS_FINISHED), "time, row 5: nan"),
    (X, (but(TIME, 5, np.inf), IS_FINISHED), "time, row 5: inf"),
    (X, (TIME, but(IS_FINISHED, 2, 7)), "is_finished, row 2: 7.0 is neither"),
    (X, (TIME[:-1], IS_FINISHED), "time has 79 rows and is_finished has 80"),
    (X[:-1], Y, "X has 79 rows and y has 80; give one target a row"),
    (but(X, (4, 1), np.nan), Y, "X, row 4, column 1 is NaN; fill it in"),
    (but(X, (4, 2), -np.inf), Y, "X, row 4, column 2 is infinity"),
    (SETS, Y, None),
    (X, np.zeros(80, dtype=[("a", "?"), ("b", "?")]), "one boolean .* and one of times"),
    (X, pd.DataFrame({"time": TIME, "finished": IS_FINISHED}), "y has the columns .*give is_finished"),
    (X, pd.DataFrame({"time": TIME, "time_s": TIME, "is_finished": IS_FINISHED}), "one of time and time_s"),
]


@pytest.mark.parametrize(("rows", "y", "says"), INPUTS)
def test_data_are_refused_where_they_are_wrong(rows, y, says):
    for model in (CensoredSVR(reg=1e-2), CensoredSVC(tau=1.0, reg=1e-2)):
        with pytest.raises(ValueError, match=says or "samples|dim") as raised:
            model.fit(rows, y)
        if says is not None:
            assert isinstance(raised.value, HalfseenError)
            assert "\n" not in str(raised.value)


def test_sets_and_rows_are_told_apart():
    assert "set in row 0 has shape (3,)" in refusal(lambda: CensoredSVR(kernel="set", reg=1e-2).fit(X, Y))
    with pytest.raises(ValueError, match="dim"):
        CensoredSVR(reg=1e-2).fit(SETS, Y)
    message = refusal(lambda: CensoredSVR(kernel="set", censoring="cox", reg=1e-2).fit(SETS, Y), ArgumentError)
    assert "censoring uses covariates, and X holds sets" in message


def test_nothing_seen_and_nothing_cut():
    none_seen = (TIME, np.zeros(80, dtype=bool))
    for model in (CensoredSVR(reg=1e-2), CensoredSVC(tau=100.0, reg=1e-2)):
        message = refusal(lambda model=model: model.fit(X, none_seen), PositivityError)
        assert message.startswith("all 80 paths were cut before their target was seen; record until some finish")
    model = CensoredSVR(reg=1e-2).fit(X, (TIME, np.ones(80, dtype=bool)))
    assert (model.weights_ == 1).all()


def test_one_row():
    with pytest.warns(HalfseenWarning, match="effective sample size") as caught:
        model = CensoredSVR("squared", reg=1e-2).fit(X[:1], (TIME[:1], [True]))
    assert model.predict(X)[5] == pytest.approx(TIME[0])
    assert "\n" not in str(caught[0].message)
    with pytest.warns(HalfseenWarning):
        assert "1 sample was seen" in refusal(lambda: CensoredSVR().fit(X[:1], (TIME[:1], [True])))


def test_few_effective_rows_are_warned_of():
    with pytest.warns(HalfseenWarning, match=r"6 of 12 were seen.* too few .*record more") as caught:
        CensoredSVR(reg=1e-2).fit(X[:12], (TIME[:12], np.arange(12) % 2 == 0))
    assert len(caught) == 1


def test_a_constant_covariate_is_no_trouble_but_for_cox():
    rows = np.column_stack([X, np.full(80, 3.0)])
    assert np.isfinite(CensoredSVR(reg=1e-2).fit(rows, Y).predict(rows)).all()
    assert "column 3: 3 in every row" in refusal(
        lambda: CensoredSVR(reg=1e-2, censoring="cox").fit(rows, Y), ArgumentError
    )


def test_a_kernel_matrix_that_does_not_fit_names_the_landmarks_that_would(monkeypatch):
    monkeypatch.setattr(machine, "free_bytes", lambda: 60_000)
    message = refusal(lambda: CensoredSVR(reg=1e-2).fit(X, Y), ArgumentError)
    assert "num_landmarks=" in message
    landmarks = int(message.split("num_landmarks=")[1].split()[0])
    assert np.isfinite(CensoredSVR(reg=1e-2, num_landmarks=landmarks).fit(X, Y).predict(X)).all()
    CensoredSVR(reg=1e-2, kernel="linear").fit(X, Y)


@pytest.mark.parametrize(
    ("parameters", "y", "says"),
    [
        ({}, Y, "y holds times and tau is None; give the tau"),
        ({}, np.arange(80) % 3, "y has 3 classes; tell two apart"),
        ({}, np.ones(80), "only one class"),
        ({"tau": 1e9}, Y, "only one class, .*True.*, was seen among 80 rows"),
        ({"tau": 1e-9}, Y, "only one class, .*False.*, was seen"),
        ({"loss": "squared"}, LABELS, "loss is 'squared'; CensoredSVC has hinge, squared-hinge, logistic"),
        ({"cv": 1}, LABELS, "cv is 1"),
    ],
)
def test_classifier_refuses(parameters, y, says):
    message = refusal(lambda: CensoredSVC(**{"reg": 1e-2} | parameters).fit(X, y), ArgumentError)
    assert re.search(says, message), message


@pytest.mark.parametrize("model", [CensoredSVR(reg=1e-2), CensoredSVC(tau=1.0, reg=1e-2)])
def test_rows_of_other_columns_are_refused_at_predict(model):
    model.fit(X, Y)
    with pytest.raises(ValueError, match=r"2 features.* 3 features"):
        model.predict(X[:, :2])
    assert "X, row 0, column 0 is NaN" in refusal(lambda: model.predict(np.full((1, 3), np.nan)))
    assert len(model.predict(X[:0])) == 0


@pytest.mark.parametrize("weights", [np.zeros(80), -np.ones(80), np.full(80, np.nan), np.ones(79)])
def test_sample_weights_that_are_none(weights):
    with pytest.raises((ValueError, PositivityError)):
        CensoredSVR(reg=1e-2).fit(X, Y, sample_weight=weights)


def test_score_of_targets_that_a_constant_fits():
    model = CensoredSVR(reg=1e-2).fit(X, Y)
    assert "a constant fits" in refusal(lambda: model.score(X[:3], np.ones(3)), ArgumentError)


def test_dependent_columns_without_a_penalty_are_refused():
    twice = np.column_stack([X, X[:, 0] + X[:, 1]])
    with pytest.raises(ArgumentError, match=r"reg is 0 and the \d+ columns of X, the intercept counted, have rank \d+"):
        CensoredSVR("squared", kernel="linear", reg=0).fit(twice, Y)
    constant = np.column_stack([X, np.ones(len(X))])
    with pytest.raises(ArgumentError, match="many functions fit alike; leave columns out, or give reg > 0"):
        CensoredSVR("absolute", kernel="linear", reg=0).fit(constant, Y)
    CensoredSVR("squared", kernel="linear", reg=0, fit_intercept=False).fit(constant, Y)


GB = 10**9


def test_message_says_what_is_needed_what_is_free_and_what_would_fit():
    with pytest.raises(ArgumentError) as refusal:
        check_gram_fits(200_000, available_bytes=20 * GB)
    assert str(refusal.value) == (
        "the kernel matrix of 200,000 rows takes 960 GB and 20 GB are free; "
        "give num_landmarks=1000 (a low-rank kernel, 1.6 GB), or kernel='linear'"
    )


def test_exactly_what_fits_is_accepted():
    needed = 8 * 3 * 1000**2
    check_gram_fits(1000, needed)
    with pytest.raises(ArgumentError, match="1,000 rows"):
        check_gram_fits(1000, needed - 1)


def test_without_memory_for_landmarks_only_the_linear_kernel_is_advised():
    with pytest.raises(ArgumentError, match=r"free; give kernel='linear'$"):
        check_gram_fits(10**9, available_bytes=GB)


@pytest.mark.parametrize("num_rows", [1, 30, 1234, 200_000, 10**7])
@pytest.mark.parametrize("available", [10**4, 10**7, 20 * GB])
def test_advised_landmarks_fit_and_twice_as_many_are_too_many(num_rows, available):
    landmarks = advised_landmarks(num_rows, available)
    assert 8 * num_rows * landmarks <= available / 2
    too_many = 2 * landmarks if landmarks else 1
    assert landmarks <= min(1000, num_rows)
    assert too_many > min(1000, num_rows) or 8 * num_rows * too_many > available / 2


def test_reads_what_the_machine_and_its_container_have(tmp_path, monkeypatch):
    assert free_bytes() > 10**6
    limit, memory = tmp_path / "memory.max", SimpleNamespace(available=32 * 1024)
    monkeypatch.setattr(machine.psutil, "virtual_memory", lambda: memory)
    monkeypatch.setattr(machine, "CONTAINER_LIMIT", limit)
    assert free_bytes() == 32 * 1024
    limit.write_text("max\n")
    assert free_bytes() == 32 * 1024
    limit.write_text("1000\n")
    assert free_bytes() == 1000
    with pytest.raises(ArgumentError, match="1e-06 GB are free"):
        check_gram_fits(1000)
