import numpy as np
import pytest
from sklearn.kernel_approximation import Nystroem

from halfseen.errors import ArgumentError
from halfseen.learning.svm import nystrom
from halfseen.learning.svm.kernels import as_sets, named_kernel
from halfseen.learning.svm.nystrom import fit_nystrom

RBF = named_kernel("rbf", 0.5)


def generator(seed=0):
    return np.random.default_rng(seed)


def normal(num_rows, num_features=3, seed=0):
    return generator(seed).normal(size=(num_rows, num_features))


def crowd_and_few(num_crowd=2000, num_few=20, seed=0):
    """Nearly equal rows, and some that stand far apart, which a uniform draw misses."""
    rng = generator(seed)
    few = 50.0 * np.arange(1, num_few + 1)[:, None] + np.zeros(3)
    return np.concatenate([rng.normal(scale=0.3, size=(num_crowd, 3)), few])


def trace_error_share(model, rows):
    gram = model.kernel(rows, rows)
    return 1.0 - np.sum(model.transform(rows) ** 2) / np.trace(gram)


@pytest.mark.parametrize("name", ["rbf", "laplacian", "linear", "polynomial"])
@pytest.mark.parametrize("num_landmarks", [150, 1000])
def test_exact_with_all_rows_as_landmarks(name, num_landmarks):
    rows = normal(150)
    kernel = named_kernel(name, 0.5)
    model = fit_nystrom(kernel, rows, num_landmarks, generator())
    gram, features = kernel(rows, rows), model.transform(rows)
    np.testing.assert_allclose(features @ features.T, gram, rtol=0, atol=1e-9 * np.abs(gram).max())
    assert model.trace_error_share == pytest.approx(0.0, abs=1e-10)
    assert len(model.landmarks) <= 150
    if name == "linear":
        assert model.num_features == 3
    unseen = normal(10, seed=1)
    np.testing.assert_allclose(
        model.transform(unseen) @ features.T, kernel(unseen, rows), rtol=0, atol=1e-4 if name == "rbf" else 10.0
    )


def test_features_are_those_of_scikit_learn_with_the_same_landmarks():
    rows = normal(300)
    model = fit_nystrom(RBF, rows, 40, generator())
    theirs = Nystroem(kernel="rbf", gamma=0.5, n_components=40, random_state=0).fit(model.landmarks)
    ours, other = model.transform(rows), theirs.transform(rows)
    np.testing.assert_allclose(ours @ ours.T, other @ other.T, rtol=0, atol=1e-9)


def test_what_is_left_is_positive_semidefinite_and_its_trace_is_told():
    rows = normal(300)
    model = fit_nystrom(RBF, rows, 40, generator())
    features = model.transform(rows)
    left = RBF(rows, rows) - features @ features.T
    assert np.linalg.eigvalsh(left).min() >= -1e-10
    assert model.trace_error_share == pytest.approx(np.trace(left) / 300, rel=1e-8)
    assert 0.001 < model.trace_error_share < 0.5
    np.testing.assert_allclose(left[model.landmark_rows], 0.0, atol=1e-9)


def test_more_landmarks_leave_less():
    rows = normal(500)
    shares = [fit_nystrom(RBF, rows, count, generator()).trace_error_share for count in (5, 20, 80, 320)]
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] < 0.01


def test_finds_the_rows_that_a_uniform_draw_misses():
    rows = crowd_and_few()
    model = fit_nystrom(RBF, rows, 60, generator())
    assert np.isin(np.arange(2000, 2020), model.landmark_rows).all()
    uniform = generator().choice(len(rows), 60, replace=False)
    theirs = fit_nystrom(RBF, rows[uniform], 60, generator())
    assert np.isin(np.arange(2000, 2020), uniform).sum() < 5
    assert model.trace_error_share < 0.2 * trace_error_share(theirs, rows)


@pytest.mark.slow
def test_drawn_in_proportion_to_the_residual():
    rows = normal(5, 5)
    gram = rows @ rows.T
    left = np.diag(gram) - gram**2 / np.diag(gram)[:, None]
    np.fill_diagonal(left, 0.0)
    first, second = np.diag(gram) / np.trace(gram), left / left.sum(axis=1, keepdims=True)
    draws, seen, rng = 2000, np.zeros((5, 5)), generator()
    for _ in range(draws):
        seen[tuple(fit_nystrom(named_kernel("linear", 1.0), rows, 2, rng).landmark_rows)] += 1
    expected = draws * first[:, None] * second
    assert (np.diag(seen) == 0).all()
    is_pair = ~np.eye(5, dtype=bool)
    assert expected[is_pair].min() > 5
    statistic = np.sum((seen - expected)[is_pair] ** 2 / expected[is_pair])
    assert statistic < 43.8  # the 99.9 % quantile of χ² with 19 degrees of freedom


