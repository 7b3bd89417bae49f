"""Interior points reach the optimum that cvxpy finds, and that the rounds find, where λ is small."""

import numpy as np
import pytest
from convex_oracle import optimum, tied_rows
from sklearn.metrics.pairwise import rbf_kernel

from halfseen.learning.svm import interior_point, solver
from halfseen.learning.svm.losses import DeadZone, named_loss
from halfseen.learning.svm.solver import Problem, solve
from halfseen.learning.svm.spaces import GramSpace

LOSSES = ("absolute", "pinball", "epsilon-insensitive")
EXACT = -1.0
"""No solution in single precision misses so little."""


def problem(loss, reg, has_offset=True, num_rows=60, mass=None):
    rows, y, _, _ = tied_rows(num_rows, seed=3)
    mass = np.full(num_rows, 1 / num_rows) if mass is None else mass
    return Problem(GramSpace(rbf_kernel(rows, gamma=0.3)), y, mass, named_loss(loss, quantile=0.3), reg, has_offset)


@pytest.fixture
def no_rounds(monkeypatch):
    def refuse(*_):
        raise AssertionError("it went on by rounds")

    monkeypatch.setattr(solver, "_solve_by_rounds", refuse)


@pytest.mark.usefixtures("no_rounds")
@pytest.mark.parametrize("single_misses", [interior_point.SINGLE_MISSES, EXACT])
@pytest.mark.parametrize("has_offset", [True, False])
@pytest.mark.parametrize("loss", LOSSES)
def test_the_optimum_is_the_one_that_cvxpy_finds(loss, has_offset, single_misses, monkeypatch):
    monkeypatch.setattr(interior_point, "SINGLE_MISSES", single_misses)
    given = problem(loss, 1e-4, has_offset)
    found = solve(given)
    best, f = optimum(given.space.gram, given.y, given.mass, loss, 1e-4, has_offset)
    assert found.objective == pytest.approx(best, rel=3e-8)
    assert found.relative_gap <= 1e-8
    np.testing.assert_allclose(given.space.values(found.coefficients) + found.offset, f, atol=1e-4)


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("reg", [1e-4, 1e-6, 1e-8])
def test_it_agrees_with_the_rounds(loss, reg, monkeypatch):
    given = problem(loss, reg, num_rows=150, mass=np.random.default_rng(1).exponential(size=150) / 150)
    inside = solve(given)
    monkeypatch.setattr(solver, "_solve_from_inside", lambda *_: None)
    by_rounds = solve(given)
    assert inside.relative_gap <= 1e-8
    # Pulls that cancel but for 1e-11 of their sum count as cancelling, so a gap is no more exact than that.
    slack = 1e-10 * by_rounds.objective
    assert inside.objective - by_rounds.objective <= inside.gap + slack
    assert by_rounds.objective - inside.objective <= by_rounds.gap + slack


def test_what_it_leaves_is_mended_by_rounds(monkeypatch):
    given = problem("epsilon-insensitive", 1e-4)
    monkeypatch.setattr(interior_point, "MAX_STEPS", 3)
    found = solve(given)
    best, _ = optimum(given.space.gram, given.y, given.mass, "epsilon-insensitive", 1e-4, True)
    assert found.objective == pytest.approx(best, rel=3e-8)
    assert found.relative_gap <= 1e-8


@pytest.mark.parametrize(
    ("loss", "reg"), [("absolute", 1e-1), ("hinge", 1e-6), ("huber", 1e-6), ("squared", 1e-6)], ids=lambda value: value
)
def test_where_few_rows_lie_on_a_kink_it_is_not_asked(loss, reg, monkeypatch):
    def refuse(*_):
        raise AssertionError("it began inside")

    monkeypatch.setattr(solver, "interior_points", refuse)
    given = problem(loss, reg)
    labelled = Problem(given.space, np.sign(given.y - 0.05), given.mass, given.loss, reg, True)
    assert solve(labelled if loss == "hinge" else given).relative_gap <= 1e-8


def test_a_side_that_costs_nothing_is_left_to_the_rounds():
    given = problem("absolute", 1e-4)
    found = solve(Problem(given.space, given.y, given.mass, DeadZone(up=1.0, down=0.0), 1e-4, True))
    assert found.objective == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("smallest", [1e-3, 1e-9])
def test_solves_are_those_of_the_system(smallest):
    # Rows that repeat: with a small ridge, single precision knows nothing of their differences.
    rows = np.repeat(np.random.default_rng(0).normal(size=(40, 3)), 2, axis=0)
    gram, ridge = rbf_kernel(rows, gamma=0.3), np.geomspace(smallest, 1e6, 80)
    right = np.column_stack([np.sin(np.arange(80)), np.ones(80)])
    solved = interior_point._solver(gram, ridge)(right)
    assert np.abs((gram + np.diag(ridge)) @ solved - right).max() < 1e-4


def test_single_precision_serves_where_it_can(monkeypatch):
    monkeypatch.setattr(interior_point, "_solver_in_double", lambda *_: pytest.fail("double precision was asked for"))
    gram = rbf_kernel(np.random.default_rng(0).normal(size=(80, 3)), gamma=0.3)
    right = np.ones((80, 1))
    solved = interior_point._solver(gram, np.full(80, 0.1))(right)
    np.testing.assert_allclose((gram + 0.1 * np.eye(80)) @ solved, right, atol=1e-9)
