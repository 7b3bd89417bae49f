"""Losses, and those of the user's own, against their definitions by plain numbers; what is none is refused."""

from types import SimpleNamespace

import cvxpy as cp
import numpy as np
import pytest
from convex_oracle import optimum, tied_rows
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar
from sklearn.base import clone
from sklearn.metrics.pairwise import rbf_kernel

from halfseen.errors import ArgumentError
from halfseen.learning import CensoredSVC, CensoredSVR
from halfseen.learning.svm.losses import CLASSIFICATION, REGRESSION, OwnLoss, named_loss, own_loss
from halfseen.learning.svm.solver import best_constant

FORMULAS = {
    "squared": lambda y, s: (y - s) ** 2,
    "absolute": lambda y, s: abs(y - s),
    "pinball": lambda y, s: max(0.3 * (y - s), 0.7 * (s - y)),
    "epsilon-insensitive": lambda y, s: max(abs(y - s) - 0.1, 0),
    "huber": lambda y, s: 0.5 * (y - s) ** 2 if abs(y - s) <= 0.7 else 0.7 * (abs(y - s) - 0.35),
    "hinge": lambda y, s: max(1 - y * s, 0),
    "squared-hinge": lambda y, s: max(1 - y * s, 0) ** 2,
    "logistic": lambda y, s: np.log(1 + np.exp(-y * s)),
}
NAMES = list(FORMULAS)
SMOOTH = ["squared", "huber", "squared-hinge", "logistic"]
PROXIMAL = ["absolute", "pinball", "epsilon-insensitive", "hinge"]
NUMBERS = st.floats(-20, 20)


def loss_of(name):
    return named_loss(name, epsilon=0.1, quantile=0.3, delta=0.7)


def target(name, y):
    return np.array([np.sign(y) or 1.0 if name in CLASSIFICATION else y])


