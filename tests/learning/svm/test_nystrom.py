"""Low-rank features: what they leave of the kernel, which rows they are made of, and what is refused."""

import numpy as np
import pytest
from sklearn.kernel_approximation import Nystroem

from halfseen.errors import ArgumentError
from halfseen.learning.svm import nystrom
from halfseen.learning.svm.kernels import SetKernel, as_sets, named_kernel
from halfseen.learning.svm.nystrom import fit_nystrom

RBF = named_kernel("rbf", 0.5)


def generator(seed=0):
    return np.random.default_rng(seed)


def normal(num_rows, num_features=3, seed=0):
    return generator(seed).normal(size=(num_rows, num_features))


def where(landmarks, rows):
    """Which rows the landmarks are."""
    found = (landmarks[:, None] == rows).all(axis=2)
    assert (found.sum(axis=1) == 1).all()
    return found.argmax(axis=1)


def trace_error(model, rows):
    """Share of tr K that ΦΦᵀ leaves."""
    return 1.0 - np.sum(model.transform(rows) ** 2) / np.trace(model.kernel(rows, rows))


@pytest.mark.parametrize("name", ["rbf", "laplacian", "linear", "polynomial"])
@pytest.mark.parametrize("num_landmarks", [150, 1000])
def test_exact_with_all_rows_as_landmarks(name, num_landmarks):
    rows = normal(150)
    kernel = named_kernel(name, 0.5)
    model = fit_nystrom(kernel, rows, num_landmarks, generator())
    gram, features = kernel(rows, rows), model.transform(rows)
    np.testing.assert_allclose(features @ features.T, gram, rtol=0, atol=1e-9 * np.abs(gram).max())
    assert len(model.landmarks) <= 150
    if name == "linear":
        assert features.shape == (150, 3)
    unseen = normal(10, seed=1)
    np.testing.assert_allclose(
        model.transform(unseen) @ features.T, kernel(unseen, rows), rtol=0, atol=1e-4 if name == "rbf" else 10.0
    )


def test_features_are_those_of_scikit_learn_with_the_same_landmarks_and_leave_a_positive_semidefinite_rest():
    rows = normal(300)
    model = fit_nystrom(RBF, rows, 40, generator())
    theirs = Nystroem(kernel="rbf", gamma=0.5, n_components=40, random_state=0).fit(model.landmarks)
    ours, other = model.transform(rows), theirs.transform(rows)
    np.testing.assert_allclose(ours @ ours.T, other @ other.T, rtol=0, atol=1e-9)
    left = RBF(rows, rows) - ours @ ours.T
    assert np.linalg.eigvalsh(left).min() >= -1e-10
    assert 0.001 < np.trace(left) / 300 < 0.5
    np.testing.assert_allclose(left[where(model.landmarks, rows)], 0.0, atol=1e-9)


def test_more_landmarks_leave_less():
    rows = normal(500)
    shares = [trace_error(fit_nystrom(RBF, rows, count, generator()), rows) for count in (5, 20, 80, 320)]
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] < 0.01


def test_finds_the_rows_that_a_uniform_draw_misses():
    # Nearly equal rows, and some that stand far apart.
    few = 50.0 * np.arange(1, 21)[:, None] + np.zeros(3)
    rows = np.concatenate([generator().normal(scale=0.3, size=(2000, 3)), few])
    model = fit_nystrom(RBF, rows, 60, generator())
    assert np.isin(np.arange(2000, 2020), where(model.landmarks, rows)).all()
    uniform = generator().choice(len(rows), 60, replace=False)
    assert np.isin(np.arange(2000, 2020), uniform).sum() < 5
    assert trace_error(model, rows) < 0.2 * trace_error(fit_nystrom(RBF, rows[uniform], 60, generator()), rows)


@pytest.mark.slow
def test_drawn_in_proportion_to_the_residual():
    rows = normal(5, 5)
    gram = rows @ rows.T
    left = np.diag(gram) - gram**2 / np.diag(gram)[:, None]
    np.fill_diagonal(left, 0.0)
    first, second = np.diag(gram) / np.trace(gram), left / left.sum(axis=1, keepdims=True)
    draws, seen, rng = 2000, np.zeros((5, 5)), generator()
    for _ in range(draws):
        seen[tuple(where(fit_nystrom(named_kernel("linear", 1.0), rows, 2, rng).landmarks, rows))] += 1
    expected = draws * first[:, None] * second
    assert (np.diag(seen) == 0).all()
    is_pair = ~np.eye(5, dtype=bool)
    assert expected[is_pair].min() > 5
    statistic = np.sum((seen - expected)[is_pair] ** 2 / expected[is_pair])
    assert statistic < 43.8  # the 99.9 % quantile of χ² with 19 degrees of freedom


