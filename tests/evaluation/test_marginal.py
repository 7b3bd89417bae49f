"""Weights by states against loops and an enumeration; what a trajectory can earn; what went before a stage."""

from functools import cache
from itertools import product

import numpy as np
import pytest
from enumerated_trial import CHANCE_B, StatePolicy, leaves, problem, specified, trial, truth

from halfseen.evaluation import FixedSequence, evaluate
from halfseen.evaluation import marginal as regression
from halfseen.evaluation.estimate import Possible, possible
from halfseen.evaluation.marginal import CLEARLY, history_deviate, marginal_weights, wald
from halfseen.evaluation.off_policy import HISTORY_COUNTS
from halfseen.evaluation.weights import begun_weights, single_ratios
from halfseen.logs import Logs

TARGET = StatePolicy((0.1, 0.8))


def rows(seed, num_rows=40, num_weightings=3):
    """Two covariates of few values, weights, and which rows are fitted; the last weighting has them all."""
    rng = np.random.default_rng(seed)
    states = np.stack([rng.integers(0, 3, num_rows), rng.integers(0, 2, num_rows)], axis=1).astype(float)
    weight = rng.exponential(size=(num_weightings, num_rows)) * (1.0 + states[:, 0] * states[:, 1])
    fold = rng.integers(0, num_weightings - 1, num_rows)
    return weight, states, fold != np.arange(num_weightings)[:, None]


