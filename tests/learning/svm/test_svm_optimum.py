"""The fit is the optimum of the objective that the docstring prints: cvxpy, libsvm and a closed form say so.

And targets, weights, rows and λ of any size leave a small gap, with no warning where there is nothing to warn of.
"""

from dataclasses import replace

import numpy as np
import pytest
from convex_oracle import CLASSIFICATION, DELTA, EPSILON, LOSSES, QUANTILE, REGRESSION, optimum, tied_rows
from sklearn.kernel_ridge import KernelRidge
from sklearn.metrics.pairwise import laplacian_kernel, linear_kernel, polynomial_kernel, rbf_kernel
from sklearn.svm import SVC, SVR

from halfseen.errors import HalfseenWarning
from halfseen.learning import CensoredSVC, CensoredSVR
from halfseen.learning.svm import newton, solver
from halfseen.learning.svm.losses import PiecewiseLoss, named_loss
from halfseen.learning.svm.newton import Features, Gram, Point
from halfseen.learning.svm.solver import Problem, certify, solve

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


@pytest.mark.parametrize(
    ("fit_intercept", "reg"),
    [
        (True, 1e-3),
        (False, 0.1),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in ((True, 0.1), (False, 1e-3))),
    ],
)
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


@pytest.mark.parametrize(
    ("model", "peer"),
    [
        (CensoredSVC(reg=0.1, gamma=GAMMA, calibrate=False), SVC(C=1.0, gamma=GAMMA, tol=1e-10)),
        (CensoredSVC(reg=1e-3, gamma=GAMMA, calibrate=False), SVC(C=1.0, gamma=GAMMA, tol=1e-10)),
        (CensoredSVR(reg=1e-2, gamma=GAMMA, epsilon=0.0), SVR(C=1.0, gamma=GAMMA, tol=1e-10, epsilon=0.0)),
        (CensoredSVR(reg=1e-2, gamma=GAMMA, epsilon=0.1), SVR(C=1.0, gamma=GAMMA, tol=1e-10, epsilon=0.1)),
    ],
)
def test_kinked_losses_are_libsvm(model, peer):
    rows, y, labels, weights = tied_rows(120)
    target = y if isinstance(peer, SVR) else labels
    model.fit(rows, target, sample_weight=weights)
    peer.fit(rows, target, sample_weight=weights / (2 * model.reg * weights.sum()))
    theirs = peer.predict(rows) if isinstance(peer, SVR) else peer.decision_function(rows)
    np.testing.assert_allclose(values(model, rows), theirs, atol=1e-5 if isinstance(peer, SVR) else 1e-6)


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


ROWS, Y, LABELS, _ = tied_rows(60)


def assert_certified(model):
    assert model.duality_gap_ <= max(1e-8 * model.objective_, 1e-14)


@pytest.mark.parametrize("loss", REGRESSION)
@pytest.mark.parametrize(
    ("reg", "constant"), [*((1e-3, each) for each in (0.0, 3.0, 0.1, -1e9)), ("cv", 0.1), ("cv", -1e9)]
)
def test_a_constant_target_is_fitted_without_a_warning(loss, reg, constant):
    model = CensoredSVR(loss, reg=reg).fit(ROWS, np.full(60, constant))
    np.testing.assert_allclose(model.predict(ROWS), constant, atol=0.101 if loss == "epsilon-insensitive" else 1e-6)


@pytest.mark.parametrize("loss", REGRESSION)
@pytest.mark.parametrize("shift", [1e6, -1e9])
def test_targets_far_from_0_are_those_near_it_moved(loss, shift):
    near, far = CensoredSVR(loss, reg=1e-3).fit(ROWS, Y), CensoredSVR(loss, reg=1e-3).fit(ROWS, Y + shift)
    assert far.objective_ == pytest.approx(near.objective_, rel=1e-5)
    np.testing.assert_allclose(far.predict(ROWS) - shift, near.predict(ROWS), atol=1e-3)


@pytest.mark.parametrize("loss", ["squared", "absolute", "pinball"])
@pytest.mark.parametrize("scale", [1e9, 1e-9])
def test_the_choice_of_reg_knows_no_unit(loss, scale):
    one, other = (CensoredSVR(loss, cv=2).fit(ROWS, unit * Y) for unit in (1.0, scale))
    np.testing.assert_allclose(other.predict(ROWS) / scale, one.predict(ROWS), atol=1e-5)


