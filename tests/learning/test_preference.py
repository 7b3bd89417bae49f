"""What a log of many actions prefers, beside scikit-learn and loops, and how much that counts."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from trials import log_of

from halfseen.learning import CensoredQLearner
from halfseen.learning.preference import (
    RIDGES,
    Stacked,
    advantages,
    at_least_median,
    clearly_best,
    gains_of_preferred,
    stacked,
    with_preference,
)
from halfseen.logs import Logs

ACTIONS = [f"a{a}" for a in range(10)]


def preferring(seed, n=80, likes=1.0, pays=1.0, horizon=1, misses=0.0):
    """Action k is best where x is nearest to k; the log takes it with the odds exp(likes · how near, up to misses)."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-0.5, 9.5, n * horizon)
    near = -0.5 * np.abs(x[:, None] - np.arange(10))
    odds = np.exp(-0.5 * likes * np.abs(x[:, None] + misses - np.arange(10)))
    chances = (odds / odds.sum(axis=1, keepdims=True)).cumsum(axis=1)
    action = np.minimum((rng.random((len(x), 1)) > chances).sum(axis=1), 9)
    reward = pays * near[np.arange(len(x)), action] + rng.normal(size=len(x))
    return log_of([f"a{a}" for a in action], reward, num_stages=horizon, x=x)


def laid_out(log):
    """The model of the log, fitted but for what the log prefers, and the log's arrays."""
    return CensoredQLearner(log.horizon, ACTIONS, ["x"]).compose(log).fitted(log)


def preference_of(log):
    return with_preference(*laid_out(log))[0]


@pytest.mark.parametrize("has_probability", [False, True])
def test_the_choice_is_that_of_scikit_learn_at_the_ridge_that_predicts_best(has_probability):
    from sklearn.linear_model import LogisticRegression

    log, is_rule = preferring(0), np.random.default_rng(1).random(80) < 0.8
    probability = np.where(is_rule, 0.8, 0.02)
    log = Logs(log.stages.assign(probability=probability), log.trajectories) if has_probability else log
    model, trajectories = laid_out(log)
    weight = is_rule.astype(float) if has_probability else np.ones(80)
    x, taken = trajectories.features[:, 0, 0, :], trajectories.action[:, 0]
    design = np.column_stack([np.ones(len(x)), (x - x.mean()) / x.std()])
    fold, likelihood = np.arange(len(x)) % 5, []

    def peer(ridge, rows):
        logit = LogisticRegression(C=1.0 / ridge, fit_intercept=False, tol=1e-8, max_iter=10_000)
        return logit.fit(design[rows], taken[rows], sample_weight=weight[rows])

    for ridge in RIDGES:
        found = 0.0
        for k in range(5):
            known = peer(ridge, fold != k)
            of_action = {a: i for i, a in enumerate(known.classes_)}
            log_chance = known.predict_log_proba(design[fold == k])
            assert len(of_action) == 10, "an action that a fold lacks would be another model"
            found += weight[fold == k] @ [
                row[of_action[a]] for row, a in zip(log_chance, taken[fold == k], strict=True)
            ]
        likelihood.append(found)
    best = peer(RIDGES[int(np.argmax(likelihood))], fold >= 0).coef_
    slopes = best[:, 1] / x.std()
    expected = np.column_stack([best[:, 0] - slopes * x.mean(), slopes])
    np.testing.assert_allclose(with_preference(model, trajectories)[0].behaviour, expected, atol=2e-3)


