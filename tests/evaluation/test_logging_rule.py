"""The logging policy without its exploration, found in logs whose rule is known; and where to try more."""

import re
from functools import cache

import numpy as np
import pandas as pd
import pytest
from enumerated_trial import StatePolicy, specified, trial
from scipy import stats
from sklearn.tree import DecisionTreeRegressor

from halfseen.evaluation import Baseline, QSpec, evaluate, off_policy
from halfseen.evaluation.estimate import estimate_of
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
from halfseen.evaluation.logging_rule import forest, logging_rule, logit, products, ranks
from halfseen.evaluation.off_policy import judging, q_model_of
from halfseen.evaluation.specification import with_second_order
from halfseen.evaluation.weights import nuisances_by_folds, nuisances_of
from halfseen.learning import DoublyRobust, NamedActions
from halfseen.learning.rows import trajectory_arrays
from halfseen.logs import Logs
from halfseen.policies import Rule
from halfseen.tables import TableTask
from small_logs import table_log

ACTIONS = ("A", "B", "C")
TASK = NamedActions(ACTIONS, ("x",))


def thresholds(frame, stage):
    if stage == 2:
        return np.full(len(frame), "C")
    return np.where(frame["x"] > 0.3, "A", np.where(frame["y"] > 0.0, "B", "C"))


def slanted(frame, stage):
    return np.where(frame["x"] + frame["y"] > 0.2 * stage, "A", np.where(frame["x"] > frame["y"], "B", "C"))


@cache
def logged(rule, num_trajectories=300, random_share=0.5, seed=0):
    """Two stages; the rule, mixed with an action at random; Q of the task does not look at y, the rule does."""
    rng = np.random.default_rng(seed)
    trajectory, parts = np.arange(num_trajectories), []
    for stage in (1, 2):
        frame = pd.DataFrame(rng.uniform(-1.0, 1.0, size=(num_trajectories, 2)), columns=["x", "y"])
        says = rule(frame, stage)
        action = np.where(rng.random(num_trajectories) < random_share, rng.choice(ACTIONS, num_trajectories), says)
        likely = random_share / 3.0 + (1.0 - random_share) * (action == says)
        reward = (action == "A") * frame["x"] + (action == "B") * frame["y"] + 0.3 * rng.normal(size=num_trajectories)
        result = {
            "trajectory": trajectory,
            "stage": stage,
            "elapsed_s": float(stage),
            "action": action,
            "reward": reward,
        }
        parts.append(frame.assign(**result, probability=likely, colour="red"))
    ends = pd.DataFrame({"trajectory": trajectory, "end_s": 2.0, "ending": "finished"})
    return Logs(pd.concat(parts, ignore_index=True), ends)


def found_in(logs, task=TASK, has_probability=True, horizon=2):
    trajectories = trajectory_arrays(logs, task.encode(logs, horizon), None)
    return logging_rule(logs, trajectories, task, np.arange(logs.num_trajectories) % 10, has_probability), trajectories


def agreement(rule, logs, found):
    says = np.array(ACTIONS)[found.probabilities.argmax(axis=2)]
    return np.mean([says[:, stage - 1] == rule(frame, stage) for stage, frame in logs.stages.groupby("stage")])


@pytest.mark.parametrize(("rule", "least"), [(thresholds, 0.96), (slanted, 0.93)])
def test_the_model_says_what_the_rule_would_do_and_how_often_it_is_right(rule, least):
    logs = logged(rule)
    found, trajectories = found_in(logs)
    right = agreement(rule, logs, found)
    assert right > least
    np.testing.assert_array_equal(found.is_taken, trajectories.probability > 0.5)
    assert "from probabilities above one half" in found.note
    num_right, num_checked = map(int, re.search(r"right in (\d+) of (\d+) stages", found.note).groups())
    assert right == pytest.approx(num_right / num_checked, abs=0.05)


def test_actions_alone_tell_less_and_a_rule_that_is_seldom_above_one_half_is_estimated():
    logs = logged(thresholds)
    found, _ = found_in(logs, has_probability=False)
    assert found.is_taken is None
    assert 0.85 < agreement(thresholds, logs, found) < 1.0
    assert "the accuracy of the model cannot be checked" in found.note
    logs = logged(thresholds, 400, random_share=0.8)
    found, _ = found_in(logs)
    assert found.is_taken is None
    assert agreement(thresholds, logs, found) > 0.95


@pytest.mark.slow
def test_a_log_of_nothing_but_chance_shows_no_rule():
    logs = logged(thresholds, random_share=1.0)
    assert found_in(logs)[0].startswith("the log shows no rule")
    default, asked = (
        evaluate(Rule(thresholds, ACTIONS, 2), logs, **result) for result in ({}, {"against": "logging-rule"})
    )
    assert [each.baseline for each in default.comparisons] == ["the logging policy"]
    assert "the logging policy without its exploration: the log shows no rule" in default.notes[0]
    assert asked.verdict == "inconclusive"
    assert "the log shows no rule" in asked.reason


