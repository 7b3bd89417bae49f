"""Where to try more: regions that are rows of a rule, shares by Neyman's allocation, as many tries as now."""

import numpy as np
import pytest
from enumerated_trial import StatePolicy, trial

from halfseen.evaluation.exploring import (
    LARGEST_SHARE,
    NOWHERE,
    Region,
    _allotted,
    _Leaf,
    _leaves,
    _shares,
    exploration_of,
)
from halfseen.evaluation.off_policy import judging

POLICY = StatePolicy((1.0, 0.0))


def explored(seed=0, policy=POLICY, num_trajectories=600):
    logs = trial(seed, num_trajectories=num_trajectories, cut_rate=0.05)
    with judging(policy, logs, against="logging") as judge:
        return logs, exploration_of(judge.case(judge.problem))


def test_shares_are_those_of_neyman():
    by, size = np.array([1.0, 2.0, 0.5]), np.array([100.0, 50.0, 200.0])
    found = _shares(by, size, 30.0)
    assert size @ found == pytest.approx(30.0)
    np.testing.assert_allclose(found / by, found[0] / by[0])
    capped = _shares(np.array([1.0, 100.0]), np.array([100.0, 100.0]), 60.0)
    np.testing.assert_allclose(capped, [0.1, LARGEST_SHARE])
    assert not len(_shares(np.empty(0), np.empty(0), 0.0))


def test_no_other_shares_of_as_many_tries_leave_less_variance():
    rng = np.random.default_rng(0)
    leaves = [
        _Leaf(("x",), {}, 1, np.arange(100), (rng.random(100) < p).astype(int), rng.random(100)) for p in (0.1, 0.3)
    ]
    shares = np.array(_allotted(leaves))
    tries = sum(leaf.tries for leaf in leaves)
    assert 100 * shares.sum() == pytest.approx(tries)

    def left(one):
        return sum(leaf.hanging * leaf.share / each for leaf, each in zip(leaves, one, strict=True))

    for moved in (-0.05, 0.05):
        assert left([shares[0] + moved, shares[1] - moved]) > left(shares)


def test_regions_hold_states_in_which_the_policy_departs_from_the_log():
    _, found = explored()
    assert found.narrower > 1.0
    assert found.regions
    for region in found.regions:
        assert isinstance(region, Region)
        assert 0.0 < region.now < LARGEST_SHARE
        assert set(region.conditions) <= {"stage", "x"}
    assert list(found.regions) == sorted(found.regions, key=lambda region: -region.part)


def test_a_policy_that_does_as_the_log_does_has_nothing_to_try():
    _, found = explored(policy=StatePolicy((0.0, 1.0)))
    assert found == NOWHERE


def test_the_order_of_the_rows_of_a_log_does_not_matter():
    logs = trial(2, num_trajectories=300, cut_rate=0.05)
    each = []
    for frame in (logs.stages, logs.stages.iloc[::-1]):
        with judging(POLICY, type(logs)(frame, logs.trajectories), against="logging") as judge:
            each.append(exploration_of(judge.case(judge.problem)))
    assert each[0] == each[1]


def test_regions_are_the_leaves_of_a_regression_tree():
    from sklearn.tree import DecisionTreeRegressor

    rng = np.random.default_rng(0)
    columns = np.column_stack([rng.integers(0, 3, 400), rng.integers(0, 5, 400), rng.normal(size=400)]).astype(float)
    hangs = 2.0 * (columns[:, 0] > 0) * (columns[:, 1] > 2) + rng.exponential(size=400)
    rows = np.flatnonzero(rng.random(400) < 0.8)
    tree = DecisionTreeRegressor(max_leaf_nodes=4, min_samples_leaf=30, random_state=0).fit(columns[rows], hangs[rows])
    leaf_of = tree.apply(columns[rows])
    wanted = sorted(tuple(rows[leaf_of == leaf]) for leaf in np.unique(leaf_of))
    found = _leaves(columns, hangs, rows)
    assert sorted(tuple(np.sort(kept)) for _, kept in found) == wanted
    for limits, kept in found:
        inside = np.ones(400, dtype=bool)
        for column, (low, high) in limits.items():
            inside &= (columns[:, column] > low) & (columns[:, column] <= high)
        np.testing.assert_array_equal(np.sort(kept), np.intersect1d(np.flatnonzero(inside), rows))
    assert _leaves(columns, hangs, rows[:40]) == [({}, pytest.approx(rows[:40]))]
