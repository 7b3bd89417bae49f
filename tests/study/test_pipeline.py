"""Play, cut, treat, learn: the treatments by hand, and the batch against the estimator on the same logs."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from tiny import SETTING

from fitted_laws import FITTED
from halfseen.errors import ArgumentError
from halfseen.learning import CensoredQLearner
from halfseen.planners import POMDPPolicy
from halfseen.study.pipeline import Source, episodes_in_turn
from halfseen.study.policies import COLOURS, HEURISTICS, Kind, horizon_planner, planner
from halfseen.study.runner import MOST_AT_ONCE, in_rows
from halfseen.study.treatments import TREATMENTS, tried_in
from halfseen.tables import attempts
from halfseen.world import Scene, UniformPolicy, WorldConfig, random
from halfseen.world.cuts import CutEpisodes
from halfseen.world.logs import to_logs
from halfseen.world.rollout import play
from halfseen.world.state import pad_scenes

CONFIG = WorldConfig(horizon=3)
FINISH, WASH_0, LIFT_1 = 0, 1, 4


def cut_by_hand(is_cut=True):
    """Five trajectories of two dirty cups: 0 finished; others cut in stage 1 (WASH), 2 (LIFT), 2 (FINISH), 1 (LIFT)."""
    episodes = play(CONFIG, pad_scenes([Scene(np.zeros((2, 2)))]), UniformPolicy(), random.key_of(0), 5)
    there = np.ones((5, 3, 2), dtype=bool)
    there[0, 1:, 0] = there[3, 1:, 0] = False
    action = np.array([[WASH_0, LIFT_1, FINISH], [WASH_0] * 3, [WASH_0, LIFT_1, FINISH], [WASH_0, FINISH, 0], [4] * 3])
    reward = [[5, -0.2, -5], [9, 9, 9], [-1, 9, 9], [5, 9, 9], [9, 9, 9]]
    episodes = replace(
        episodes,
        states=replace(episodes.states, is_on_table=np.asarray(there)),
        action=np.asarray(action),
        reward=np.asarray(reward, dtype=np.float32),
        duration_s=np.full((5, 3), 2.0),
        is_taken=np.ones((5, 3), dtype=bool),
        hidden=replace(episodes.hidden, is_dirty=np.ones((5, 2), dtype=bool)),
    )
    num_completed = np.array([3, 0, 1, 1, 0]) if is_cut else np.full(5, 3)
    stage = np.arange(3)
    is_completed = stage < num_completed[:, None]
    end_s = np.array([6.0, 1.0, 3.0, 3.5, 1.0]) if is_cut else np.full(5, 6.0)
    is_begun = is_completed | (stage == num_completed[:, None])
    return CutEpisodes(episodes, end_s, num_completed == 3, is_completed, is_begun)


def seen(treatment, is_cut=True):
    """Reward, weight and last stages as the learner's regression has them."""
    source = Source(CONFIG, pad_scenes([Scene(np.zeros((2, 2)))]), 0)
    cuts = cut_by_hand(is_cut)
    encoded = source.logged(cuts.episodes)
    trajectories = encoded.lay_out(cuts, treatment).take(slice(5))
    model = encoded.model(treatment)
    weight = model.targets.weights(trajectories, model.targets.fit_cuts(trajectories.clocks))
    return trajectories.reward, weight, trajectories.is_last


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


@pytest.mark.parametrize("treatment", TREATMENTS)
def test_where_nothing_was_cut_all_treatments_are_one(treatment):
    for ours, other in zip(seen(treatment, False), seen("unweighted", False), strict=True):
        np.testing.assert_array_equal(ours, other)


def test_an_unknown_treatment_is_refused_with_those_that_are_known():
    with pytest.raises(ArgumentError, match="'ignored'; it is one of imputed, weighted, unweighted, dropped, failures"):
        seen("ignored")


def test_slow_planners_meet_all_episodes_in_turn():
    assert episodes_in_turn(3, 7, 5) == [0, 1, 2, 3, 4]
    assert [episodes_in_turn(k, 2, 5) for k in range(4)] == [[0, 1], [2, 3], [0, 4], [1, 2]]


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
    source = Source(SETTING.world, SETTING.layouts, 0, 3)
    episodes = source.play(40)
    cuts = source.cut(episodes, source.cut_rate(0.5, "independent"), "independent")
    learned = source.logged(episodes, laws=False).learn([(cuts, "weighted"), (cuts, "unweighted")], [40])
    logs = to_logs(cuts, "independent", SETTING.scenes)
    seed = int(np.random.SeedSequence([0, 3]).generate_state(1)[0])
    for one, censoring in zip(learned, ("kaplan-meier", "none"), strict=True):
        learner = CensoredQLearner.for_table(SETTING.world.horizon, laws=None, censoring=censoring, random_state=seed)
        theirs = learner.fit(logs).policy_
        np.testing.assert_allclose(one.linear.coefficients, theirs.coefficients, rtol=1e-5, atol=1e-6)


