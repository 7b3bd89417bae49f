"""Play, cut, treat, learn, beside the estimator on the same logs; tests and intervals, beside definitions and SciPy."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from examples import SETTING
from fitted_laws import FITTED
from halfseen.errors import ArgumentError
from halfseen.learning import CensoredQLearner
from halfseen.study.compare import adjusted, better, holm, over_repetitions
from halfseen.study.pipeline import TREATMENTS, Source, episodes_in_turn
from halfseen.study.policies import HEURISTICS, horizon_planner
from halfseen.study.runner import MOST_AT_ONCE, in_rows, side_by_side
from halfseen.world import Scene, UniformPolicy, WorldConfig, random
from halfseen.world.cuts import CutEpisodes
from halfseen.world.logs import to_logs
from halfseen.world.rollout import play
from halfseen.world.state import pad_scenes

CONFIG = WorldConfig(horizon=3)
FINISH, WASH_0, LIFT_1 = 0, 1, 4


TWO_CUPS = pad_scenes([Scene(np.zeros((2, 2)))])


def cut_by_hand(is_cut=True):
    """Five trajectories of two dirty cups: 0 finished; others cut in stage 1 (WASH), 2 (LIFT), 2 (FINISH), 1 (LIFT)."""
    episodes = play(CONFIG, TWO_CUPS, UniformPolicy(), random.key_of(0), 5)
    there = np.ones((5, 3, 2), dtype=bool)
    there[0, 1:, 0] = there[3, 1:, 0] = False
    action = [[WASH_0, LIFT_1, FINISH], [WASH_0] * 3, [WASH_0, LIFT_1, FINISH], [WASH_0, FINISH, 0], [LIFT_1] * 3]
    reward = [[5, -0.2, -5], [9, 9, 9], [-1, 9, 9], [5, 9, 9], [9, 9, 9]]
    episodes = replace(
        episodes,
        states=replace(episodes.states, is_on_table=there),
        action=np.array(action),
        reward=np.array(reward, dtype=np.float32),
        duration_s=np.full((5, 3), 2.0),
        is_taken=np.ones((5, 3), dtype=bool),
        hidden=replace(episodes.hidden, is_dirty=np.ones((5, 2), dtype=bool)),
    )
    num_completed = np.array([3, 0, 1, 1, 0]) if is_cut else np.full(5, 3)
    is_completed = np.arange(3) < num_completed[:, None]
    end_s = np.array([6.0, 1.0, 3.0, 3.5, 1.0]) if is_cut else np.full(5, 6.0)
    return CutEpisodes(episodes, end_s, num_completed == 3, is_completed, np.arange(3) <= num_completed[:, None])


def seen(treatment, is_cut=True):
    """Reward, weight and last stages as the learner's regression has them."""
    cuts = cut_by_hand(is_cut)
    encoded = Source(CONFIG, TWO_CUPS, 0).logged(cuts.episodes)
    trajectories = encoded.lay_out(cuts, treatment).take(slice(5))
    targets = encoded.model(treatment).targets
    return (
        trajectories.reward,
        targets.weights(trajectories, targets.fit_cuts(trajectories.clocks)),
        trajectories.is_last,
    )


COMPLETED = [[5, -0.2, -5], [0, 0, 0], [-1, 0, 0], [5, 0, 0], [0, 0, 0]]
# WASH failed with two dirty left; LIFT for 1 s with two left; FINISH with one left; LIFT for 1 s with two left.
FAILED = [[5, -0.2, -5], [-11, 0, 0], [-1, -10.1, 0], [5, -5, 0], [-10.1, 0, 0]]


@pytest.mark.parametrize(
    ("treatment", "weight", "rewards", "last"),
    [
        # At 2 s two of five were cut; at 3 s one more of three, at 3.5 s one of the last two.
        ("weighted", [[5 / 3, 5, 5], [0] * 3, [5 / 3, 0, 0], [5 / 3, 0, 0], [0] * 3], COMPLETED, [2, 0, 0, 0, 0]),
        ("unweighted", [[1, 1, 1], [0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 0, 0]], COMPLETED, [2, 0, 0, 0, 0]),
        ("dropped", [[1, 1, 1]] + 4 * [[0, 0, 0]], None, [2, 0, 0, 0, 0]),
        ("failures", [[1, 1, 1], [1, 0, 0], [1, 1, 0], [1, 1, 0], [1, 0, 0]], FAILED, [2, 0, 1, 1, 0]),
    ],
)
def test_each_treatment_has_the_rows_weights_and_ends_by_hand(treatment, weight, rewards, last):
    found, weights, is_last = seen(treatment)
    np.testing.assert_allclose(weights, weight, rtol=1e-12)
    if rewards is not None:
        np.testing.assert_allclose(found, rewards, rtol=1e-6)
    ended = range(5) if treatment == "failures" else range(1)
    np.testing.assert_array_equal(np.argwhere(is_last), [[trajectory, last[trajectory]] for trajectory in ended])