@pytest.mark.parametrize("name", NAMES)
@given(y=NUMBERS, s=NUMBERS, shift=NUMBERS)
def test_value_is_the_formula_and_what_is_said_of_differences_holds(name, y, s, shift):
    loss, y, s = loss_of(name), target(name, y), np.array([s])
    assert loss.value(y, s)[0] == pytest.approx(FORMULAS[name](y[0], s[0]), rel=1e-12, abs=1e-13)
    assert loss.is_of_difference == (name in REGRESSION)
    assert loss.is_smooth == (name in SMOOTH)
    if loss.is_of_difference:
        assert loss.value(y + shift, s + shift) == pytest.approx(loss.value(y, s), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("name", SMOOTH)
@given(y=NUMBERS, s=NUMBERS, other=NUMBERS)
def test_slope_and_curvature_are_those_of_the_value(name, y, s, other):
    loss, y, step = loss_of(name), target(name, y), 1e-5
    s, other = np.array([s]), np.array([other])
    slope = loss.slope(y, s, 0.0)
    rise = (loss.value(y, s + step) - loss.value(y, s - step)) / (2 * step)
    np.testing.assert_allclose(slope, rise, atol=1e-4)
    np.testing.assert_array_less(-1e-12, (loss.slope(y, other, 0.0) - slope) * (other - s))
    bends = [(loss.slope(y, s + way * step, 0.0) - slope) / (way * step) for way in (1, -1)]
    is_kink = abs(bends[0] - bends[1]) > 1e-3
    assert is_kink or loss.curvature(y, s, 0.0) == pytest.approx(bends[0], abs=1e-3)


@pytest.mark.parametrize("name", [*PROXIMAL, "huber", "squared", "squared-hinge"])
@given(y=NUMBERS, v=NUMBERS, step=st.sampled_from([1e-3, 0.3, 5.0]))
def test_slope_is_that_of_the_envelope_by_its_definition(name, y, v, step):
    loss, y, v = loss_of(name), target(name, y), np.array([v])
    slope = loss.slope(y, v, step)
    s = v - step * slope

    def cost(candidate):
        return float(loss.value(y, np.array([candidate]))[0] + (candidate - v[0]) ** 2 / (2 * step))

    width = step * abs(slope[0]) + 2 * step + 1e-6
    found = minimize_scalar(cost, bounds=(v[0] - width, v[0] + width), method="bounded")
    assert cost(s[0]) <= found.fun + 1e-12 * (1.0 + abs(found.fun))
    nudge = 1e-7
    ahead, back = ((loss.slope(y, v + way * nudge, step) - slope) / (way * nudge) for way in (1, -1))
    own = loss.curvature(y, v, step)
    assert 0 <= own * step <= 1
    assert min(abs(own - ahead), abs(own - back)) * step < 1e-5


GRID = np.linspace(-30, 30, 60_001)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("y", [-1.0, 1.0])
def test_conjugate_is_the_supremum(name, y):
    loss, s = loss_of(name), np.concatenate([GRID, [-1e9, 1e9]])
    value = loss.value(np.full(len(s), y), s)
    for t in (-25.0, -1.2, -0.6, -0.2, 0.0, 0.2, 0.6, 1.2, 25.0):
        gains, found = t * s - value, loss.conjugate(np.array([y]), np.array([t]))[0]
        if found == np.inf:
            assert gains.argmax() >= len(GRID)
        else:
            assert found == pytest.approx(gains.max(), abs=1e-6)


@pytest.mark.parametrize("quantile", [0.05, 0.5, 0.9])
def test_the_best_constant_of_pinball_is_the_weighted_quantile(quantile):
    rng = np.random.default_rng(0)
    y, weight = rng.normal(size=101), rng.exponential(size=101)
    order = np.argsort(y)
    at = np.searchsorted(np.cumsum(weight[order]), quantile * weight.sum())
    assert best_constant(y, weight, named_loss("pinball", quantile=quantile)) == pytest.approx(y[order][at], abs=1e-7)
    assert best_constant(y, weight, named_loss("squared")) == pytest.approx(np.average(y, weights=weight), abs=1e-12)
    assert best_constant(y + 1e6, np.ones(101), named_loss("absolute")) == pytest.approx(1e6 + np.median(y), abs=1e-6)


@pytest.mark.parametrize(
    ("name", "parameters", "says"),
    [
        *(("pinball", {"quantile": q}, f"quantile is {q}") for q in (0, 1.0, np.nan)),
        *(("epsilon-insensitive", {"epsilon": e}, f"epsilon is {e}") for e in (-0.1, np.inf)),
        *(("huber", {"delta": d}, f"delta is {d}") for d in (0, np.nan)),
        ("hingee", {}, "unknown loss 'hingee'; give one of squared, absolute"),
    ],
)
def test_refuses(name, parameters, says):
    with pytest.raises(ArgumentError, match=says):
        named_loss(name, **parameters)


ROWS, Y, LABELS, _ = tied_rows(24)
GRAM, MASS = rbf_kernel(ROWS, gamma=0.3), np.full(len(Y), 1 / len(Y))


def log_cosh(y, s):
    return np.abs(y - s) + np.log1p(np.exp(-2 * np.abs(y - s))) - np.log(2)


def quantile_huber(y, s):
    """Huber, three times as steep where the target is above."""
    r = np.abs(y - s)
    return np.where(y > s, 3.0, 1.0) * np.where(r <= 0.5, 0.5 * r**2, 0.5 * (r - 0.25))


def absolute(y, s):
    return np.abs(y - s)


OWN = {
    "log-cosh": SimpleNamespace(value=log_cosh, derivative=lambda y, s: np.tanh(s - y)),
    "quantile-huber": SimpleNamespace(
        value=quantile_huber, derivative=lambda y, s: -np.where(y > s, 3.0, 1.0) * np.clip(y - s, -0.5, 0.5)
    ),
    "absolute by its slope": SimpleNamespace(value=absolute, derivative=lambda y, s: np.sign(s - y)),
    "absolute by its step": SimpleNamespace(
        value=absolute, proximal=lambda y, v, step: v - np.clip(v - y, -step, step)
    ),
}
CVXPY = {
    "log-cosh": lambda y, f: cp.logistic(2 * (y - f)) - (y - f) - np.log(2),
    "quantile-huber": lambda y, f: 1.5 * cp.huber(cp.pos(y - f), 0.5) + 0.5 * cp.huber(cp.pos(f - y), 0.5),
    "absolute by its slope": "absolute",
    "absolute by its step": "absolute",
}


@pytest.mark.slow
@pytest.mark.parametrize("own", list(OWN))
@pytest.mark.parametrize("has_offset", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_fit_is_the_optimum_that_cvxpy_finds(own, has_offset):
    model = CensoredSVR(OWN[own], reg=1e-2, gamma=0.3, fit_intercept=has_offset, tol=1e-6).fit(ROWS, Y)
    best, f = optimum(GRAM, Y, MASS, CVXPY[own], 1e-2, has_offset)
    assert model.objective_ == pytest.approx(best, rel=1e-6)
    assert model.objective_ - model.duality_gap_ <= best * (1 + 1e-8)
    np.testing.assert_allclose(model.predict(ROWS), f, atol=1e-3)


def test_own_logistic_is_the_built_in_one():
    logistic = SimpleNamespace(
        value=lambda y, s: np.logaddexp(0, -y * s), derivative=lambda y, s: -y / (1 + np.exp(y * s))
    )
    own = CensoredSVC(logistic, reg=1e-2, tol=1e-6, calibrate=False).fit(ROWS, LABELS)
    built_in = CensoredSVC("logistic", reg=1e-2, calibrate=False).fit(ROWS, LABELS)
    np.testing.assert_allclose(own.decision_function(ROWS), built_in.decision_function(ROWS), atol=1e-3)


def test_a_loss_of_the_library_passes_as_it_is():
    loss = named_loss("huber", delta=0.7)
    assert own_loss(loss, Y) is loss
    own, named = CensoredSVR(loss, reg=1e-2).fit(ROWS, Y), CensoredSVR("huber", delta=0.7, reg=1e-2).fit(ROWS, Y)
    assert own.objective_ == named.objective_
    assert clone(own).loss == loss


@pytest.mark.parametrize("name", [name for name in OWN if name != "quantile-huber"])
def test_conjugate_and_envelope_are_worked_out(name):
    own, y = OWN[name], np.zeros(5)
    loss = OwnLoss(own)
    t = np.array([-0.9, -0.3, 0.0, 0.3, 0.9])
    supremum = [(slope * GRID - own.value(0.0, GRID)).max() for slope in t]
    np.testing.assert_allclose(loss.conjugate(y, t), supremum, atol=1e-6)
    assert (loss.conjugate(y[:2], np.array([-1.1, 1.1])) > 1e3).all()
    if name != "log-cosh":
        v, theirs = np.array([-3.0, -0.4, 0.1, 1.5, 3.0]), named_loss("absolute")
        np.testing.assert_allclose(loss.slope(y, v, 0.7), theirs.slope(y, v, 0.7), atol=1e-12)
        np.testing.assert_allclose(loss.curvature(y, v, 0.7), theirs.curvature(y, v, 0.7), atol=1e-6)


def kinked(value):
    return SimpleNamespace(value=value, derivative=lambda y, s: np.sign(s - y))


@pytest.mark.parametrize(
    ("own", "says"),
    [
        (kinked(lambda y, s: np.sqrt(np.abs(y - s))), r"not convex at y = .*convex in s"),
        (kinked(lambda y, s: np.where(s > y, np.nan, 0.0)), r"not finite; return one finite number a row"),
        (kinked(lambda y, s: np.abs(y - s).sum()), r"gives shape \(\) for 24 rows"),
        (SimpleNamespace(value=absolute), r"without value\(y, s\) and proximal\(y, v, step\) or derivative"),
        (np.abs, r"without value\(y, s\)"),
    ],
)
def test_what_is_no_loss_is_refused(own, says):
    with pytest.raises(ArgumentError, match=says) as refusal:
        CensoredSVR(own, reg=1e-2).fit(ROWS, Y)
    assert "\n" not in str(refusal.value)
