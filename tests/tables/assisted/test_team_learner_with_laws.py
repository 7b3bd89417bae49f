"""The learner of teams with laws: what it reads off a log, what it builds on, and what becomes of wrong log-odds."""

from dataclasses import replace

import numpy as np
import pytest
from small_tables import HIDES, PRICES

from fitted_laws import FITTED
from halfseen.errors import ArgumentError
from halfseen.learning import CensoredQLearner
from halfseen.planners import MyopicPolicy, named_policy
from halfseen.planners.futures import future_rewards
from halfseen.tables import TeamLearner
from halfseen.tables import excess as synthetic
from halfseen.tables import learner as learning
from halfseen.tables.assisted import AssistedTeamPolicy, TeamExcess
from halfseen.tables.encoding import layouts_of, team_states
from halfseen.tables.evidence import brought_by, is_plain_look, shown_by_washing
from halfseen.tables.laws import paid_in_team
from halfseen.tables.learner import team_laws
from halfseen.tables.look_ahead import NUM_TEAM_EXCESS_FEATURES, team_described
from halfseen.world import Robot, Scene, TableWorld, random
from halfseen.world.actions import possible_actions
from halfseen.world.rollout import evaluate

PLACES_M = np.array([[-0.3, 0.0], [-0.1, 0.1], [0.1, 0.0], [0.3, 0.1]])
SCENES = [Scene(HIDES, places_m=PLACES_M)]
HORIZON = 4
CONFIG = replace(FITTED, horizon=HORIZON)


def world_of(config=CONFIG, speed=1.0, reward_per_s=-0.05):
    robots = [Robot((-0.6, 0.0), 0.8), Robot((0.6, 0.0), 0.8, speed=speed)]
    return TableWorld(config, robots, reward_per_s=reward_per_s)


def logs_of(world, episodes, cut_share=0.0):
    logger = named_policy("history-penalty", world.played_config, 0.5)
    return world.simulate(SCENES, logger, episodes, seed=0, cut_share=cut_share)


@pytest.fixture(scope="module")
def world():
    return world_of()


@pytest.fixture(scope="module")
def logs(world):
    return logs_of(world, 120, cut_share=0.4)


@pytest.fixture(scope="module")
def states(world):
    config, layouts = world.played_config, world.team.layouts(SCENES)
    return synthetic.visited(config, layouts, 0, 40)


@pytest.mark.parametrize("reward_per_s", [0.0, -0.07])
def test_prices_times_and_speeds_are_read_off_the_log_of_a_team(reward_per_s):
    logs = logs_of(world_of(replace(CONFIG, **PRICES), 1.25, reward_per_s), 150)
    found = paid_in_team(logs, team_states(logs, 2 * HORIZON))
    assert {name: getattr(found, name) for name in PRICES} == pytest.approx(PRICES, rel=1e-3)
    assert found.reward_per_s == pytest.approx(reward_per_s, abs=1e-5)
    assert found.speed == pytest.approx((1.0, 1.25), rel=1e-3)
    assert found.grasping.limit_s == pytest.approx(FITTED.grasping.limit_s, rel=0.05)


def test_looks_count_where_nobody_is_at_an_object(logs):
    states = team_states(logs, 2 * HORIZON)
    is_plain = is_plain_look(states)
    assert is_plain[:, 0].all()
    at_work = (states.robots.is_busy & np.isin(states.robots.verb, (1, 2))).any(axis=-1)
    assert not (is_plain & at_work).any()
    assert 0 < is_plain[:, 1:].sum() < is_plain[:, 1:].size


def test_washing_shows_what_was_dirty(world):
    logs = logs_of(world, 60)
    brought = brought_by(logs, team_states(logs, 2 * HORIZON))
    dirty, clean = shown_by_washing(brought, world.played_config)
    assert dirty.sum() > 20
    assert clean.sum() > 0
    assert not (dirty & clean).any()
    assert dirty.shape[-1] == len(HIDES)


def test_the_laws_of_a_right_recorder_are_read_and_not_rejected(logs, world):
    laws = team_laws(logs, team_states(logs, 2 * HORIZON))
    config = laws.config
    assert "read from the log-odds of the log" in laws.sentence
    views = np.linspace(0.05, 1.0, 8)
    found, true = config.seeing.found_by(views), world.config.seeing.found_by(views)
    assert np.abs(np.asarray(found) - np.asarray(true)).max() < 0.05


def test_it_learns_with_laws_unless_something_is_said_of_linear_q():
    assert isinstance(CensoredQLearner.for_team(2), TeamLearner)
    for said in ({"laws": None}, {"reg": 0.1}, {"base": None}, {"pessimism": 0.0}):
        assert type(CensoredQLearner.for_team(2, **said)) is CensoredQLearner
    with pytest.raises(ArgumentError, match="laws is 'some'; give 'auto', or None"):
        CensoredQLearner.for_team(2, laws="some")


@pytest.mark.slow
def test_a_learned_policy_follows_the_myopic_look_and_what_it_misses(logs, monkeypatch):
    monkeypatch.setattr(learning, "fitted_team_excess", lambda config, layouts, seed: TeamExcess.none())
    learner = CensoredQLearner.for_team(2, HORIZON, censoring="kaplan-meier").fit(logs)
    assert learner.assisted_.basis == learning.MODEL
    assert learner.policy_.num_robots == 2
    assert not learner.assisted_.test.is_rejected
    assert any("the log does not contradict the laws" in said for said in learner.chosen_)
    states = team_states(logs, 2 * HORIZON)
    q = learner.policy_.q_values(states)
    is_stage = states.is_on_table.any(axis=-1)
    np.testing.assert_array_equal((q > -np.inf)[is_stage], possible_actions(states)[is_stage])


