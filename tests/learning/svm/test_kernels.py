"""Kernels between rows and between sets: their formulas, scikit-learn, and what is no kernel."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sklearn import svm
from sklearn.metrics import pairwise

from halfseen.errors import ArgumentError
from halfseen.learning.svm import kernels
from halfseen.learning.svm.kernels import (
    BLOCK_ENTRIES,
    KERNEL_NAMES,
    VECTOR_KERNELS,
    SetKernel,
    all_objects,
    as_sets,
    candidate_gammas,
    checked_gram,
    kernel_diagonal,
    named_kernel,
    row_blocks,
    scale_gamma,
    vector_kernel,
)

REFERENCES = {
    "linear": lambda x, z: pairwise.linear_kernel(x, z),
    "rbf": lambda x, z: pairwise.rbf_kernel(x, z, gamma=0.7),
    "laplacian": lambda x, z: pairwise.laplacian_kernel(x, z, gamma=0.7),
    "polynomial": lambda x, z: pairwise.polynomial_kernel(x, z, gamma=0.7, degree=4, coef0=0.5),
}
FORMULAS = {
    "linear": lambda x, z: np.dot(x, z),
    "rbf": lambda x, z: np.exp(-0.7 * np.sum((x - z) ** 2)),
    "laplacian": lambda x, z: np.exp(-0.7 * np.sum(np.abs(x - z))),
    "polynomial": lambda x, z: (0.7 * np.dot(x, z) + 0.5) ** 4,
}
ROWS = arrays(np.float64, st.tuples(st.integers(1, 8), st.just(3)), elements=st.floats(-3, 3))


def kernel_of(name):
    return named_kernel(name, 0.7, degree=4, coef0=0.5)


def normal(num_rows, num_features=4, seed=0):
    return np.random.default_rng(seed).normal(size=(num_rows, num_features))


@pytest.mark.parametrize("name", VECTOR_KERNELS)
def test_equals_scikit_learn_and_the_formula(name):
    # More rows than one block holds.
    first, second = normal(700), normal(600, seed=1)
    assert len(list(row_blocks(700, 600))) > 1
    gram = kernel_of(name)(first, second)
    np.testing.assert_allclose(gram, REFERENCES[name](first, second), rtol=1e-12, atol=1e-14)
    naive = [[FORMULAS[name](x, z) for z in second[:5]] for x in first[:5]]
    np.testing.assert_allclose(gram[:5, :5], naive, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("name", VECTOR_KERNELS)
def test_gram_of_rows_with_themselves_is_exactly_symmetric_and_agrees_with_the_diagonal(name):
    rows = normal(600)
    gram = kernel_of(name)(rows, rows)
    assert (gram == gram.T).all()
    np.testing.assert_allclose(gram, kernel_of(name)(rows, rows.copy()), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(kernel_diagonal(kernel_of(name), rows), np.diag(gram), rtol=1e-12)
    if name in ("rbf", "laplacian"):
        assert (np.diag(gram) == 1.0).all()
        assert gram.max() == 1.0


@pytest.mark.parametrize("name", VECTOR_KERNELS)
@given(rows=ROWS)
def test_gram_is_positive_semidefinite(name, rows):
    eigenvalues = np.linalg.eigvalsh(kernel_of(name)(rows, rows))
    assert eigenvalues.min() >= -1e-12 * max(eigenvalues.max(), 1.0)


@pytest.mark.parametrize("name", ["rbf", "laplacian"])
@pytest.mark.parametrize("shift", [0.0, 1e6])
@pytest.mark.parametrize("spread", [1.0, 1e5])
def test_distances_survive_an_offset_and_far_clusters(name, shift, spread):
    centres = np.array([0.0, spread, -2 * spread]).repeat(20)[:, None]
    rows = np.round((normal(60, 2) + centres) * 2**10) / 2**10 + shift
    gram = kernel_of(name)(rows, rows)
    naive = [[FORMULAS[name](x, z) for z in rows] for x in rows]
    np.testing.assert_allclose(gram, naive, rtol=0, atol=1e-9)
    assert (gram == gram.T).all()


def test_no_rows_are_legal():
    for name in VECTOR_KERNELS:
        assert kernel_of(name)(np.empty((0, 3)), normal(2, 3)).shape == (0, 2)
        assert kernel_of(name)(normal(2, 3), np.empty((0, 3))).shape == (2, 0)


def test_arguments_are_left_alone():
    for name in VECTOR_KERNELS:
        first, second = normal(5), normal(4, seed=1)
        kernel_of(name)(first, second)
        np.testing.assert_array_equal(first, normal(5))
        np.testing.assert_array_equal(second, normal(4, seed=1))


@pytest.mark.parametrize("name", KERNEL_NAMES)
def test_kernels_of_one_name_and_width_are_equal_and_travel(name):
    kernel = kernel_of(name)
    assert kernel == kernel_of(name)
    assert pickle.loads(pickle.dumps(kernel)) == kernel
    if name != "linear":
        assert kernel != named_kernel(name, 0.8, degree=4, coef0=0.5)


NO_NUMBERS = [0.0, -1.0, np.nan, np.inf]
REFUSED = [
    ("gauss", {}, r"kernel 'gauss' is unknown.*linear, rbf, laplacian, polynomial, set"),
    *((n, {"gamma": g}, "gamma is .* finite number > 0") for n in KERNEL_NAMES if n != "linear" for g in NO_NUMBERS),
    *(("polynomial", {"degree": degree}, "degree is") for degree in (*NO_NUMBERS, 1.5)),
    *(("polynomial", {"coef0": coef0}, "coef0 is") for coef0 in (-0.1, np.nan, np.inf)),
]


@pytest.mark.parametrize(("name", "parameters", "message"), REFUSED)
def test_what_is_no_kernel_is_refused(name, parameters, message):
    with pytest.raises(ArgumentError, match=message):
        named_kernel(name, **{"gamma": 1.0} | parameters)


def test_what_a_kernel_does_not_read_may_be_anything():
    assert named_kernel("linear", np.nan)
    assert named_kernel(pairwise.rbf_kernel, np.nan) is pairwise.rbf_kernel


def test_checked_gram_gives_float64():
    rows = normal(600)
    gram = checked_gram(lambda x, z: (x @ z.T).astype(np.float32), rows, rows)
    assert gram.dtype == np.float64
    np.testing.assert_allclose(gram, rows @ rows.T, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    ("kernel", "message"),
    [
        (lambda x, z: x @ z.T + np.arange(len(z)), r"not symmetric: k\(row 0, row 1\)"),
        (lambda x, z: (x @ z.T)[:, :-1], r"shape \(600, 599\) for 600 and 600 rows"),
        (lambda x, z: -(x @ z.T), "with itself is -"),
        (
            lambda x, z: np.where(np.add.outer(10 * np.arange(600), np.arange(600)) == 5997, np.nan, 0),
            "rows 540 and 597 is nan",
        ),
        (lambda x, z: np.full((len(x), len(z)), np.inf), "rows 0 and 0 is inf"),
        (lambda x, z: np.dot(x, z), "cannot be computed on 600 and 600 rows"),
        (lambda x, z: None, "rows 0 and 0|shape|cannot be computed"),
    ],
)
def test_what_is_no_gram_matrix_is_refused(kernel, message):
    rows = normal(600)
    assert rows.shape[0] ** 2 > BLOCK_ENTRIES
    with pytest.raises(ArgumentError, match=message):
        checked_gram(kernel, rows, rows)


def test_asymmetry_is_no_matter_between_different_rows():
    first, second = normal(3), normal(3, seed=1)
    np.testing.assert_array_equal(checked_gram(lambda x, z: x @ z.T, first, second), first @ second.T)


def test_diagonal_of_a_callable_without_one():
    rows = normal(100)
    np.testing.assert_allclose(kernel_diagonal(lambda x, z: x @ z.T, rows), np.sum(rows**2, axis=1), rtol=1e-12)


def test_scale_is_that_of_scikit_learn():
    rows = normal(50) * [1.0, 2.0, 3.0, 4.0] + 5.0
    assert scale_gamma(rows) == pytest.approx(svm.SVR(gamma="scale").fit(rows, rows[:, 0])._gamma, rel=1e-12)


@pytest.mark.parametrize("value", [0.0, 0.1, 1e9 / 3])
def test_scale_of_rows_that_do_not_vary_is_one(value):
    assert scale_gamma(np.full((5, 1), value)) == 1.0
    assert scale_gamma(np.full((1, 1), value)) == 1.0
    assert scale_gamma(np.empty((3, 0))) == 1.0


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_scale_of_rows_without_a_variance_is_refused(value):
    with pytest.raises(ArgumentError, match="variance"):
        scale_gamma(np.array([[value], [1.0]]))


def test_scale_and_candidates_of_sets_are_those_of_their_objects():
    objects = normal(9)
    sets = [objects[:2], np.empty((0, 4)), objects[2:]]
    assert scale_gamma(sets) == scale_gamma(objects)
    assert scale_gamma([[], []]) == 1.0
    np.testing.assert_allclose(candidate_gammas(sets), scale_gamma(objects) * np.array([1 / 16, 1 / 4, 1, 4, 16]))


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