def test_what_was_only_explored_is_no_preference():
    """Half of the actions are the nearest, the others are drawn from all ten; the log knows the chance of each."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-0.5, 9.5, 200)
    nearest = np.rint(x).astype(int)
    action = np.where(rng.random(200) < 0.5, nearest, rng.integers(10, size=200))
    log = log_of([f"a{a}" for a in action], rng.normal(size=200), x=x)
    known = Logs(log.stages.assign(probability=np.where(action == nearest, 0.55, 0.05)), log.trajectories)
    at = np.column_stack([np.ones(200), x])
    found = [(preference_of(one).behaviour @ at.T).argmax(axis=0) for one in (known, log)]
    near = [float(np.mean(np.abs(each - nearest) <= 1)) for each in found]
    assert near[0] > near[1] + 0.1


@pytest.mark.parametrize("chance", [0.1, 0.5], ids=["of ten", "of two"])
def test_a_log_of_chance_alone_prefers_nothing(chance):
    """Chance among fewer actions than are known to be possible is no preference either."""
    log = preferring(3, likes=0.0)
    known = Logs(log.stages.assign(probability=chance), log.trajectories)
    found = [preference_of(one) for one in (log, known)]
    np.testing.assert_array_equal(*(each.behaviour for each in found))
    assert [each.behaviour_weight for each in found] == [0.0, 0.0]


SMALL = Logs(
    stages={
        "trajectory": [0, 0, 0, 1, 1, 2],
        "stage": [1, 2, 3, 1, 2, 1],
        "elapsed_s": [1.0, 2.0, 3.0, 1.0, None, 2.0],
        "reward": [1.0, -2.0, 0.5, 3.0, None, 2.0],
        "action": ["a0", "a1", "a2", "a3", "a4", "a5"],
        "x": [0.3, -1.0, 0.7, 1.2, -0.4, 0.1],
    },
    trajectories={"trajectory": [0, 1, 2], "end_s": [3.0, 1.5, 2.0], "ending": ["finished", "cut", "finished"]},
)
"""Of three trajectories the second is cut at 1.5 s, where all are at risk."""


@pytest.mark.parametrize("by_weight", [False, True])
def test_advantages_are_those_of_a_loop(by_weight):
    _, trajectories = laid_out(SMALL)
    weight = np.array([[1.0, 2.0, 3.0], [4.0, 0.0, 0.0], [0.5, 0.0, 0.0]]) if by_weight else np.ones((3, 3))
    x = np.array([[0.3, -1.0, 0.7], [1.2, -0.4, 0.0], [0.1, 0.0, 0.0]])
    reward, followed = [[1.0, -2.0, 0.5], [3.0], [2.0]], [[True, True, False], [True], [False]]

    def features(i, t):
        return np.array([1.0, t / 3, x[i, t], x[i, t] ** 2])

    left, right = np.diag([0.0, 3.0, 3.0, 3.0]), np.zeros(4)
    for i, rewards in enumerate(reward):
        for t, r in enumerate(rewards):
            after = features(i, t + 1) if followed[i][t] else np.zeros(4)
            left += weight[i, t] * np.outer(features(i, t), features(i, t) - after)
            right += weight[i, t] * features(i, t) * r
    value, expected = np.linalg.solve(left, right), np.zeros((3, 3))
    for i, rewards in enumerate(reward):
        for t, r in enumerate(rewards):
            after = features(i, t + 1) @ value if followed[i][t] else 0.0
            expected[i, t] = r + after - features(i, t) @ value
    found = advantages(trajectories, x[..., None], weight if by_weight else None)
    np.testing.assert_allclose(found, expected, atol=1e-10)


def test_what_the_preferred_earned_is_that_of_a_loop():
    """Ĝ is 2/3 after the cut; the covariates are those of all stages that began."""
    _, trajectories = laid_out(SMALL)
    behaviour = np.random.default_rng(0).normal(size=(10, 2))
    weight = np.array([[1.0, 1.5, 1.5], [1.0, 0.0, 0.0], [1.5, 0.0, 0.0]])
    x = SMALL.stages["x"].to_numpy()
    at = np.array([[0.3, -1.0, 0.7], [1.2, -0.4, np.nan], [0.1, np.nan, np.nan]])
    earned = advantages(trajectories, np.nan_to_num((at - x.mean()) / x.std())[..., None], weight)
    expected = np.zeros(3)
    for i, t, action in [(0, 0, 0), (0, 1, 1), (0, 2, 2), (1, 0, 3), (2, 0, 5)]:
        odds = np.exp(behaviour @ [1.0, at[i, t]])
        chance = odds / odds.sum()
        excess = np.maximum((chance - 0.1) / 0.9, 0.0)
        expected[i] += weight[i, t] * earned[i, t] * (excess[action] - chance @ excess)
    np.testing.assert_allclose(gains_of_preferred(behaviour, trajectories), expected, rtol=1e-10)


@pytest.mark.parametrize(("pays", "is_followed"), [(1.0, True), (0.0, True), (-1.0, False)])
def test_a_log_of_few_actions_is_not_followed_where_what_it_prefers_earned_less(pays, is_followed):
    rng = np.random.default_rng(1)
    x = rng.normal(size=200)
    is_preferred = rng.random(200) < 0.8
    log = log_of(np.where((x > 0) == is_preferred, "A", "B"), pays * is_preferred + rng.normal(size=200), x=x)
    learner = CensoredQLearner(1, ["A", "B"], ["x"]).fit(log)
    assert (learner.policy_.behaviour is not None) == is_followed
    assert any("they earned less" in why for why in learner.chosen_) != is_followed


def test_stacking_is_least_squares_with_errors_by_trajectory():
    rng = np.random.default_rng(4)
    of_trajectory, leads = np.repeat(np.arange(30), 3), rng.normal(size=(90, 2))
    advantage = leads @ [0.5, 2.0] + np.repeat(rng.normal(size=30), 3)
    expected = np.linalg.lstsq(leads, advantage, rcond=None)[0]
    bread, meat = np.linalg.inv(leads.T @ leads), np.zeros((2, 2))
    for i in range(30):
        own = of_trajectory == i
        score = leads[own].T @ (advantage[own] - leads[own] @ expected)
        meat += np.outer(score, score)
    found = stacked(leads, advantage, of_trajectory)
    np.testing.assert_allclose(found.coefficients, expected)
    np.testing.assert_allclose(found.errors, np.sqrt(np.diag(bread @ meat @ bread)))


@pytest.mark.parametrize(
    ("coefficients", "expected"),
    [((1.0, 3.0), 3.5 / 0.8), ((1.0, -3.0), 0.0), ((0.1, 3.0), 7.0), ((0.1, -3.0), 0.0), ((0.3, 3.0), 7.0)],
    ids=["both", "the log is wrong", "Q says nothing", "neither", "at most"],
)
def test_in_doubt_the_log_is_followed(coefficients, expected):
    assert Stacked(np.array(coefficients), np.array([0.1, 0.5])).weight(most=7.0) == pytest.approx(expected)


def test_q_below_the_median_of_what_is_possible_counts_as_the_median():
    q = np.array([[3.0, -900.0, 1.0, 2.0], [5.0, 4.0, -7.0, 9.0], [-2.0, 0.0, 0.0, 0.0]])
    is_possible = np.array([[True] * 4, [True, True, True, False], [True, False, False, False]])
    found = np.where(is_possible, at_least_median(q, is_possible), np.nan)
    np.testing.assert_array_equal(
        found, [[3.0, 1.5, 1.5, 2.0], [5.0, 4.0, 4.0, np.nan], [-2.0, np.nan, np.nan, np.nan]]
    )


def test_a_multiple_must_clearly_bring_more():
    of_trajectory = np.repeat(np.arange(50), 2)
    noise = np.random.default_rng(5).normal(size=100)
    first = np.zeros(100)
    assert clearly_best(np.stack([first, first + 0.1 * noise, first + 1.0]), of_trajectory) == 2
    assert clearly_best(np.stack([first, first - 1.0]), of_trajectory) == 0
    assert clearly_best(np.stack([first, noise - noise.mean()]), of_trajectory) == 0


@pytest.mark.slow
def test_it_counts_less_as_a_log_grows():
    weight = [
        np.mean([preference_of(preferring(seed, n=n, misses=2.0)).behaviour_weight for seed in range(3)])
        for n in (40, 400, 4000)
    ]
    assert weight[0] > 2.0 * weight[1] > 4.0 * weight[2]


def test_a_log_too_short_to_hold_out_is_followed():
    log = preferring(1, n=18, likes=4.0)
    model, trajectories = laid_out(log)
    x = trajectories.features[..., 0, :]
    noise = np.sqrt(np.mean(advantages(trajectories, (x - x.mean()) / x.std()) ** 2))
    assert with_preference(model, trajectories)[0].behaviour_weight == pytest.approx(2.0 * noise)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_log_that_does_what_hurts_is_not_followed(seed):
    learner = CensoredQLearner(1, ACTIONS, ["x"]).fit(preferring(seed, pays=-3.0))
    assert learner.policy_.behaviour_weight == 0
    assert "has no weight" in learner.chosen_[-1]
    assert CensoredQLearner(1, ACTIONS, ["x"]).fit(preferring(seed)).policy_.behaviour_weight > 0


def test_scores_are_q_less_margins_and_what_the_log_prefers():
    learner = CensoredQLearner(1, ACTIONS, ["x"]).fit(preferring(2))
    policy, frame = learner.policy_, pd.DataFrame({"x": [0.0, 4.2, 9.0]})
    utility = policy.behaviour[:, 0] + frame.to_numpy() @ policy.behaviour[:, 1:].T
    prefers = utility - np.log(np.exp(utility).sum(axis=1, keepdims=True))
    without = replace(policy, behaviour_weight=0.0).scores(frame, 1)
    np.testing.assert_allclose(policy.scores(frame, 1), without + policy.behaviour_weight * prefers)
    assert "of reward for each factor of e" in learner.chosen_[-1]


def worth(policy):
    """Mean of what a policy of these worlds earns."""
    x = np.linspace(-0.5, 9.5, 1001)
    return float(np.mean(-0.5 * np.abs(x - np.array([int(a[1:]) for a in policy.decide(pd.DataFrame({"x": x}), 1)]))))


@pytest.mark.slow
def test_few_trajectories_earn_what_the_log_does_and_more_than_q_alone():
    policies = [CensoredQLearner(1, ACTIONS, ["x"]).fit(preferring(seed, n=40, pays=0.3)).policy_ for seed in range(20)]
    own = np.mean([preferring(seed, n=2000, pays=1.0).stages["reward"].mean() for seed in range(5)])
    found = np.array([worth(policy) for policy in policies])
    alone = np.array([worth(replace(policy, behaviour_weight=0.0)) for policy in policies])
    assert found.mean() > max(own, alone.mean())
