"""Targets, weights, rows and λ of any size: a small gap, and no warning where there is nothing to warn of."""

from dataclasses import replace

import numpy as np
import pytest
from convex_oracle import CLASSIFICATION, REGRESSION, optimum, tied_rows
from sklearn.metrics.pairwise import rbf_kernel

from halfseen.errors import HalfseenWarning
from halfseen.learning import CensoredSVC, CensoredSVR
from halfseen.learning.svm import interior_point, newton, solver
from halfseen.learning.svm.losses import PiecewiseLoss, named_loss
from halfseen.learning.svm.newton import Features, Gram, Point
from halfseen.learning.svm.solver import Problem, certify, solve

ROWS, Y, LABELS, _ = tied_rows(60)


def assert_certified(model):
    assert model.duality_gap_ <= max(1e-8 * model.objective_, 1e-14)


@pytest.mark.parametrize("loss", REGRESSION)
@pytest.mark.parametrize("reg", [1e-3, "cv"])
@pytest.mark.parametrize("constant", [0.0, 3.0, 0.1, -1e9])
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


@pytest.mark.parametrize("loss", [*REGRESSION, *CLASSIFICATION])
@pytest.mark.parametrize("reg", [1e6, 1e-6])
def test_reg_of_any_size(loss, reg):
    is_label = loss in CLASSIFICATION
    model = CensoredSVC(loss, reg=reg, calibrate=False) if is_label else CensoredSVR(loss, reg=reg)
    assert_certified(model.fit(ROWS, LABELS if is_label else Y))


@pytest.mark.parametrize("loss", REGRESSION)
@pytest.mark.parametrize("weights", [np.where(np.arange(60) % 7, 1.0, 1e6), np.logspace(-6, 6, 60), np.full(60, 1e6)])
def test_weights_of_any_size(loss, weights):
    assert_certified(CensoredSVR(loss, reg=1e-3).fit(ROWS, Y, sample_weight=weights))


@pytest.mark.parametrize("loss", REGRESSION)
def test_rows_that_repeat(loss):
    assert_certified(CensoredSVR(loss, reg=1e-3).fit(np.repeat(ROWS[:6], 10, axis=0), Y))
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
    monkeypatch.setattr(interior_point, "MAX_STEPS", 3)
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


@pytest.mark.parametrize("ridge", [0.1, 1e-9])
def test_single_precision_serves_where_it_can_and_double_elsewhere(ridge, monkeypatch):
    monkeypatch.setattr(newton, "SINGLE_FROM", 1)
    gram, right = rbf_kernel(np.random.default_rng(0).normal(size=(80, 3)), gamma=0.3), np.ones(80)
    if ridge == 0.1:
        monkeypatch.setattr(newton, "factored", refuse)
    solved = newton._solver(gram, np.full(80, ridge))(right)
    np.testing.assert_allclose((gram + ridge * np.eye(80)) @ solved, right, atol=1e-6)