def law_test(one):
    return one.test.p_value, *one.test.z.values()


@pytest.mark.slow
@pytest.mark.parametrize("config", [SETTING.world, replace(FITTED, dirty_share=0.6)], ids=["assumed", "fitted"])
def test_with_laws_it_is_what_the_learner_of_tables_learns_from_the_same_log(config):
    source = Source(config, SETTING.layouts, 0, 3)
    episodes = source.play(60)
    cuts = source.cut(episodes, source.cut_rate(0.5, "independent"), "independent")
    logs = to_logs(cuts, "independent", SETTING.scenes, config.dirty_share)
    seed = int(np.random.SeedSequence([0, 3]).generate_state(1)[0])
    for size, one in zip((30, 60), source.logged(episodes).learn([(cuts, "weighted")], (30, 60)), strict=True):
        learner = CensoredQLearner.for_table(config.horizon, censoring="kaplan-meier", random_state=seed)
        learner.world = config
        theirs = learner.fit(logs.select(logs.trajectory_ids[:size])).assisted_
        assert one.assisted.basis == theirs.basis
        assert law_test(one.assisted) == pytest.approx(law_test(theirs), rel=1e-4, abs=1e-6)
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
@pytest.mark.parametrize("kind", ["independent", "attempt"])
def test_the_rates_cut_the_wanted_proportion(kind):
    source = Source(SETTING.world, SETTING.layouts, 0, 4)
    cuts = source.cut(source.play(2000), source.cut_rate(0.5, kind), kind)
    assert cuts.is_finished.mean() == pytest.approx(0.5, abs=0.04)


@pytest.mark.slow
def test_what_is_played_of_some_episodes_is_what_is_played_of_all():
    source = Source(SETTING.world, SETTING.layouts, 0, 1)
    for who in (HEURISTICS[-1], horizon_planner(1, 8)):
        policy = who.policy(SETTING.world)
        together, some = source.evaluate(policy, 6), source.evaluate_some(policy, [1, 4, 5])
        for ours, other in zip(some, together.on([1, 4, 5]), strict=True):
            np.testing.assert_allclose(ours, other, atol=1e-4)


def test_planners_are_planners_and_drawn_as_such():
    for who in (planner(128), horizon_planner(3, 128)):
        assert who.kind == Kind.PLANNER
        assert who.colour == COLOURS[Kind.PLANNER] != COLOURS[Kind.HEURISTIC]
        assert isinstance(who.policy(SETTING.world), POMDPPolicy)
    to_the_end = planner(128).policy(SETTING.world)
    assert (to_the_end.planning_horizon, to_the_end.num_simulations) == (SETTING.world.horizon, 128)


@pytest.mark.parametrize(("num", "num_workers"), [(0, 2), (1, 2), (40, 2), (41, 3), (10_000, 2), (10_000, 1000)])
def test_rows_of_repetitions_hold_each_of_them_once_and_are_enough_for_all_workers(num, num_workers):
    rows = in_rows(list(range(num)), num_workers)
    assert [index for row in rows for index in row] == list(range(num))
    assert all(1 <= len(row) <= MOST_AT_ONCE for row in rows)
    assert len(rows) >= min(num, 8 * num_workers)


@pytest.mark.parametrize("kind", ["independent", "attempt"])
def test_they_are_what_is_read_from_the_log(kind):
    source = Source(SETTING.world, SETTING.layouts, 0, 3)
    cuts = source.cut(source.play(40), source.cut_rate(0.5, kind), kind)
    tried = tried_in(cuts)
    read = attempts(to_logs(cuts, kind, SETTING.scenes), SETTING.world.horizon)
    assert len(tried) > 40
    assert 0 < (~tried["is_finished"]).sum() < len(tried)
    pd.testing.assert_frame_equal(tried.drop(columns="object"), read.drop(columns="object"), check_dtype=False)
    same = (np.equal.outer(each["object"].to_numpy(), each["object"].to_numpy()) for each in (tried, read))
    np.testing.assert_array_equal(*same)
