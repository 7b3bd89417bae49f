import numpy as np
import pandas as pd
import pytest
from scipy.optimize import linprog

from halfseen.censoring import Cox
from halfseen.errors import ArgumentError

TIME = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
Z = np.array([[0.3, 1.0], [0.1, -1.0], [0.9, 0.2], [0.2, 0.6], [0.4, -0.3], [0.6, 0.1]])


def test_refuses_fewer_cuts_than_covariates_unless_penalised():
    is_finished = np.array([False, True, True, True, True, True])
    with pytest.raises(ArgumentError, match="1 path was cut, too few for 2 covariates"):
        Cox().fit(TIME, is_finished, Z)
    assert np.isfinite(Cox(ridge=1.0).fit(TIME, is_finished, Z).coefficients_).all()


def test_refuses_collinear_covariates_by_name_unless_penalised():
    rng = np.random.default_rng(0)
    time, is_finished, x = rng.exponential(size=200), rng.random(200) < 0.5, rng.normal(size=(200, 3))
    table = pd.DataFrame({"a": x[:, 0], "b": x[:, 1], "c": x[:, 2], "sum": x[:, 0] + 2 * x[:, 1]})
    with pytest.raises(ArgumentError, match=r"covariates a, b, sum are collinear.*leave one out"):
        Cox().fit(time, is_finished, table)
    assert np.isfinite(Cox(ridge=1.0).fit(time, is_finished, table).coefficients_).all()


def test_refuses_a_covariate_that_varies_only_among_paths_long_gone():
    first_differs = np.column_stack([Z[:, 0], [1.0, 0, 0, 0, 0, 0]])
    with pytest.raises(ArgumentError, match="column 1: the same for all paths still watched, whenever one was cut"):
        Cox().fit(TIME, [True, True, False, True, False, False], first_differs)


def separated(kind):
    rng = np.random.default_rng(1)
    time, is_finished, x = rng.exponential(size=300), rng.random(300) < 0.5, rng.normal(size=300)
    if kind == "only one group is cut":
        return time, is_finished, np.column_stack([x, ~is_finished])
    if kind == "a rare group is never cut":
        rare = np.zeros(300)
        rare[np.flatnonzero(is_finished & (time > 0.5))[:3]] = 1.0
        return time, is_finished, np.column_stack([x, rare])
    return time, is_finished, np.column_stack([x, -time])


@pytest.mark.parametrize("kind", ["only one group is cut", "a rare group is never cut", "the next cut is foretold"])
@pytest.mark.parametrize("ties", ["efron", "breslow"])
def test_refuses_a_coefficient_without_end_unless_penalised(kind, ties):
    time, is_finished, covariates = separated(kind)
    with pytest.raises(ArgumentError, match=r"covariates, column 1: its coefficient runs off to infinity.*ridge > 0"):
        Cox(ties).fit(time, is_finished, covariates)
    assert np.isfinite(Cox(ties, ridge=1.0).fit(time, is_finished, covariates).coefficients_).all()


def is_separated(time, is_finished, covariates):
    """Whether some direction puts every cut path first among those watched, by linear programming."""
    leads = [
        covariates[i] - covariates[j]
        for i in np.flatnonzero(~is_finished)
        for j in range(len(time))
        if j != i and (time[j] > time[i] or (time[j] == time[i] and not is_finished[j]))
    ]
    if not leads:
        return False
    best = linprog(-np.sum(leads, axis=0), A_ub=-np.array(leads), b_ub=np.zeros(len(leads)), bounds=(-1, 1))
    return -best.fun > 1e-9


@pytest.mark.parametrize("ties", ["efron", "breslow"])
@pytest.mark.slow
def test_refuses_exactly_those_whose_likelihood_has_no_maximum(ties):
    rng = np.random.default_rng(0)
    found = {True: 0, False: 0}
    for _ in range(300):
        n, p = rng.integers(6, 20), rng.integers(1, 3)
        time, is_finished = rng.integers(1, 12, n).astype(float), rng.random(n) < 0.7
        covariates = rng.integers(0, 3, (n, p)).astype(float) if rng.random() < 0.5 else rng.normal(size=(n, p))
        try:
            Cox(ties).fit(time, is_finished, covariates)
            refused = False
        except ArgumentError as error:
            if "runs off to infinity" not in str(error):
                continue
            refused = True
        assert refused == is_separated(time, is_finished, covariates)
        found[refused] += 1
    assert min(found.values()) > 20