@pytest.mark.slow
def test_it_is_worth_what_the_rule_itself_is_worth():
    itself = Baseline(Rule(slanted, ACTIONS, 2), "itself")
    against = ["logging-rule", itself]
    found = evaluate(Rule(thresholds, ACTIONS, 2), logged(slanted, 800, seed=3), against=against)
    guessed, known = (each.value for each in found.comparisons)
    assert guessed.value == pytest.approx(known.value, abs=0.3 * known.standard_error)
    assert guessed.standard_error == pytest.approx(known.standard_error, rel=0.05)


@pytest.mark.slow
def test_the_value_does_not_rest_on_the_model_where_the_log_reveals_the_rule(monkeypatch):
    def blind(*given):
        found = logging_rule(*given)
        always_first = np.zeros_like(found.probabilities)
        always_first[..., 0] = found.probabilities.sum(axis=2)
        return found._replace(probabilities=always_first)

    logs = logged(thresholds, 1000, seed=5)
    truth = evaluate(Rule(thresholds, ACTIONS, 2), logs).doubly_robust
    monkeypatch.setattr(off_policy, "logging_rule", blind)
    (wrong,) = evaluate(Rule(slanted, ACTIONS, 2), logs, against="logging-rule").comparisons
    assert abs(wrong.value.value - truth.value) < 2.0 * wrong.value.standard_error


def test_the_rule_is_fitted_to_the_covariates_of_the_log_and_not_to_the_second_order_terms_of_q(monkeypatch):
    seen = []
    monkeypatch.setattr(
        off_policy, "logging_rule", lambda logs, *given: seen.append(logs) or logging_rule(logs, *given)
    )
    logs = logged(slanted, 300)
    evaluate(Rule(thresholds, ACTIONS, 2), logs, against="logging-rule")
    assert seen[0].stage_covariates == logs.stage_covariates


def test_on_a_table_the_rule_is_a_choice_among_all_objects():
    """The rule washes what is most likely dirty; features of WASH hold that probability."""
    found, trajectories = found_in(table_log(num_trajectories=60), TableTask(), False, 3)
    assert not isinstance(found, str)
    assert (found.probabilities.sum(axis=2) == trajectories.is_begun).all()
    assert not (found.probabilities.astype(bool) & ~trajectories.is_possible).any()


@pytest.mark.slow
def test_the_seed_is_all_that_it_depends_on_and_where_one_trajectory_alone_has_a_say_there_is_still_an_answer():
    logs = logged(slanted, 60)
    first, _ = found_in(logs)
    np.random.seed(3)  # noqa: NPY002
    np.testing.assert_array_equal(first.probabilities, found_in(logs)[0].probabilities)
    # Its fold is held out once, and nothing is left to fit to.
    logs = logged(thresholds, 60)
    stages = logs.stages.assign(probability=np.where(logs.stages["trajectory"] == 0, 0.9, 0.01))
    found, _ = found_in(Logs(stages, logs.trajectories))
    assert isinstance(found, str) or np.array_equal(found.probabilities.sum(axis=2), np.ones((60, 2)))


TARGET = StatePolicy((0.1, 0.8))
BY_COX = DoublyRobust("cox", by="pooled", truncate_at=10.0)


def test_what_is_fitted_without_a_fold_does_not_know_it():
    logs = trial(0, cut_rate=0.15)
    fold = np.arange(logs.num_trajectories) % 4
    late = fold == 3
    stages, ends = logs.stages.copy(), logs.trajectories.copy()
    stages.loc[np.isin(stages["trajectory"], logs.trajectory_ids[late]), "elapsed_s"] *= 1.25
    ends.loc[late, "end_s"] *= 1.25
    fitted = []
    for each in (logs, Logs(stages, ends)):
        model, trajectories = q_model_of(TARGET, each, BY_COX, QSpec()).fitted(each)
        fitted.append([*nuisances_by_folds(model, trajectories, nuisances_of(model, trajectories), fold)])
    one, other = fitted
    np.testing.assert_allclose(one[3].uncut[~late], other[3].uncut[~late], rtol=1e-12)
    assert np.abs(one[0].uncut[~late] - other[0].uncut[~late]).max() > 1e-3


def test_the_interval_is_the_wider_of_two():
    influence = np.random.default_rng(0).normal(size=100)
    by_trajectories = stats.t.ppf(0.975, 39) * influence.std(ddof=1) / 10.0
    calm, wild = np.full(5, influence.mean()), influence.mean() + np.array([-1.0, 1.0, 0.0, 2.0, -2.0])
    narrow, wide = (estimate_of(influence, 40.0, 0.95, without) for without in (calm, wild))
    assert narrow.high - narrow.value == pytest.approx(by_trajectories)
    by_groups = np.sqrt(4.0 / 5.0 * 10.0)
    assert wide.standard_error == pytest.approx(by_groups)
    assert wide.high - wide.value == pytest.approx(stats.t.ppf(0.975, 4) * by_groups)
    assert narrow.value == wide.value


