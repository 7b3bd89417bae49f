"""Kernels between rows and between sets: their formulas, scikit-learn, and what is no kernel."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn import svm
from sklearn.metrics import pairwise

from halfseen.errors import ArgumentError
from halfseen.learning import CensoredSVR
from halfseen.learning.svm import kernels
from halfseen.learning.svm.kernels import (
    BLOCK_ENTRIES,
    SetKernel,
    as_sets,
    checked_gram,
    kernel_diagonal,
    named_kernel,
    row_blocks,
    scale_gamma,
)

REFERENCES = {
    "linear": (lambda x, z: pairwise.linear_kernel(x, z), lambda x, z: np.dot(x, z)),
    "rbf": (lambda x, z: pairwise.rbf_kernel(x, z, gamma=0.7), lambda x, z: np.exp(-0.7 * np.sum((x - z) ** 2))),
    "laplacian": (
        lambda x, z: pairwise.laplacian_kernel(x, z, gamma=0.7),
        lambda x, z: np.exp(-0.7 * np.sum(np.abs(x - z))),
    ),
    "polynomial": (
        lambda x, z: pairwise.polynomial_kernel(x, z, gamma=0.7, degree=4, coef0=0.5),
        lambda x, z: (0.7 * np.dot(x, z) + 0.5) ** 4,
    ),
}
NAMES = list(REFERENCES)


def kernel_of(name, gamma=0.7):
    return SetKernel("rbf", gamma) if name == "set" else named_kernel(name, gamma, degree=4, coef0=0.5)


def normal(num_rows, num_features=4, seed=0):
    return np.random.default_rng(seed).normal(size=(num_rows, num_features))


@pytest.mark.parametrize("name", NAMES)
def test_equals_scikit_learn_and_the_formula_and_leaves_its_arguments_alone(name):
    # More rows than one block holds.
    first, second = normal(700), normal(600, seed=1)
    assert len(list(row_blocks(700, 600))) > 1
    gram = kernel_of(name)(first, second)
    np.testing.assert_array_equal(first, normal(700))
    np.testing.assert_array_equal(second, normal(600, seed=1))
    theirs, formula = REFERENCES[name]
    np.testing.assert_allclose(gram, theirs(first, second), rtol=1e-12, atol=1e-14)
    naive = [[formula(x, z) for z in second[:5]] for x in first[:5]]
    np.testing.assert_allclose(gram[:5, :5], naive, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("name", NAMES)
def test_gram_of_rows_with_themselves_is_exactly_symmetric_and_agrees_with_the_diagonal(name):
    rows, kernel = normal(600), kernel_of(name)
    gram = kernel(rows, rows)
    assert (gram == gram.T).all()
    np.testing.assert_allclose(gram, kernel(rows, rows.copy()), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(kernel_diagonal(kernel, rows), np.diag(gram), rtol=1e-12)
    if name in ("rbf", "laplacian"):
        assert (np.diag(gram) == 1.0).all()
        assert gram.max() == 1.0
    assert kernel(np.empty((0, 3)), normal(2, 3)).shape == (0, 2)
    assert kernel(normal(2, 3), np.empty((0, 3))).shape == (2, 0)


@pytest.mark.parametrize("name", ["rbf", "laplacian"])
@pytest.mark.parametrize("shift", [0.0, 1e6])
@pytest.mark.parametrize("spread", [1.0, 1e5])
def test_distances_survive_an_offset_and_far_clusters(name, shift, spread):
    centres = np.array([0.0, spread, -2 * spread]).repeat(20)[:, None]
    rows = np.round((normal(60, 2) + centres) * 2**10) / 2**10 + shift
    gram = kernel_of(name)(rows, rows)
    naive = [[REFERENCES[name][1](x, z) for z in rows] for x in rows]
    np.testing.assert_allclose(gram, naive, rtol=0, atol=1e-9)
    assert (gram == gram.T).all()


@pytest.mark.parametrize("name", [*NAMES, "set"])
def test_kernels_of_one_name_and_width_are_equal_and_travel(name):
    kernel = kernel_of(name)
    assert kernel == kernel_of(name) == pickle.loads(pickle.dumps(kernel))
    assert kernel != kernel_of(name, 0.8)


NO_NUMBERS = [0.0, -1.0, np.nan, np.inf]
REFUSED = [
    ("gauss", {}, r"kernel 'gauss' is unknown.*linear, rbf, laplacian, polynomial.*'set'"),
    ("set", {"base": "gauss"}, "kernel 'gauss' is unknown"),
    ("set", {"pooling": "max"}, "pooling 'max' is unknown"),
    *((n, {"gamma": g}, "gamma is .* finite number > 0") for n in (*NAMES[1:], "set") for g in NO_NUMBERS),
    *(("polynomial", {"degree": degree}, "degree is") for degree in (*NO_NUMBERS, 1.5)),
    *(("polynomial", {"coef0": coef0}, "coef0 is") for coef0 in (-0.1, np.nan, np.inf)),
]


@pytest.mark.parametrize(("name", "parameters", "message"), REFUSED)
def test_what_is_no_kernel_is_refused(name, parameters, message):
    with pytest.raises(ArgumentError, match=message):
        SetKernel(**parameters) if name == "set" else named_kernel(name, **{"gamma": 1.0} | parameters)


def test_what_a_kernel_does_not_read_may_be_anything():
    assert named_kernel("linear", np.nan)
    assert named_kernel(pairwise.rbf_kernel, np.nan) is pairwise.rbf_kernel


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


def test_checked_gram_gives_float64_and_asks_no_symmetry_between_different_rows():
    rows, others = normal(600), normal(3, seed=1)
    gram = checked_gram(lambda x, z: (x @ z.T).astype(np.float32), rows, rows)
    assert gram.dtype == np.float64
    np.testing.assert_allclose(gram, rows @ rows.T, rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(checked_gram(lambda x, z: x @ z.T, rows[:3], others), rows[:3] @ others.T)


def test_scale_is_that_of_scikit_learn():
    rows = normal(50) * [1.0, 2.0, 3.0, 4.0] + 5.0
    assert scale_gamma(rows) == pytest.approx(svm.SVR(gamma="scale").fit(rows, rows[:, 0])._gamma, rel=1e-12)
    counts = np.arange(50) % 3
    assert scale_gamma(rows, counts.astype(float)) == pytest.approx(scale_gamma(rows.repeat(counts, axis=0)), rel=1e-12)


def test_scale_of_rows_that_do_not_vary_is_one_and_without_a_variance_it_is_refused():
    alike = [np.full(shape, value) for shape in ((5, 1), (1, 1)) for value in (0.0, 0.1, 1e9 / 3)]
    assert [scale_gamma(rows) for rows in (*alike, np.empty((3, 0)), np.empty((0, 0)))] == [1.0] * 8
    for value in (np.nan, np.inf, 1e300):
        with pytest.raises(ArgumentError, match="variance"):
            scale_gamma(np.array([[value], [1.0]]))


NUMBERS = st.lists(st.integers(0, 5), min_size=1, max_size=7)


def sets_of(counts, seed=0, num_features=3):
    rng = np.random.default_rng(seed)
    return [rng.normal(size=(count, num_features)) for count in counts]


def test_widths_of_sets_are_those_of_their_objects():
    sets = sets_of([2, 0, 3, 1] * 5)
    model = CensoredSVR("squared", kernel="set", gamma="cv", reg=1e-2, cv=2).fit(sets, np.arange(20.0))
    scale = scale_gamma(np.concatenate(sets))
    np.testing.assert_allclose(model.cv_gammas_, scale * np.array([1 / 16, 1 / 4, 1, 4, 16]))


def naive(base, first, second, pooling="mean"):
    gram = np.zeros((len(first), len(second)))
    for i, own in enumerate(first):
        for j, other in enumerate(second):
            values = [base(a[None], b[None])[0, 0] for a in own for b in other]
            gram[i, j] = sum(values) / (len(values) if pooling == "mean" and values else 1)
    return gram


@pytest.fixture(params=["one", "small"])
def blocks(request, monkeypatch):
    """Blocks that hold all pairs, or fewer than a set has, so that sets lie across their edges."""
    if request.param == "small":
        monkeypatch.setattr(kernels, "PAIRS_AT_ONCE", 30)


@pytest.mark.usefixtures("blocks")
@pytest.mark.parametrize("pooling", ["mean", "sum"])
@pytest.mark.parametrize("base", ["rbf", "laplacian", "linear", lambda x, z: 1.0 + x @ z.T])
def test_equals_the_double_loop(base, pooling):
    first, second = sets_of([3, 0, 1, 8, 2, 0, 1]), sets_of([0, 4, 7, 1], seed=1)
    kernel = SetKernel(base, gamma=0.4, pooling=pooling)
    one = named_kernel(base, 0.4)
    np.testing.assert_allclose(kernel(first, second), naive(one, first, second, pooling), rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(kernel(first, first), naive(one, first, first, pooling), rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(kernel_diagonal(kernel, as_sets(first)), np.diag(kernel(first, first)), rtol=1e-12)


@given(counts=NUMBERS, seed=st.integers(0, 99))
def test_symmetric_positive_semidefinite_bounded_and_of_no_order(counts, seed):
    sets, kernel = sets_of(counts, seed), SetKernel(gamma=0.5)
    gram = kernel(sets, sets)
    assert (gram == gram.T).all()
    assert np.linalg.eigvalsh(gram).min() >= -1e-12
    assert gram.min() >= 0.0
    assert gram.max() <= 1.0 + 1e-15
    rng = np.random.default_rng(seed)
    shuffled = [rng.permutation(objects) for objects in sets]
    np.testing.assert_allclose(kernel(shuffled, sets), gram, rtol=1e-12, atol=1e-15)


def test_sets_of_one_object_are_rows_and_the_mean_forgets_how_many():
    rows, other = normal(9, 3), normal(9, 3, seed=1)
    gram = SetKernel("rbf", 0.5)(rows[:, None], list(other[:, None]))
    np.testing.assert_allclose(gram, named_kernel("rbf", 0.5)(rows, other), rtol=1e-14)
    one, twice = np.ones((1, 2)), np.ones((2, 2))
    np.testing.assert_allclose(SetKernel()([one, twice], [one, twice]), np.ones((2, 2)))
    np.testing.assert_allclose(SetKernel(pooling="sum")([one, twice], [one, twice]), [[1, 2], [2, 4]])


def test_empty_sets_have_nothing_in_common():
    sets = [[], np.empty((0, 7)), np.ones((2, 3))]
    np.testing.assert_array_equal(SetKernel()(sets, sets) != 0, np.diag([False, False, True]))
    np.testing.assert_array_equal(SetKernel()(sets[:2], sets[:2]), np.zeros((2, 2)))
    assert SetKernel()([], sets).shape == (0, 3)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([np.ones((1, 2)), np.ones(2)], r"set in row 1 has shape \(2,\)"),
        ([np.ones((1, 2)), [], np.ones((1, 3))], "set in row 2: objects have 3 features, those of rows above 2"),
        ([np.ones((1, 2)), [[1.0, 2.0], [0.0, np.nan]]], "set in row 1, object 1, feature 1: nan"),
        ([[["a", "b"]]], "set in row 0 is not numeric"),
        ([[[1.0, 2.0], [3.0]]], "set in row 0 is not numeric"),
    ],
)
def test_what_is_no_set_is_named(rows, message):
    for call in (as_sets, lambda sets: SetKernel()(sets, sets)):
        with pytest.raises(ArgumentError, match=message):
            call(rows)


def test_sets_of_other_features_than_the_others_are_refused():
    with pytest.raises(ArgumentError, match="3 and 2 features"):
        SetKernel()(sets_of([1]), sets_of([1], num_features=2))