def test_equal_rows_are_one_landmark():
    rows = np.repeat(normal(7), 30, axis=0)
    model = fit_nystrom(RBF, rows, 100, generator())
    features = model.transform(rows)
    assert len(model.landmarks) == features.shape[1] == 7
    np.testing.assert_allclose(features @ features.T, RBF(rows, rows), rtol=0, atol=1e-12)


def test_of_many_rows_a_random_sample_is_looked_at(monkeypatch):
    monkeypatch.setattr(nystrom, "MOST_CANDIDATES", 400)
    rows = normal(3000)
    model = fit_nystrom(RBF, rows, 40, generator())
    assert where(model.landmarks, rows).max() > 400
    assert trace_error(model, rows) < 1.5 * trace_error(fit_nystrom(RBF, rows[:400], 40, generator()), rows)


def test_blocks_of_rows_change_nothing(monkeypatch):
    rows = normal(100)
    model = fit_nystrom(RBF, rows, 20, generator())
    whole = model.transform(rows)
    monkeypatch.setattr(nystrom, "FEATURES_AT_ONCE", 140)
    np.testing.assert_allclose(model.transform(rows), whole, rtol=1e-12, atol=1e-14)
    assert model.transform(rows[:0]).shape == (0, whole.shape[1])


def test_seed_decides_and_the_global_one_does_not():
    rows = normal(300)
    first, state = fit_nystrom(RBF, rows, 40, generator(1)).landmarks, np.random.get_state()[1].copy()  # noqa: NPY002
    np.testing.assert_array_equal(first, fit_nystrom(RBF, rows, 40, generator(1)).landmarks)
    np.testing.assert_array_equal(state, np.random.get_state()[1])  # noqa: NPY002
    assert set(where(first, rows)) != set(where(fit_nystrom(RBF, rows, 40, generator(2)).landmarks, rows))


def test_sets():
    rng, kernel = generator(), SetKernel("rbf", 0.3)
    sets = as_sets([rng.normal(size=(count, 3)) for count in rng.integers(0, 6, 120)])
    features = fit_nystrom(kernel, sets, 120, generator()).transform(sets)
    np.testing.assert_allclose(features @ features.T, kernel(sets, sets), rtol=0, atol=1e-10)
    model = fit_nystrom(kernel, sets, 20, generator())
    assert len(model.landmarks) == 20
    assert 0.0 < trace_error(model, sets) < 0.5


@pytest.mark.parametrize(
    ("kernel", "rows"), [(SetKernel(), as_sets([[], []])), (named_kernel("linear", 1.0), np.zeros((4, 2)))]
)
def test_a_kernel_of_zeros_has_no_features(kernel, rows):
    assert fit_nystrom(kernel, rows, 3, generator()).transform(rows).shape == (len(rows), 0)


def test_overflow_is_named():
    model = fit_nystrom(named_kernel("polynomial", 1.0, degree=9), normal(20), 5, generator())
    with (
        np.errstate(over="ignore", invalid="ignore"),
        pytest.raises(ArgumentError, match="row 1: its kernel with a landmark"),
    ):
        model.transform(np.array([[1.0, 1.0, 1.0], [1e60, 1.0, 1.0]]))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_landmarks": 0}, "num_landmarks is 0"),
        ({"kernel": lambda x, z: 1.0 + np.tanh(x @ z.T) * 3.0}, "give a positive semidefinite kernel"),
        ({"kernel": lambda x, z: x @ z.T + np.arange(len(z))}, "not symmetric"),
        ({"kernel": lambda x, z: np.full((len(x), len(z)), np.nan)}, "rows 0 and 0 is nan"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(ArgumentError, match=message):
        fit_nystrom(**{"kernel": RBF, "rows": normal(50), "num_landmarks": 30, "rng": generator(), **arguments})