WEIGHTS = {
    "one heavy": np.where(np.arange(60) % 7, 1.0, 1e6),
    "any": np.logspace(-6, 6, 60),
    "all heavy": np.full(60, 1e6),
}


@pytest.mark.parametrize("loss", [*REGRESSION, *CLASSIFICATION])
@pytest.mark.parametrize("case", [1e6, 1e-6, *WEIGHTS, "repeated"])
def test_reg_weights_and_rows_of_any_kind(loss, case):
    reg, weights = case if isinstance(case, float) else 1e-3, WEIGHTS.get(case)
    rows = np.repeat(ROWS[:6], 10, axis=0) if case == "repeated" else ROWS
    is_label = loss in CLASSIFICATION
    model = CensoredSVC(loss, reg=reg, calibrate=False) if is_label else CensoredSVR(loss, reg=reg)
    assert_certified(model.fit(rows, LABELS if is_label else Y, sample_weight=weights))


@pytest.mark.parametrize("loss", REGRESSION)
def test_rows_that_are_all_alike(loss):
    model = CensoredSVR(loss, reg=1e-3, quantile=0.5).fit(np.ones((60, 3)), Y)
    assert np.ptp(model.predict(np.ones((3, 3)))) < 1e-12


def test_epsilon_beyond_all_targets_costs_nothing():
    model = CensoredSVR(epsilon=100.0, reg=1e-3).fit(ROWS, Y)
    assert model.objective_ == model.duality_gap_ == 0.0
    assert np.ptp(model.predict(ROWS)) == 0.0


@pytest.mark.parametrize("loss", CLASSIFICATION)
def test_one_row_of_the_other_class(loss):
    labels = np.where(np.arange(60) == 5, 1, -1)
    model = CensoredSVC(loss, reg=1e-3).fit(ROWS, labels)
    assert_certified(model)
    assert model.predict_proba(ROWS)[:, 1].mean() < 0.2


@pytest.mark.parametrize("loss", ["epsilon-insensitive", "absolute"])
def test_interpolation_without_penalty_ends(loss):
    model = CensoredSVR(loss, reg=0, fit_intercept=False, gamma=3.0).fit(ROWS, Y)
    assert model.objective_ < 1e-12


@pytest.mark.parametrize("reg", [1e-2, 1e-6, 1e-11])
@pytest.mark.parametrize("loss", REGRESSION)
def test_the_gap_bounds_the_distance_to_the_optimum(loss, reg):
    gram, mass = rbf_kernel(ROWS, gamma=0.3), np.full(60, 1 / 60)
    best, f = optimum(gram, Y, mass, loss, 1e-2, True)
    named = named_loss(loss, quantile=0.3, delta=0.7)
    problem = Problem(Gram(gram), Y, mass, named, 1e-2, True)
    # Any point and any pulls, as a solver that stops early leaves them.
    rng = np.random.default_rng(0)
    for size in (reg, 10 * reg):
        coefficients = np.linalg.solve(gram + 1e-9 * np.eye(60), f - f.mean() + size * rng.normal(size=60))
        point = Point(coefficients, gram @ coefficients, float(f.mean()))
        found = certify(problem, point, rng.uniform(-0.3, 0.3, size=60))
        assert found.objective - found.gap <= best + 1e-9


@pytest.mark.parametrize("loss", [*REGRESSION, *CLASSIFICATION])
@pytest.mark.parametrize("pull", [1e-9, 0.25, -0.25])
def test_pulls_that_do_not_cancel_certify_nothing(loss, pull):
    # All pull one way, so f may run the other way for free: no bound but that of the least loss follows.
    y = np.array([1.0, -1.0, 1.0])
    named = named_loss(loss, quantile=0.3)
    problem = Problem(Features(np.eye(3)), y, np.full(3, 1 / 3), named, 0.1, True)
    best, _ = optimum(np.eye(3), y, problem.mass, loss, 0.1, True)
    found = certify(problem, Point(np.zeros(3), np.zeros(3), 0.0), np.full(3, pull))
    assert found.objective - found.gap <= best + 1e-12