def test_where_nothing_was_cut_all_treatments_are_one_and_an_unknown_one_is_refused():
    unweighted = seen("unweighted", False)
    for treatment in TREATMENTS:
        for ours, other in zip(seen(treatment, False), unweighted, strict=True):
            np.testing.assert_array_equal(ours, other)
    with pytest.raises(ArgumentError, match="'ignored'; give one of imputed, weighted, unweighted, dropped, failures"):
        seen("ignored")


def half_cut(config, num, kind="independent"):
    """A source, what it played, which half of it was cut, and the seed of what is learned from it."""
    source = Source(config, SETTING.layouts, 0, 3)
    episodes = source.play(num)
    seed = int(np.random.SeedSequence([0, 3]).generate_state(1)[0])
    return source, episodes, source.cut(episodes, source.cut_rate(0.5, kind), kind), seed


def test_slow_planners_meet_all_episodes_in_turn():
    assert episodes_in_turn(3, 7, 5) == [0, 1, 2, 3, 4]
    assert [episodes_in_turn(k, 2, 5) for k in range(4)] == [[0, 1], [2, 3], [0, 4], [1, 2]]


@pytest.mark.parametrize(("num", "num_workers"), [(0, 2), (1, 2), (40, 2), (41, 3), (10_000, 2), (10_000, 1000)])
def test_rows_of_repetitions_hold_each_of_them_once_and_are_enough_for_all_workers(num, num_workers):
    rows = in_rows(list(range(num)), num_workers)
    assert [index for row in rows for index in row] == list(range(num))
    assert all(1 <= len(row) <= MOST_AT_ONCE for row in rows)
    assert len(rows) >= min(num, 8 * num_workers)


def test_experiments_go_on_side_by_side_and_none_is_left_out():
    todo = side_by_side([[[0], [1]], [[0, 1], [2, 3], [4, 5], [6]], []])
    assert todo == [(0, [0]), (1, [0, 1]), (1, [2, 3]), (0, [1]), (1, [4, 5]), (1, [6])]


@pytest.mark.slow
def test_logs_that_differ_in_their_tied_durations_are_learned_in_one_call():
    source = Source(SETTING.world, SETTING.layouts, 0, 3)
    episodes = source.play(30)
    logs = [
        (source.cut(episodes, source.cut_rate(share, kind), kind), treatment)
        for share, kind in ((0.2, "independent"), (0.7, "attempt"))
        for treatment in TREATMENTS
    ]
    learned = source.logged(episodes, laws=False).learn(logs, [30])
    assert len(learned) == len(logs)
    assert all(one.policy is one.linear and np.isfinite(one.linear.coefficients).all() for one in learned)
    assert [one.linear.margin is not None for one in learned] == [name == "imputed" for _, name in logs]
    with pytest.raises(ArgumentError, match="this one is imputed; give laws=False"):
        source.logged(episodes).learn(logs, [30])