def test_rows_without_weight_are_no_landmarks():
    rows = normal(200)
    weights = np.where(np.arange(200) % 3 == 0, 2.0, 0.0)
    model = fit_nystrom(RBF, rows, 50, generator(), weights)
    assert (weights[model.landmark_rows] > 0).all()
    assert model.trace_error_share == pytest.approx(trace_error_share(model, rows[weights > 0]), rel=1e-8)
    np.testing.assert_array_equal(model.landmarks, rows[model.landmark_rows])


def test_equal_rows_are_one_landmark():
    rows = np.repeat(normal(7), 30, axis=0)
    model = fit_nystrom(RBF, rows, 100, generator())
    assert len(model.landmarks) == model.num_features == 7
    features = model.transform(rows)
    np.testing.assert_allclose(features @ features.T, RBF(rows, rows), rtol=0, atol=1e-12)


def test_error_of_rows_beyond_the_candidates_is_estimated(monkeypatch):
    monkeypatch.setattr(nystrom, "MOST_CANDIDATES", 400)
    monkeypatch.setattr(nystrom, "FRESH_ROWS", 500)
    rows = normal(3000)
    model = fit_nystrom(RBF, rows, 40, generator())
    assert model.trace_error_share == pytest.approx(trace_error_share(model, rows), rel=0.1)
    assert model.landmark_rows.max() > 400
    np.testing.assert_array_equal(model.landmarks, rows[model.landmark_rows])


def test_blocks_of_rows_change_nothing(monkeypatch):
    rows = normal(100)
    model = fit_nystrom(RBF, rows, 20, generator())
    whole = model.transform(rows)
    monkeypatch.setattr(nystrom, "FEATURES_AT_ONCE", 140)
    np.testing.assert_allclose(model.transform(rows), whole, rtol=1e-12, atol=1e-14)
    assert model.transform(rows[:0]).shape == (0, model.num_features)


def test_seed_decides_and_the_global_one_does_not():
    rows = normal(300)
    first = fit_nystrom(RBF, rows, 40, generator(1)).landmark_rows
    state = np.random.get_state()  # noqa: NPY002
    np.testing.assert_array_equal(first, fit_nystrom(RBF, rows, 40, generator(1)).landmark_rows)
    np.testing.assert_array_equal(state[1], np.random.get_state()[1])  # noqa: NPY002
    assert set(first) != set(fit_nystrom(RBF, rows, 40, generator(2)).landmark_rows)


def test_sets():
    rng = generator()
    sets = [rng.normal(size=(count, 3)) for count in rng.integers(0, 6, 120)]
    kernel = named_kernel("set", 0.3)
    exact = fit_nystrom(kernel, sets, 120, generator())
    features = exact.transform(sets)
    np.testing.assert_allclose(features @ features.T, kernel(sets, sets), rtol=0, atol=1e-10)
    model = fit_nystrom(kernel, as_sets(sets), 20, generator())
    assert [len(objects) for objects in model.landmarks] == [len(sets[row]) for row in model.landmark_rows]
    assert model.trace_error_share == pytest.approx(trace_error_share(model, sets), rel=1e-8)


def test_a_kernel_of_zeros_has_no_features():
    for kernel, rows in [(named_kernel("set", 1.0), [[], []]), (named_kernel("linear", 1.0), np.zeros((4, 2)))]:
        model = fit_nystrom(kernel, rows, 3, generator())
        assert model.transform(rows).shape == (len(rows), 0)
        assert model.trace_error_share == 0.0


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
        ({"weights": np.zeros(50)}, "none of 50 rows has a positive weight"),
        ({"kernel": lambda x, z: 1.0 + np.tanh(x @ z.T) * 3.0}, "give a positive semidefinite kernel"),
        ({"kernel": lambda x, z: x @ z.T + np.arange(len(z))}, "not symmetric"),
        ({"kernel": lambda x, z: np.full((len(x), len(z)), np.nan)}, "rows 0 and 0 is nan"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(ArgumentError, match=message):
        fit_nystrom(**{"kernel": RBF, "rows": normal(50), "num_landmarks": 30, "rng": generator(), **arguments})


@pytest.mark.slow
def test_a_hundred_thousand_rows():
    rows = normal(100_000, 10)
    kernel = named_kernel("rbf", 0.1)
    model = fit_nystrom(kernel, rows, 500, generator())
    share = 1.0 - np.mean(np.square(model.transform(rows)).sum(axis=1))
    assert model.trace_error_share == pytest.approx(share, rel=0.03)