def naive_forms(weight, states, is_fitted):
    """Each guess and width, row by row: a ridge regression, and what it leaves averaged over neighbours."""
    scaled = (states - states.mean(axis=0)) / states.std(axis=0)
    design = np.column_stack([np.ones(len(scaled)), scaled])
    fitted = np.flatnonzero(is_fitted)
    ridge = np.diag([1e-9, regression.RIDGE, regression.RIDGE])
    slopes = np.linalg.solve(
        sum(np.outer(design[i], design[i]) for i in fitted) + ridge, sum(design[i] * weight[i] for i in fitted)
    )
    for guess, width in product((np.zeros(len(weight)), design @ slopes), regression.WIDTHS):
        found = []
        for i in range(len(weight)):
            near = [np.exp(-np.mean((scaled[i] - scaled[j]) ** 2) / (2.0 * width**2)) for j in fitted]
            left = sum(k * (weight[j] - guess[j]) for k, j in zip(near, fitted, strict=True)) / sum(near)
            found.append(max(guess[i] + left, 0.0))
        yield np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_mean_by_state_is_the_loop(seed):
    weight, states, is_fitted = rows(seed)
    each = [list(naive_forms(*one)) for one in zip(weight, [states] * len(weight), is_fitted, strict=True)]
    errors = [
        sum(((weight[b] - each[b][form])[~is_fitted[b]] ** 2).sum() for b in range(len(weight)))
        for form in range(2 * len(regression.WIDTHS))
    ]
    best = [forms[int(np.argmin(errors))] for forms in each]
    wanted = [m * w[kept].sum() / m[kept].sum() for m, w, kept in zip(best, weight, is_fitted, strict=True)]
    np.testing.assert_allclose(regression.mean_by_state(weight, [states], is_fitted), wanted, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("unit", [1e-12, 1e9])
def test_the_mean_by_state_has_no_unit(unit):
    weight, states, is_fitted = rows(0)
    whole = regression.mean_by_state(weight, [states], is_fitted)
    np.testing.assert_allclose(regression.mean_by_state(weight, [unit * states], is_fitted), whole, rtol=1e-6)


@pytest.mark.parametrize("num_places", [1, 5, 50])
def test_few_places_stand_for_many_states(monkeypatch, num_places):
    monkeypatch.setattr(regression, "MOST_PLACES", num_places)
    states = np.random.default_rng(1).normal(size=(400, 2))
    weight = np.exp(states[:, 0])[None]
    found = regression.mean_by_state(weight, [states], np.ones((1, 400), dtype=bool))
    assert found.shape == (1, 400)
    assert (found >= 0).all()
    assert found.sum() == pytest.approx(weight.sum())


def naive_weights(single, uncut, trajectories, fold, k):
    """w_t of imputed stages, one by one, without fold k; what stands for each trajectory; and what was cut off."""
    num, horizon = single.shape
    by_state, weight, standing, lost = np.ones(num), np.zeros(single.shape), np.zeros(single.shape), 0.0
    last = {}
    for t in range(horizon):
        passed = np.zeros(num)
        for i in range(num):
            if not trajectories.is_begun[i, t]:
                standing[i, t] = last.get(i, 0.0)
                continue
            whole = by_state[i] * single[i, t] if trajectories.has_action[i, t] else 0.0
            weight[i, t] = standing[i, t] = min(whole, num**0.5)
            lost += (whole - weight[i, t]) / num
            before = uncut[k, i, t - 1] if t else 1.0
            passed[i] = weight[i, t] * uncut[k, i, t] / before
            if trajectories.clocks.is_finished[i] and trajectories.is_begun[i].sum() == t + 1:
                last[i] = passed[i]
        if t + 1 < horizon:
            here = np.flatnonzero(trajectories.is_begun[:, t + 1])
            own = regression.mean_by_state(
                np.stack([passed[here]] * len(uncut)),
                [trajectories.features[here, t + 1, 0]],
                fold[here] != np.arange(len(uncut))[:, None],
            )
            by_state = np.zeros(num)
            by_state[here] = own[k]
    return weight, standing, lost


def test_weights_by_states_are_the_loop(monkeypatch):
    """With one width there is nothing to choose, so each fold goes its own way."""
    monkeypatch.setattr(regression, "WIDTHS", (0.6,))
    monkeypatch.setattr(regression, "linear", lambda weight, *_: np.zeros_like(weight))
    given = problem(trial(0, num_trajectories=60, cut_rate=0.15), TARGET)
    uncut = np.stack([each.uncut for each in given.nuisances])
    single = single_ratios(given.log.policy, given.likely, given.trajectories)
    found = marginal_weights(single, uncut, given.trajectories, given.beyond, given.fold, is_imputed=True)
    for k, each in enumerate(found.by_fold):
        weight, standing, lost = naive_weights(single, uncut, given.trajectories, given.fold, k)
        np.testing.assert_allclose(each.weight, weight, rtol=1e-9)
        np.testing.assert_allclose(each.standing, standing, rtol=1e-9)
    assert found.lost == pytest.approx(lost)


def test_of_the_logging_policy_on_uncut_logs_every_weight_is_one():
    logs = trial(1, num_trajectories=100)
    given = problem(logs, StatePolicy(tuple(CHANCE_B)))
    for each in given.stage_weights:
        np.testing.assert_allclose(each.weight, given.trajectories.is_begun.astype(float), rtol=1e-9)
        np.testing.assert_allclose(each.standing, 1.0, rtol=1e-9)
    assert given.marginal.lost == 0.0
    assert given.effective_sample_size == pytest.approx(100.0)


def test_they_are_the_ratio_of_how_often_states_are_met():
    """States are fair coins, so all that the past says of stage 2 is how often it is come to."""
    logs = trial(2, num_trajectories=4000, cut_rate=0.1)
    given = problem(logs, TARGET)
    stays = {
        name: 1.0
        - sum(
            0.5 * chance * leaves(state, action)
            for state in (0, 1)
            for action, chance in enumerate((1.0 - b[state], b[state]))
        )
        for name, b in {"policy": TARGET.chance_b, "log": CHANCE_B}.items()
    }
    single = single_ratios(given.log.policy, given.likely, given.trajectories)
    second = given.trajectories.is_begun[:, 1] & (single[:, 1] > 0)
    by_state = given.stage_weights[-1].weight[second, 1] / single[second, 1]
    # Of cut trajectories some are missing there, for which the others stand.
    standing = given.stage_weights[-1].standing.mean(axis=0)
    assert standing == pytest.approx(1.0, abs=0.06)
    share = (given.trajectories.is_begun[:, 1] * given.nuisances[-1].uncut[:, 0]).mean()
    assert by_state.mean() * given.trajectories.is_begun[:, 1].mean() == pytest.approx(stays["policy"], rel=0.06)
    assert share == pytest.approx(stays["log"], rel=0.06)


def test_they_vary_less_than_products_and_agree_with_them_in_the_mean():
    given = problem(trial(3, num_trajectories=2000, cut_rate=0.1), TARGET)
    products = begun_weights(given.ratio, given.nuisances[-1].uncut, given.trajectories)
    by_state = given.stage_weights[-1]
    assert by_state.effective_sample_size > products.effective_sample_size
    assert by_state.standing.mean(axis=0) == pytest.approx(products.standing.mean(axis=0), rel=0.05)


def test_no_weight_is_larger_than_the_root_of_the_trajectories_and_the_interval_allows_for_what_is_lost():
    logs = trial(4, num_trajectories=40)
    rare = logs.stages.assign(probability=logs.stages["probability"].where(logs.stages["action"] == "A", 0.02))
    rare = type(logs)(rare, logs.trajectories)
    given = problem(rare, FixedSequence(("B", "B")))
    assert given.stage_weights[-1].weight.max() == pytest.approx(np.sqrt(40))
    assert given.marginal.lost > 1.0
    found = evaluate(FixedSequence(("B", "B")), rare, against="logging", **specified("kaplan-meier"))
    assert found.difference.bias > 0.1


def naive_most(trajectories, sign):
    """The largest sum of signed rewards over ways through the stages, each of which ends or goes on as one did."""

    def most(t):
        if t == trajectories.reward.shape[1]:
            return 0.0
        done = [i for i in range(trajectories.num_trajectories) if trajectories.is_completed[i, t]]
        return max(
            sign * trajectories.reward[i, t] + (0.0 if trajectories.is_last[i, t] else most(t + 1)) for i in done
        )

    return sign * most(0)


def test_what_a_trajectory_can_earn_is_the_best_way_through_what_was_seen():
    trajectories = problem(trial(5, num_trajectories=30, cut_rate=0.1), TARGET).trajectories
    assert tuple(possible(trajectories)) == pytest.approx(
        (naive_most(trajectories, -1.0), naive_most(trajectories, 1.0))
    )


def test_a_mean_outside_is_moved_to_the_nearer_end():
    values, ends = np.array([0.0, 1.0, 5.0]), Possible(0.0, 1.5)
    assert ends.moved_within(values).mean() == pytest.approx(1.5)
    assert np.ptp(ends.moved_within(values)) == pytest.approx(5.0)
    np.testing.assert_array_equal(Possible(-1.0, 3.0).moved_within(values), values)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_no_interval_reaches_beyond_the_possible(seed):
    logs = trial(seed, num_trajectories=30, cut_rate=0.2)
    given = problem(logs, TARGET)
    found = evaluate(StatePolicy((1.0, 0.0)), logs, against="logging")
    low, high = possible(given.trajectories)
    assert low <= found.doubly_robust.low <= found.doubly_robust.value <= found.doubly_robust.high <= high
    assert found.difference.low >= low - found.logging.high - 1e-12
    assert found.difference.high <= high - found.logging.low + 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("policy", [TARGET, StatePolicy((1.0, 0.0)), FixedSequence(("B", "B"))])
def test_intervals_of_few_effective_trajectories_hold_the_truth(policy):
    chance_b = (1.0, 1.0) if isinstance(policy, FixedSequence) else policy.chance_b
    gain = truth(chance_b) - truth(tuple(CHANCE_B))
    found = [evaluate(policy, trial(seed, num_trajectories=60, cut_rate=0.1), against="logging") for seed in range(40)]
    held = sum(each.difference.low <= gain <= each.difference.high for each in found)
    # Of 40 intervals at 95 %, fewer than 35 hold with a chance of 2 %.
    assert held >= 35


# What went before a stage
CARRIED = 2.0
"""What a first action B adds to the reward of the second stage."""


@cache
def with_history(seed, num_trajectories=400):
    """The trial, but a first action B is paid for in the second stage, too, which no covariate of it tells."""
    logs = trial(seed, num_trajectories=num_trajectories, cut_rate=0.05)
    first = logs.stages.groupby("trajectory")["action"].transform("first")
    is_paid = (logs.stages["stage"] == 2) & (first == "B")
    return Logs(logs.stages.assign(reward=logs.stages["reward"] + CARRIED * is_paid), logs.trajectories)


def true_gain():
    """A first action B is worth as much more, for it ends no trajectory."""

    def value(chance_b):
        return truth(chance_b) + CARRIED * sum(0.5 * chance for chance in chance_b)

    return value(TARGET.chance_b) - value(tuple(CHANCE_B))


def test_where_states_tell_all_it_is_a_normal_deviate():
    found = []
    given = problem(trial(0, num_trajectories=300), TARGET, num_folds=5)
    for seed in range(200):
        rng = np.random.default_rng(seed)
        # What trajectories share, and what is theirs in a stage.
        residual = rng.normal(size=(300, 1)) + rng.normal(size=(300, 2)) * (1.0 + given.trajectories.action)
        found.append(history_deviate(residual, given.trajectories.is_begun, given.trajectories, given.beyond))
    assert np.mean(found) == pytest.approx(0.0, abs=0.25)
    assert np.std(found) == pytest.approx(1.0, abs=0.15)


def test_a_clock_among_the_covariates_hides_no_other():
    """What a state says of its stage is no history, in whatever unit the other covariates are."""
    given = problem(trial(0, num_trajectories=300), TARGET, num_folds=5)
    rng = np.random.default_rng(0)
    kept, clock = np.repeat(rng.normal(size=(300, 1, 1)), 2, axis=1), rng.normal(size=(300, 2, 1))
    residual, begun = kept[..., 0] + rng.normal(size=(300, 2)), given.trajectories.is_begun
    plain, dated = (
        history_deviate(residual, begun, given.trajectories, np.concatenate([kept, each], axis=2))
        for each in (clock, 1.7e9 + 1e6 * clock)
    )
    assert abs(plain) < CLEARLY
    assert dated == pytest.approx(plain, rel=1e-4, abs=1e-4)


def test_the_statistic_is_its_definition_and_directions_without_scores_do_not_count():
    score = np.random.default_rng(0).normal(size=(50, 3)) + 0.2
    total = score.sum(axis=0)
    found, freedom = wald(score)
    assert (found, freedom) == (pytest.approx(total @ np.linalg.inv(score.T @ score) @ total), 3)
    assert wald(np.column_stack([score, score[:, 0]])) == (pytest.approx(found), 3)
    assert wald(score[:, :0]) == (0.0, 0)


def test_a_trajectory_of_one_stage_has_no_history():
    logs = trial(1, num_trajectories=60)
    given = problem(logs, TARGET, num_folds=5)
    trajectories = given.trajectories
    assert (
        history_deviate(np.ones((60, 2)), trajectories.is_begun & [True, False], trajectories, given.beyond) == -np.inf
    )


@pytest.mark.slow
def test_a_past_that_matters_is_found_and_then_products_weigh():
    given = problem(with_history(0), TARGET, num_folds=5)
    judged = given.judged(given.nuisances[:-1])
    assert given.history_deviate(judged) > CLEARLY
    settled = given.settled(judged)
    assert (settled.marginal, settled.has_history) == (None, True)
    products = begun_weights(given.ratio, given.nuisances[-1].uncut, given.trajectories)
    np.testing.assert_allclose(settled.stage_weights[-1].weight, products.weight, rtol=1e-9)
    np.testing.assert_allclose(settled.stage_weights[-1].standing, products.standing, rtol=1e-9)
    found = evaluate(TARGET, with_history(0), against="logging")
    assert HISTORY_COUNTS in found.notes
    assert found.difference.low < true_gain() < found.difference.high


def test_a_past_that_does_not_is_not():
    logs = trial(2, num_trajectories=400, cut_rate=0.05)
    given = problem(logs, TARGET, num_folds=5)
    assert given.settled(given.judged(given.nuisances[:-1])) is given
    assert HISTORY_COUNTS not in evaluate(TARGET, logs, against="logging").notes