def test_second_order_terms_are_products_of_standardised_covariates():
    logs, rng = trial(2), np.random.default_rng(0)
    wide = Logs(logs.stages.assign(v=rng.normal(3.0, 2.0, logs.num_stages)), logs.trajectories)
    task, widened = with_second_order(NamedActions(["A", "B"], ["x", "v"]), wide)
    assert task.covariates == ["x", "v", "stage", "x*v", "v*v"]
    x, v = ((wide.stages[name] - wide.stages[name].mean()) / wide.stages[name].std(ddof=0) for name in ("x", "v"))
    np.testing.assert_allclose(widened.stages[["x*v", "v*v"]], np.stack([x * v, v * v], axis=1))


@pytest.mark.slow
def test_cuts_widen_the_interval():
    cut, uncut = (
        evaluate(TARGET, trial(1, num_trajectories=300, cut_rate=rate), against="logging", **specified(BY_COX))
        for rate in (0.3, 0.0)
    )
    assert cut.doubly_robust.standard_error > 1.5 * uncut.doubly_robust.standard_error


NUM_ROWS = 400
RNG = np.random.default_rng(0)
STATES = RNG.normal(size=(NUM_ROWS, 3))
BY_RULE = np.where(STATES[:, 0] > 0.2, 0, np.where(STATES[:, 1] * STATES[:, 2] > 0.0, 1, 2))
ACTION = np.where(RNG.random(NUM_ROWS) < 0.2, RNG.integers(3, size=NUM_ROWS), BY_RULE)


@pytest.mark.parametrize(("model", "design_of"), [(forest, ranks), (logit, products)])
def test_a_model_of_the_rule_is_close_the_same_again_and_right_where_values_are_alike_or_huge(model, design_of):
    def guess(states):
        design = design_of(states)
        return model(NUM_ROWS).fit(design, ACTION).predict(design)

    np.testing.assert_array_equal(guess(STATES), guess(STATES))
    assert (guess(STATES) == BY_RULE).mean() > 0.75
    huge = np.column_stack([np.ones(NUM_ROWS), np.where(ACTION == 0, 1e150, -1e150)])
    assert (guess(huge)[ACTION == 0] == 0).all()


@pytest.mark.parametrize(("num_rows", "num_columns"), [(10, 9), (9, 3)])
def test_products_are_added_unless_they_outnumber_the_rows(num_rows, num_columns):
    states = RNG.normal(5.0, 2.0, size=(num_rows, 3))
    found = products(states)
    assert found.shape == (num_rows, num_columns)
    np.testing.assert_allclose(found[:, :3], (states - states.mean(axis=0)) / states.std(axis=0))


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
        _Leaf(("x",), {}, 1, np.arange(100), (rng.random(100) < p).astype(int), rng.random(100), np.zeros((100, 1)))
        for p in (0.1, 0.3)
    ]
    shares = np.array(_allotted(leaves))
    tries = sum(leaf.tries for leaf in leaves)
    assert 100 * shares.sum() == pytest.approx(tries)

    def left(one):
        return sum(leaf.hanging * leaf.share / each for leaf, each in zip(leaves, one, strict=True))

    for moved in (-0.05, 0.05):
        assert left([shares[0] + moved, shares[1] - moved]) > left(shares)


@pytest.mark.slow
def test_regions_hold_states_in_which_the_policy_departs_from_the_log():
    found = explored(trial(0, num_trajectories=600, cut_rate=0.05))
    assert found.narrower > 1.0
    assert found.regions
    for region in found.regions:
        assert isinstance(region, Region)
        assert 0.0 < region.now < LARGEST_SHARE
        assert set(region.conditions) <= {"stage", "x"}
        assert 0.0 < region.part <= 1.0
    assert list(found.regions) == sorted(found.regions, key=lambda region: -region.part)


@pytest.mark.parametrize(
    ("values", "limits", "written"),
    [
        ([0.0, 1.0, 2.0], (0.5, 1.5), "> 0.5 and <= 1.5"),
        # A position far from zero: 1e+04 would hold none below it.
        ([10000.1, 10000.4, 10000.6], (-np.inf, 10000.5), "<= 10000.5"),
        ([1767225600.0, 1767225601.0], (1767225600.5, np.inf), "> 1.7672256e+09"),
    ],
)
def test_limits_are_written_with_the_digits_that_they_need(values, limits, written):
    nothing = np.zeros(0, dtype=int)
    leaf = _Leaf(("x",), {0: limits}, 0, nothing, nothing, np.zeros(0), np.array(values)[:, None])
    assert leaf.conditions == {"x": written}


def test_a_policy_that_does_as_the_log_does_has_nothing_to_try():
    assert explored(trial(0, num_trajectories=600, cut_rate=0.05), StatePolicy((0.0, 1.0))) == NOWHERE


def test_the_order_of_the_rows_of_a_log_does_not_matter():
    logs = trial(2, num_trajectories=150, cut_rate=0.05)
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
