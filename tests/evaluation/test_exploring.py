"""Where to try more: regions that are rows of a rule, shares by Neyman's allocation, as many tries as now."""

import numpy as np
import pytest
from enumerated_trial import StatePolicy, trial
from sklearn.tree import DecisionTreeRegressor

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


def explored(logs, policy=POLICY):
    with judging(policy, logs, against="logging") as judge:
        return exploration_of(judge.case(judge.problem))


def test_shares_have_a_largest():
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
    found = explored(trial(0, num_trajectories=600, cut_rate=0.05))
    assert found.narrower > 1.0
    assert found.regions
    for region in found.regions:
        assert isinstance(region, Region)
        assert 0.0 < region.now < LARGEST_SHARE
        assert set(region.conditions) <= {"stage", "x"}
    assert list(found.regions) == sorted(found.regions, key=lambda region: -region.part)


def test_a_policy_that_does_as_the_log_does_has_nothing_to_try():
    assert explored(trial(0, num_trajectories=600, cut_rate=0.05), StatePolicy((0.0, 1.0))) == NOWHERE


def test_the_order_of_the_rows_of_a_log_does_not_matter():
    logs = trial(2, num_trajectories=300, cut_rate=0.05)
    assert explored(type(logs)(logs.stages.iloc[::-1], logs.trajectories)) == explored(logs)


def test_regions_are_the_leaves_of_a_regression_tree():
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
