"""Solves by the factor of a set near by are those of the set itself."""

import numpy as np
import pytest

from halfseen.learning.svm import edited_factor
from halfseen.learning.svm.edited_factor import EditedFactor

NUM_ROWS = 60


@pytest.fixture(autouse=True)
def small_sets_count(monkeypatch):
    monkeypatch.setattr(edited_factor, "FEWEST_ROWS", 1)


@pytest.fixture
def gram():
    rows = np.random.default_rng(0).normal(size=(NUM_ROWS, 3))
    return np.exp(-0.3 * ((rows[:, None] - rows) ** 2).sum(axis=-1))


@pytest.fixture
def factored_sizes(monkeypatch):
    sizes, usual = [], edited_factor.factored
    monkeypatch.setattr(edited_factor, "factored", lambda system: sizes.append(len(system)) or usual(system))
    return sizes


def check(factor, gram, rows, ridge, right=None):
    right = np.column_stack([np.sin(rows), np.ones(len(rows))]) if right is None else right
    wanted = np.linalg.solve(gram[np.ix_(rows, rows)] + np.diag(ridge[rows]), right)
    np.testing.assert_allclose(factor.solve(rows, ridge[rows], right), wanted, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("ridge", [1e-6, 0.1, 30.0])
def test_rows_join_leave_and_come_back_without_another_factor(gram, factored_sizes, ridge):
    factor, ridges = EditedFactor(gram), np.full(NUM_ROWS, ridge)
    base = np.arange(0, 50)
    sets = [
        base,
        np.arange(0, 53),  # three join
        np.arange(4, 53),  # four leave
        np.arange(2, 52),  # two come back, one that joined leaves
        np.union1d(base[5:], [54, 57]),
        base,
        base,
    ]
    for rows in sets:
        check(factor, gram, rows, ridges)
    assert factored_sizes == [50]


def test_each_row_has_its_own_ridge(gram, factored_sizes):
    factor, ridge = EditedFactor(gram), np.linspace(0.1, 2.0, NUM_ROWS)
    for rows in (np.arange(0, 50), np.arange(3, 52)):
        check(factor, gram, rows, ridge)
    assert factored_sizes == [50]


def test_another_ridge_or_a_set_far_away_takes_another_factor(gram, factored_sizes):
    factor = EditedFactor(gram)
    check(factor, gram, np.arange(0, 40), np.full(NUM_ROWS, 0.1))
    check(factor, gram, np.arange(0, 41), np.full(NUM_ROWS, 0.2))
    check(factor, gram, np.arange(20, 60), np.full(NUM_ROWS, 0.2))
    assert factored_sizes == [40, 41, 40]


def test_what_is_held_does_not_grow_without_end(gram, factored_sizes, monkeypatch):
    monkeypatch.setattr(edited_factor, "MOST_KNOWN", 0.1)
    factor, ridge = EditedFactor(gram), np.full(NUM_ROWS, 0.1)
    for rows in (np.arange(0, 40), np.arange(3, 40), np.r_[0:36, 37:40], np.r_[0:34, 35:40]):
        check(factor, gram, rows, ridge)
    assert factored_sizes == [40, 39]


def test_where_it_is_not_exact_the_set_itself_is_factored(gram, factored_sizes, monkeypatch):
    monkeypatch.setattr(edited_factor, "SMALL_RESIDUAL", -1.0)
    factor, ridge = EditedFactor(gram), np.full(NUM_ROWS, 0.1)
    for rows in (np.arange(0, 50), np.arange(0, 51)):
        check(factor, gram, rows, ridge)
    assert factored_sizes == [50, 51]


def test_a_direction_that_nothing_sees_gets_the_same_jitter_near_by():
    gram, ridge = np.ones((NUM_ROWS, NUM_ROWS)), np.full(NUM_ROWS, 1e-300)
    factor = EditedFactor(gram)
    for rows in (np.arange(0, 50), np.arange(1, 51)):
        solved = factor.solve(rows, ridge[rows], np.ones((len(rows), 1)))
        np.testing.assert_allclose(gram[np.ix_(rows, rows)] @ solved, 1.0, rtol=1e-6)


def test_the_gram_matrix_and_the_right_side_stay_as_they_were(gram):
    kept, right = gram.copy(), np.ones((50, 2))
    factor = EditedFactor(gram)
    for rows in (np.arange(0, 50), np.arange(2, 52)):
        factor.solve(rows, np.full(50, 0.1), right)
    assert (gram == kept).all()
    assert (right == 1.0).all()