def test_tiny_pulls_are_balanced_too():
    problem = Problem(
        Features(np.eye(2)), np.array([1.0, -1.0]), np.full(2, 0.5), named_loss("squared-hinge"), 1e-12, True
    )
    found = certify(problem, Point(np.array([1.0, -1.0]), np.array([1.0, -1.0]), 0.0), np.array([1e-11, -2e-11]))
    assert 0.0 < found.gap < 1e-10
    assert found.pull.sum() == 0.0


def test_above_the_tolerance_it_warns_and_names_the_remedy():
    with pytest.warns(HalfseenWarning, match=r"duality gap is .* raise reg from 1e-12.*larger tol") as caught:
        CensoredSVR("squared", kernel="polynomial", reg=1e-12).fit(ROWS, Y)
    assert "\n" not in str(caught[0].message)


KINKED = ("absolute", "pinball", "epsilon-insensitive")


def problem(loss, reg, has_offset=True, num_rows=60, mass=None):
    rows, y, _, _ = tied_rows(num_rows, seed=3)
    mass = np.full(num_rows, 1 / num_rows) if mass is None else mass
    return Problem(Gram(rbf_kernel(rows, gamma=0.3)), y, mass, named_loss(loss, quantile=0.3), reg, has_offset)


def refuse(*_):
    pytest.fail("it was asked")


@pytest.mark.parametrize("single_from", [1, 1000])
@pytest.mark.parametrize("has_offset", [True, False])
@pytest.mark.parametrize("loss", KINKED)
def test_interior_points_find_the_optimum_alone_in_either_precision(loss, has_offset, single_from, monkeypatch):
    monkeypatch.setattr(newton, "SINGLE_FROM", single_from)
    monkeypatch.setattr(solver, "_by_rounds", refuse)
    given = problem(loss, 1e-4, has_offset)
    found = solve(given)
    best, f = optimum(given.space.matrix, given.y, given.mass, loss, 1e-4, has_offset)
    assert found.objective == pytest.approx(best, rel=3e-8)
    assert found.relative_gap <= 1e-8
    np.testing.assert_allclose(given.space.matrix @ found.coefficients + found.offset, f, atol=1e-4)


@pytest.mark.parametrize("loss", KINKED)
@pytest.mark.parametrize("reg", [1e-4, 1e-6, 1e-8])
def test_interior_points_agree_with_the_rounds(loss, reg, monkeypatch):
    given = problem(loss, reg, num_rows=150, mass=np.random.default_rng(1).exponential(size=150) / 150)
    inside = solve(given)
    monkeypatch.setattr(solver, "_from_inside", lambda *_: None)
    by_rounds = solve(given)
    assert inside.relative_gap <= 1e-8
    # Pulls that cancel but for 1e-11 of their sum count as cancelling, so a gap is no more exact than that.
    slack = 1e-10 * by_rounds.objective
    assert inside.objective - by_rounds.objective <= inside.gap + slack
    assert by_rounds.objective - inside.objective <= by_rounds.gap + slack


def test_what_interior_points_leave_is_mended_by_rounds(monkeypatch):
    given = problem("epsilon-insensitive", 1e-4)
    monkeypatch.setattr(solver, "MOST_INTERIOR_STEPS", 3)
    found = solve(given)
    best, _ = optimum(given.space.matrix, given.y, given.mass, "epsilon-insensitive", 1e-4, True)
    assert found.objective == pytest.approx(best, rel=3e-8)
    assert found.relative_gap <= 1e-8


@pytest.mark.parametrize(
    ("loss", "reg"), [("absolute", 1e-1), ("hinge", 1e-6), ("huber", 1e-6), ("squared", 1e-6)], ids=lambda value: value
)
def test_where_few_rows_lie_on_a_kink_interior_points_are_not_asked(loss, reg, monkeypatch):
    monkeypatch.setattr(solver, "interior_points", refuse)
    given = problem(loss, reg)
    labelled = replace(given, y=np.sign(given.y - 0.05)) if loss == "hinge" else given
    assert solve(labelled).relative_gap <= 1e-8


def test_a_side_that_costs_nothing_is_left_to_the_rounds():
    found = solve(replace(problem("absolute", 1e-4), loss=PiecewiseLoss(up=1.0, down=0.0)))
    assert found.objective == pytest.approx(0.0, abs=1e-12)