@pytest.mark.slow
def test_a_batch_is_what_the_estimator_learns_from_the_same_logs():
    source, episodes, cuts, seed = half_cut(SETTING.world, 40)
    learned = source.logged(episodes, laws=False).learn([(cuts, "weighted"), (cuts, "unweighted")], [40])
    logs = to_logs(cuts, "independent", SETTING.scenes)
    for one, censoring in zip(learned, ("kaplan-meier", "none"), strict=True):
        learner = CensoredQLearner.for_table(SETTING.world.horizon, laws=None, censoring=censoring, random_state=seed)
        theirs = learner.fit(logs).policy_
        np.testing.assert_allclose(one.linear.coefficients, theirs.coefficients, rtol=1e-5, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("config", [SETTING.world, replace(FITTED, dirty_share=0.6)], ids=["assumed", "fitted"])
def test_with_laws_it_is_what_the_learner_of_tables_learns_from_the_same_log(config):
    source, episodes, cuts, seed = half_cut(config, 60)
    logs = to_logs(cuts, "independent", SETTING.scenes, config.dirty_share)
    for size, one in zip((30, 60), source.logged(episodes).learn([(cuts, "weighted")], (30, 60)), strict=True):
        learner = CensoredQLearner.for_table(config.horizon, censoring="kaplan-meier", random_state=seed)
        learner.world = config
        theirs = learner.fit(logs.select(logs.trajectory_ids[:size])).assisted_
        assert one.assisted.basis == theirs.basis
        ours, other = ((each.test.p_value, *each.test.z.values()) for each in (one.assisted, theirs))
        assert ours == pytest.approx(other, rel=1e-4, abs=1e-6)
        assert one.assisted.laws.config.grasping == theirs.laws.config.grasping
        if theirs.basis == "model":
            ours, other = (each.policy.excess.coefficients for each in (one, theirs))
            np.testing.assert_allclose(ours, other, rtol=1e-3, atol=1e-4)
        assert one.linear is not one.policy


@pytest.mark.slow
def test_rewards_by_the_control_variate_have_the_mean_of_those_that_were_paid():
    source = Source(SETTING.world, SETTING.layouts, 0, 1)
    policy, num = HEURISTICS[-1].policy(SETTING.world), 4000
    (controlled,), paid = (
        source.control_each([policy], range(num), source.start_value(40_000)),
        source.evaluate(policy, num),
    )
    assert controlled.reward.mean() == pytest.approx(paid.reward.mean(), abs=4 * paid.reward.std() / np.sqrt(num))
    assert controlled.reward.std() < 0.5 * paid.reward.std()
    np.testing.assert_allclose(controlled.robot_s, paid.robot_s, rtol=1e-5)


@pytest.mark.slow
def test_what_is_played_of_some_episodes_is_what_is_played_of_all():
    source = Source(SETTING.world, SETTING.layouts, 0, 1)
    for who in (HEURISTICS[-1], horizon_planner(1, 8)):
        policy = who.policy(SETTING.world)
        (together,), (some,) = (source.control_each([policy], which, 0.0) for which in (range(6), [1, 4, 5]))
        for ours, other in zip(some, together.on([1, 4, 5]), strict=True):
            np.testing.assert_allclose(ours, other, atol=1e-4)


def naive_holm(p_values):
    """By definition: the k-th smallest times how many are not smaller, never below one before it."""
    ranked = sorted(range(len(p_values)), key=lambda i: p_values[i])
    found, largest = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(ranked):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[i]))
        found[i] = largest
    return found


def test_holm_by_its_definition_and_what_was_not_tested_stays_so_and_does_not_count():
    for seed in range(5):
        p_values = np.round(np.random.default_rng(seed).random(12) ** 3, 2)  # rounded, so that some tie
        np.testing.assert_allclose(holm(p_values), naive_holm(p_values))
    np.testing.assert_allclose(holm(np.array([0.01, np.nan, 0.04])), [0.02, np.nan, 0.04])
    rows = pd.DataFrame({"p_value": [0.01, np.nan], "effect": 1.0, "effect_low": 0.0, "effect_high": 2.0})
    assert adjusted(rows, 0.05)["supported"].tolist() == [True, pd.NA]


def test_the_interval_of_a_mean_is_students_and_covers_what_it_says():
    values = np.array([1.0, 2.0, 3.0, 6.0])
    found, ends = over_repetitions(values), tuple(stats.ttest_1samp(values, 0.0).confidence_interval(0.95))
    assert (found.value, found.standard_error) == pytest.approx((3.0, np.sqrt(14 / 3 / 4)))
    assert (found.low, found.high) == pytest.approx(ends)
    drawn = map(over_repetitions, np.random.default_rng(0).normal(size=(1500, 6)))
    assert np.mean([each.low <= 0.0 <= each.high for each in drawn]) == pytest.approx(0.95, abs=0.015)


def test_the_effect_is_the_mean_difference_with_the_interval_of_t_and_more_is_better_or_less_is():
    rng = np.random.default_rng(0)
    other = rng.normal(size=40)
    ours = other + 0.5 + 0.3 * rng.normal(size=40)
    found = better(ours, other, "reward")
    assert found.p_value < 1e-4
    assert better(ours, other, "time").p_value > 0.99
    assert better(other, ours, "time").p_value < 1e-4
    low, high = stats.ttest_rel(ours, other).confidence_interval(0.95)
    effect = found.effect
    assert (effect.value, effect.low, effect.high) == pytest.approx((np.mean(ours - other), low, high))
    nothing = better(other, other, "reward")
    assert (nothing.p_value, nothing.effect.low, nothing.effect.high) == (1.0, 0.0, 0.0)
