"""The same input gives the same fit, in any order, whatever the global seed."""

import numpy as np
import pytest
from convex_oracle import cut_log

from halfseen.learning import CensoredSVC, CensoredSVR, survival_array

X, TIME, IS_FINISHED = cut_log(60)
Y = survival_array(TIME, IS_FINISHED)
MODELS = [
    CensoredSVR(cv=2),
    CensoredSVR("absolute", reg=1e-3, num_landmarks=10),
    CensoredSVC(tau=1.0, reg=1e-2, cv=3),
]


@pytest.mark.parametrize("model", MODELS)
def test_same_seed_same_bytes_and_the_global_seed_neither_counts_nor_changes(model):
    results = set()
    for seed in (1, 2):
        np.random.seed(seed)  # noqa: NPY002
        state = np.random.get_state()[1].tobytes()  # noqa: NPY002
        results.add(model.fit(X, Y).predict(X).tobytes())
        assert np.random.get_state()[1].tobytes() == state  # noqa: NPY002
    assert len(results) == 1


def test_another_seed_draws_other_landmarks():
    first, other = (CensoredSVR(reg=1e-3, num_landmarks=5, random_state=seed).fit(X, Y).predict(X) for seed in (0, 1))
    assert (first != other).any()


@pytest.mark.parametrize("loss", ["squared", "absolute", "epsilon-insensitive"])
def test_the_order_of_rows_does_not_matter(loss):
    order = np.random.default_rng(3).permutation(len(X))
    model = CensoredSVR(loss, reg=1e-3, gamma=0.5)
    there = model.fit(X, Y).predict(X)
    objective = model.objective_
    np.testing.assert_allclose(model.fit(X[order], Y[order]).predict(X), there, atol=1e-5)
    assert model.objective_ == pytest.approx(objective, rel=1e-7)


@pytest.mark.parametrize("loss", ["squared", "absolute"])
def test_rows_of_weight_0_change_nothing(loss):
    junk = survival_array(np.full(20, 0.01), np.arange(20) % 2 == 0)
    both = np.concatenate([X, np.full((20, 3), 9.0)])
    model = CensoredSVR(loss, reg=1e-3)
    alone = model.fit(X, Y).predict(X)
    weights = np.repeat([1.0, 0.0], [len(X), 20])
    np.testing.assert_array_equal(model.fit(both, np.concatenate([Y, junk]), sample_weight=weights).predict(X), alone)


def test_cut_rows_count_in_n_only():
    # Cut before anything was seen: nobody else's weight changes but for n.
    early = survival_array(np.full(15, 1e-3), np.zeros(15, dtype=bool))
    model = CensoredSVR("squared", reg=1e-3, gamma=0.5, censoring="none")
    alone = model.fit(X, Y).predict(X)
    more = model.fit(np.concatenate([X, X[:15]]), np.concatenate([Y, early])).predict(X)
    assert np.abs(more - alone).max() > 1e-6
    scaled = CensoredSVR("squared", reg=1e-3 * 75 / 60, gamma=model.gamma, censoring="none").fit(X, Y)
    np.testing.assert_allclose(scaled.predict(X), more, atol=1e-9)
