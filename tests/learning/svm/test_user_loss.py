"""Losses of the user's own: as good as built-in ones, and refused where they are none."""

import cvxpy as cp
import numpy as np
import pytest
from convex_oracle import optimum, tied_rows
from sklearn.base import clone
from sklearn.metrics.pairwise import rbf_kernel

from halfseen.errors import ArgumentError
from halfseen.learning import CensoredSVC, CensoredSVR
from halfseen.learning.svm.losses import Huber, UserLoss, named_loss, own_loss

ROWS, Y, LABELS, _ = tied_rows()
GRAM, MASS = rbf_kernel(ROWS, gamma=0.3), np.full(len(Y), 1 / len(Y))


class LogCosh:
    def value(self, y, s):
        r = np.abs(y - s)
        return r + np.log1p(np.exp(-2 * r)) - np.log(2)

    def derivative(self, y, s):
        return np.tanh(s - y)


class QuantileHuber:
    """Huber, three times as steep where the target is above."""

    def value(self, y, s):
        r = y - s
        return np.where(r > 0, 3.0, 1.0) * np.where(np.abs(r) <= 0.5, 0.5 * r**2, 0.5 * (np.abs(r) - 0.25))

    def derivative(self, y, s):
        r = y - s
        return -np.where(r > 0, 3.0, 1.0) * np.clip(r, -0.5, 0.5)


class Kinked:
    """|y − s|, by its slope only."""

    def value(self, y, s):
        return np.abs(y - s)

    def derivative(self, y, s):
        return np.sign(s - y)


class OwnAbsolute:
    """|y − s|, by its proximal step only."""

    def value(self, y, s):
        return np.abs(y - s)

    def proximal(self, y, v, step):
        return v - np.clip(v - y, -step, step)


class OwnLogistic:
    def value(self, y, s):
        return np.logaddexp(0, -y * s)

    def derivative(self, y, s):
        return -y / (1 + np.exp(y * s))


CVXPY = {
    LogCosh: lambda y, f: cp.logistic(2 * (y - f)) - (y - f) - np.log(2),
    QuantileHuber: lambda y, f: 1.5 * cp.huber(cp.pos(y - f), 0.5) + 0.5 * cp.huber(cp.pos(f - y), 0.5),
    Kinked: "absolute",
    OwnAbsolute: "absolute",
}


@pytest.mark.parametrize("own", list(CVXPY))
@pytest.mark.parametrize("has_offset", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_fit_is_the_optimum_that_cvxpy_finds(own, has_offset):
    model = CensoredSVR(own(), reg=1e-2, gamma=0.3, fit_intercept=has_offset, tol=1e-6).fit(ROWS, Y)
    best, f = optimum(GRAM, Y, MASS, CVXPY[own], 1e-2, has_offset)
    assert model.objective_ == pytest.approx(best, rel=1e-6)
    assert model.objective_ - model.duality_gap_ <= best * (1 + 1e-8)
    np.testing.assert_allclose(model.predict(ROWS), f, atol=1e-3)


def test_own_logistic_is_the_built_in_one():
    own = CensoredSVC(OwnLogistic(), reg=1e-2, tol=1e-6, calibrate=False).fit(ROWS, LABELS)
    built_in = CensoredSVC("logistic", reg=1e-2, calibrate=False).fit(ROWS, LABELS)
    np.testing.assert_allclose(own.decision_function(ROWS), built_in.decision_function(ROWS), atol=1e-3)


def test_a_loss_of_the_library_passes_as_it_is():
    loss = Huber(0.7)
    assert own_loss(loss, Y) is loss
    own, named = CensoredSVR(loss, reg=1e-2).fit(ROWS, Y), CensoredSVR("huber", delta=0.7, reg=1e-2).fit(ROWS, Y)
    assert own.objective_ == named.objective_
    assert clone(own).loss.delta == 0.7


@pytest.mark.parametrize("own", [LogCosh(), Kinked(), OwnAbsolute()])
def test_conjugate_and_proximal_step_are_worked_out(own):
    loss, y = UserLoss(own), np.zeros(5)
    t = np.array([-0.9, -0.3, 0.0, 0.3, 0.9])
    s = np.linspace(-30, 30, 600_001)
    supremum = [(slope * s - own.value(0.0, s)).max() for slope in t]
    np.testing.assert_allclose(loss.conjugate(y, t), supremum, atol=1e-6)
    assert (loss.conjugate(y[:2], np.array([-1.1, 1.1])) > 1e3).all()
    if not isinstance(own, LogCosh):
        v = np.linspace(-3, 3, 5)
        np.testing.assert_allclose(loss.proximal(y, v, 0.7), named_loss("absolute").proximal(y, v, 0.7), atol=1e-12)


class NotConvex(Kinked):
    def value(self, y, s):
        return np.sqrt(np.abs(y - s))


class NotFinite(Kinked):
    def value(self, y, s):
        return np.where(s > y, np.nan, 0.0)


class OneNumber(Kinked):
    def value(self, y, s):
        return np.abs(y - s).sum()


class NoSlope:
    def value(self, y, s):
        return np.abs(y - s)


@pytest.mark.parametrize(
    ("own", "says"),
    [
        (NotConvex(), r"bends down at y = .*convex in s"),
        (NotFinite(), r"not finite; return one finite number a row"),
        (OneNumber(), r"gives shape \(\) for 40 rows"),
        (NoSlope(), r"without value\(y, s\) and proximal\(y, v, step\) or derivative"),
        (np.abs, r"without value\(y, s\)"),
    ],
)
def test_refuses(own, says):
    with pytest.raises(ArgumentError, match=says) as refusal:
        CensoredSVR(own, reg=1e-2).fit(ROWS, Y)
    assert "\n" not in str(refusal.value)
