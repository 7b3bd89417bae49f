"""The fit is the optimum of the objective that the docstring prints: cvxpy, libsvm and a closed form say so."""

import numpy as np
import pytest
from convex_oracle import CLASSIFICATION, DELTA, EPSILON, LOSSES, QUANTILE, REGRESSION, optimum, tied_rows
from sklearn.kernel_ridge import KernelRidge
from sklearn.metrics.pairwise import laplacian_kernel, linear_kernel, polynomial_kernel, rbf_kernel
from sklearn.svm import SVC, SVR

from halfseen.learning import CensoredSVC, CensoredSVR
from halfseen.learning.svm.losses import named_loss
from halfseen.learning.svm.newton import Features, Gram
from halfseen.learning.svm.solver import Problem, solve

GAMMA = 0.4
GRAMS = {
    "linear": lambda x, z: linear_kernel(x, z),
    "rbf": lambda x, z: rbf_kernel(x, z, gamma=GAMMA),
    "laplacian": lambda x, z: laplacian_kernel(x, z, gamma=GAMMA),
    "polynomial": lambda x, z: polynomial_kernel(x, z, gamma=GAMMA, degree=2, coef0=1.0),
}


def estimator(loss, **parameters):
    if loss in CLASSIFICATION:
        return CensoredSVC(loss, calibrate=False, gamma=GAMMA, degree=2, **parameters)
    return CensoredSVR(loss, quantile=QUANTILE, epsilon=EPSILON, delta=DELTA, gamma=GAMMA, degree=2, **parameters)


def values(model, rows):
    return model.predict(rows) if isinstance(model, CensoredSVR) else model.decision_function(rows)


@pytest.mark.parametrize("reg", [0.1, 1e-3])
@pytest.mark.parametrize("fit_intercept", [True, False])
@pytest.mark.parametrize("kernel", list(GRAMS))
@pytest.mark.parametrize("loss", list(LOSSES))
def test_fit_is_the_optimum_that_cvxpy_finds(loss, kernel, fit_intercept, reg):
    rows, y, labels, weights = tied_rows()
    target = labels if loss in CLASSIFICATION else y
    model = estimator(loss, kernel=kernel, fit_intercept=fit_intercept, reg=reg)
    model.fit(rows, target, sample_weight=weights)
    mass = weights / weights.sum()
    best, f = optimum(GRAMS[kernel](rows, rows), target, mass, loss, reg, fit_intercept)
    assert model.objective_ == pytest.approx(best, rel=2e-8, abs=1e-12)
    assert 0.0 <= model.duality_gap_ <= 1e-8 * model.objective_
    np.testing.assert_allclose(values(model, rows), f, atol=1e-4)


@pytest.mark.parametrize("loss", list(LOSSES))
def test_solver_agrees_with_cvxpy_where_mass_is_any_number_and_the_features_are_few(loss):
    rows, y, labels, weights = tied_rows(seed=1)
    target = labels if loss in CLASSIFICATION else y
    seen = weights > 0
    named = named_loss(loss, epsilon=EPSILON, quantile=QUANTILE, delta=DELTA)
    gram, mass = linear_kernel(rows[seen], rows[seen]), 1e3 * weights[seen]
    best, f = optimum(gram, target[seen], mass, loss, 2.0, True)
    for space in (Features(rows[seen]), Gram(gram)):
        solution = solve(Problem(space, target[seen], mass, named, 2.0, True))
        assert solution.objective == pytest.approx(best, rel=2e-8)
        assert solution.relative_gap <= 1e-8
        np.testing.assert_allclose(space.matrix @ solution.coefficients + solution.offset, f, atol=1e-4)


@pytest.mark.parametrize("loss", ["absolute", "huber", "squared"])
def test_without_penalty_it_is_regression_by_that_loss(loss):
    rows, y, _, _ = tied_rows(seed=2)
    model = estimator(loss, kernel="linear", reg=0).fit(rows, y)
    best, _ = optimum(linear_kernel(rows, rows), y, np.full(len(y), 1 / len(y)), loss, 0.0, True)
    assert model.objective_ == pytest.approx(best, rel=1e-7)
    assert model.duality_gap_ <= 1e-8 * model.objective_


@pytest.mark.parametrize("reg", [0.1, 1e-3])
def test_hinge_is_libsvm(reg):
    rows, _, labels, weights = tied_rows(120)
    model = CensoredSVC(reg=reg, gamma=GAMMA, calibrate=False).fit(rows, labels, sample_weight=weights)
    peer = SVC(C=1.0, gamma=GAMMA, tol=1e-10)
    peer.fit(rows, labels, sample_weight=weights / (2 * reg * weights.sum()))
    np.testing.assert_allclose(model.decision_function(rows), peer.decision_function(rows), atol=1e-6)


@pytest.mark.parametrize("epsilon", [0.0, 0.1])
def test_epsilon_insensitive_is_libsvm(epsilon):
    rows, y, _, weights = tied_rows(120)
    model = CensoredSVR(reg=1e-2, gamma=GAMMA, epsilon=epsilon).fit(rows, y, sample_weight=weights)
    peer = SVR(C=1.0, gamma=GAMMA, tol=1e-10, epsilon=epsilon)
    peer.fit(rows, y, sample_weight=weights / (2e-2 * weights.sum()))
    np.testing.assert_allclose(model.predict(rows), peer.predict(rows), atol=1e-5)


@pytest.mark.parametrize("kernel", ["linear", "rbf", "laplacian"])
def test_squared_without_intercept_is_kernel_ridge(kernel):
    rows, y, _, weights = tied_rows()
    model = CensoredSVR("squared", reg=1e-2, kernel=kernel, gamma=GAMMA, fit_intercept=False)
    model.fit(rows, y, sample_weight=weights)
    seen = weights > 0
    peer = KernelRidge(alpha=1e-2, kernel=kernel, gamma=GAMMA)
    peer.fit(rows[seen], y[seen], sample_weight=weights[seen] / weights.sum())
    np.testing.assert_allclose(model.predict(rows), peer.predict(rows), atol=1e-10)


@pytest.mark.parametrize("loss", [*REGRESSION, *CLASSIFICATION])
@pytest.mark.parametrize("num_rows", [2, 3, 5])
def test_few_rows(loss, num_rows):
    rows, y, _, _ = tied_rows(num_rows)
    labels = np.where(np.arange(num_rows) % 2, 1.0, -1.0)
    target = labels if loss in CLASSIFICATION else y
    model = estimator(loss, reg=1e-2).fit(rows, target)
    best, _ = optimum(GRAMS["rbf"](rows, rows), target, np.full(num_rows, 1 / num_rows), loss, 1e-2, True)
    assert model.objective_ == pytest.approx(best, rel=1e-7, abs=1e-11)