@pytest.mark.slow
def test_log_odds_that_are_too_sure_of_themselves_are_not_relied_upon(logs):
    logs = logs.select(logs.trajectory_ids[:80])
    objects = logs.objects.copy()
    prior = float(np.log(0.6 / 0.4))
    objects["log_odds"] = prior + 4.0 * (objects["log_odds"] - prior)
    wrong = type(logs)(logs.stages, logs.trajectories, objects)
    learner = CensoredQLearner.for_team(2, HORIZON, censoring="kaplan-meier").fit(wrong)
    assert learner.assisted_.basis == learning.LINEAR
    assert learner.policy_ is learner.linear_policy_
    assert any("the log contradicts the laws" in said for said in learner.chosen_)


def test_a_second_that_costs_nothing_is_counted_all_the_same(world):
    assert synthetic.counting_time(world.played_config, 0.2).reward_per_s == -0.05
    assert synthetic.counting_time(replace(world.played_config, reward_per_s=0.0), 0.02).reward_per_s == -0.02


def test_e_is_cautious_of_all_but_the_myopic_action_and_makes_no_more_of_waiting(states, world):
    drawn = np.random.default_rng(0).normal(size=NUM_TEAM_EXCESS_FEATURES).astype(np.float32)
    q = MyopicPolicy(world.played_config).q_values(states)
    excess = TeamExcess(drawn, -0.5, 0.5, caution=0.2)(states, q)
    best = q.argmax(axis=-1)[:, None]
    np.testing.assert_array_equal(np.take_along_axis(excess, best, axis=-1), 0.0)
    others = np.where(np.arange(q.shape[-1]) == best, -0.2, excess)
    assert others.min() >= -0.7001
    assert others.max() <= 0.3001
    assert others[:, -1].max() <= -0.2 + 1e-6
    np.testing.assert_array_equal(
        AssistedTeamPolicy(world.played_config).q_values(states), MyopicPolicy(world.played_config).q_values(states)
    )


def test_what_is_tried_has_the_best_first_and_only_what_is_possible(states, world):
    q = MyopicPolicy(world.played_config).q_values(states)
    is_tried, order = synthetic.drawn(q, random.fold_in(random.key_of(1), np.arange(len(q))))
    np.testing.assert_array_equal(order[:, 0], q.argmax(axis=-1))
    assert not (is_tried & (q == -np.inf)).any()
    num_possible = (q > -np.inf).sum(axis=-1)
    np.testing.assert_array_equal(is_tried.sum(axis=-1), np.minimum(num_possible, synthetic.NUM_TRIED))


def test_futures_of_what_is_tried_are_those_of_all(states, world):
    config, key = world.played_config, random.fold_in(random.key_of(5), np.arange(40))
    base = MyopicPolicy(config)
    every = future_rewards(config, states, base, key, 2)
    is_tried, _ = synthetic.drawn(base.q_values(states), key)
    some = future_rewards(config, states, base, key, 2, is_tried)
    np.testing.assert_allclose(
        some[np.broadcast_to(is_tried[:, None], some.shape)], every[is_tried[:, None] & (every > -np.inf)], rtol=1e-5
    )
    assert (some[np.broadcast_to(~is_tried[:, None], some.shape)] == -np.inf).all()


def test_a_row_is_what_an_action_did_better_than_the_myopic_one(states, world):
    config, key = world.played_config, random.fold_in(random.key_of(5), np.arange(40))
    described, beyond = synthetic.team_simulated(config, states, key, 3)
    future_key, try_key = random.split(key)
    base = MyopicPolicy(config)
    q = base.q_values(states)
    reward, features = future_rewards(config, states, base, future_key, 3), team_described(states, q)
    is_tried, _ = synthetic.drawn(q, try_key)
    row = 0
    for k in range(len(q)):
        best = q[k].argmax()
        for action in np.flatnonzero(is_tried[k]):
            if action == best:
                continue
            gained = reward[k, :, action].mean() - reward[k, :, best].mean() - (q[k, action] - q[k, best])
            assert beyond[row] == pytest.approx(gained, abs=1e-3)
            np.testing.assert_allclose(described[row], features[k, action] - features[k, best], atol=1e-5)
            row += 1
    assert row == len(beyond)


def test_layouts_are_the_tables_with_which_trajectories_begin(logs):
    layouts = layouts_of(team_states(logs, 2 * HORIZON))
    assert len(layouts.hides) == logs.num_trajectories
    np.testing.assert_allclose(layouts.hides[0], HIDES, atol=1e-6)


@pytest.mark.slow
def test_e_earns_more_than_the_myopic_look_where_time_costs(world):
    config, layouts = world.played_config, world.team.layouts(SCENES)
    excess = synthetic.fitted_team_excess(config, layouts, 0)
    with_e, without = (
        evaluate(config, layouts, AssistedTeamPolicy(config, each), random.key_of(3), 8000).reward
        for each in (excess, None)
    )
    gain = with_e - without
    assert gain.mean() > 2.0 * gain.std(ddof=1) / np.sqrt(len(gain))
