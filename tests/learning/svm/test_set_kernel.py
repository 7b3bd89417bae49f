import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from halfseen.errors import ArgumentError
from halfseen.learning.svm import kernels
from halfseen.learning.svm.kernels import SetKernel, all_objects, as_sets, kernel_diagonal, named_kernel, vector_kernel

NUMBERS = st.lists(st.integers(0, 5), min_size=1, max_size=7)


def sets_of(counts, seed=0, num_features=3):
    rng = np.random.default_rng(seed)
    return [rng.normal(size=(count, num_features)) for count in counts]


def naive(base, first, second, pooling="mean"):
    gram = np.zeros((len(first), len(second)))
    for i, own in enumerate(first):
        for j, other in enumerate(second):
            values = [base(a[None], b[None])[0, 0] for a in own for b in other]
            gram[i, j] = sum(values) / (len(values) if pooling == "mean" and values else 1)
    return gram


@pytest.fixture
def small_blocks(monkeypatch):
    """Blocks smaller than sets, so that sets lie across their edges."""
    monkeypatch.setattr(kernels, "OBJECTS_AT_ONCE", 3)


@pytest.mark.parametrize("blocks", ["one", "small"])
@pytest.mark.parametrize("pooling", ["mean", "sum"])
@pytest.mark.parametrize("base", ["rbf", "laplacian", "linear", lambda x, z: 1.0 + x @ z.T])
def test_equals_the_double_loop(base, pooling, blocks, monkeypatch):
    if blocks == "small":
        monkeypatch.setattr(kernels, "OBJECTS_AT_ONCE", 3)
    first, second = sets_of([3, 0, 1, 8, 2, 0, 1]), sets_of([0, 4, 7, 1], seed=1)
    kernel = SetKernel(base, gamma=0.4, pooling=pooling)
    one = vector_kernel(base, 0.4)
    np.testing.assert_allclose(kernel(first, second), naive(one, first, second, pooling), rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(kernel(first, first), naive(one, first, first, pooling), rtol=1e-12, atol=1e-13)


@pytest.mark.usefixtures("small_blocks")
@given(counts=NUMBERS, seed=st.integers(0, 99))
def test_symmetric_positive_semidefinite_and_bounded(counts, seed):
    sets = sets_of(counts, seed)
    gram = named_kernel("set", 0.5)(sets, sets)
    assert (gram == gram.T).all()
    assert np.linalg.eigvalsh(gram).min() >= -1e-12
    assert gram.min() >= 0.0
    assert gram.max() <= 1.0 + 1e-15


@given(counts=NUMBERS, seed=st.integers(0, 99))
def test_order_of_objects_is_irrelevant(counts, seed):
    sets = sets_of(counts, seed)
    rng = np.random.default_rng(seed)
    shuffled = [rng.permutation(objects) for objects in sets]
    kernel = SetKernel(gamma=0.5)
    np.testing.assert_allclose(kernel(sets, sets), kernel(shuffled, sets), rtol=1e-12, atol=1e-15)


def test_sets_of_one_object_are_rows():
    rows, other = (np.random.default_rng(seed).normal(size=(9, 3)) for seed in (0, 1))
    gram = SetKernel("rbf", 0.5)(rows[:, None], list(other[:, None]))
    np.testing.assert_allclose(gram, vector_kernel("rbf", 0.5)(rows, other), rtol=1e-14)


def test_mean_forgets_how_many_and_sum_counts_them():
    one, twice = np.ones((1, 2)), np.ones((2, 2))
    np.testing.assert_allclose(SetKernel()([one, twice], [one, twice]), np.ones((2, 2)))
    np.testing.assert_allclose(SetKernel(pooling="sum")([one, twice], [one, twice]), [[1, 2], [2, 4]])


def test_empty_sets_have_nothing_in_common():
    sets = [[], np.empty((0, 7)), np.ones((2, 3))]
    np.testing.assert_array_equal(SetKernel()(sets, sets) != 0, np.diag([False, False, True]))
    np.testing.assert_array_equal(SetKernel()(sets[:2], sets[:2]), np.zeros((2, 2)))
    assert SetKernel()([], sets).shape == (0, 3)


def test_diagonal_is_that_of_the_gram_matrix():
    sets = as_sets(sets_of([3, 0, 1, 5] * 20))
    kernel = SetKernel(gamma=0.3)
    np.testing.assert_allclose(kernel_diagonal(kernel, sets), np.diag(kernel(sets, sets)), rtol=1e-12)


def test_as_sets_is_indexed_like_an_array():
    sets = as_sets(sets_of([2, 0, 3]))
    assert [len(objects) for objects in sets[[2, 0]]] == [3, 2]
    assert as_sets(np.zeros((4, 2, 3))).shape == (4,)
    assert all(objects.dtype == np.float64 for objects in as_sets([[[1, 2]], [[3, 4]]]))
    assert all_objects(sets).shape == (5, 3)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([np.ones((1, 2)), np.ones(2)], r"set in row 1 has shape \(2,\)"),
        ([np.ones((1, 2)), [], np.ones((1, 3))], "set in row 2: objects have 3 features, those of rows above 2"),
        ([np.ones((1, 2)), [[1.0, 2.0], [0.0, np.nan]]], "set in row 1, object 1, feature 1: nan"),
        ([[["a", "b"]]], "set in row 0 is not made of numbers"),
        ([[[1.0, 2.0], [3.0]]], "set in row 0 is not made of numbers"),
    ],
)
def test_what_is_no_set_is_named(rows, message):
    with pytest.raises(ArgumentError, match=message):
        as_sets(rows)
    with pytest.raises(ArgumentError, match=message):
        SetKernel()(rows, rows)


def test_sets_of_different_features_are_refused():
    with pytest.raises(ArgumentError, match="3 and 2 features"):
        SetKernel()(sets_of([1]), sets_of([1], num_features=2))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"base": "gauss"}, "kernel 'gauss' is unknown"),
        ({"gamma": 0.0}, "gamma is 0.0"),
        ({"base": "polynomial", "coef0": -1.0}, "coef0 is -1.0"),
    ],
)
def test_parameters_are_checked_when_made(arguments, message):
    with pytest.raises(ArgumentError, match=message):
        SetKernel(**arguments)
