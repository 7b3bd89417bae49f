"""E against loops and rollouts, and that it is worth having; the test of laws; and what LIFTs cost."""

from dataclasses import replace

import numpy as np
import pytest
from small_tables import SCENES, logs_of

from fitted_laws import FITTED
from halfseen.arrays import mapped
from halfseen.learning import CensoredQLearner
from halfseen.planners.belief import expected_attempt_s, grip_posterior
from halfseen.planners.one_step import (
    control_value,
    left_price,
    one_step_q,
    outlook_of,
    rule_and_control,
    setting_of,
    table_of,
)
from halfseen.planners.rollout import sampled_values
from halfseen.tables import AssistedPolicy
from halfseen.tables.assisted import Excess
from halfseen.tables.encoding import states_alone
from halfseen.tables.excess import after_each, features_of, fitted_excess, rows_of
from halfseen.tables.law_test import hotelling_test, residuals_of, weighted_log, with_lift_price
from halfseen.tables.look_ahead import NUM_EXCESS_FEATURES, NUM_OWN, NUM_TABLE, ahead_of
from halfseen.world import ActionSpace, AssumedSeeing, Scene, UniformPolicy, Verb, WorldConfig, random
from halfseen.world.rollout import play
from halfseen.world.state import occlusion, pad_scenes
from halfseen.world.transition import start

LAYOUTS = pad_scenes(SCENES)
CONFIGS = [WorldConfig(), FITTED]


def states_in_play(config, episodes=40):
    played = play(config, LAYOUTS, UniformPolicy(), random.key_of(3), episodes)
    taken = np.nonzero(played.is_taken)
    return mapped(lambda leaf: leaf[taken], played.states)


def ahead_in(config, states):
    return ahead_of(config, table_of(config, states))


@pytest.mark.parametrize("config", CONFIGS)
def test_features_are_finite_and_the_same_alone_in_a_batch_and_with_padding(config):
    states = states_in_play(config)
    all_of, num = ahead_in(config, states), len(states.steps_to_go)
    assert all_of.of_table.shape == (NUM_TABLE, num)
    assert all_of.own.shape == (NUM_OWN, 2, 4, num)
    assert np.isfinite(all_of.own).all()
    assert np.isfinite(all_of.of_table).all()
    for k in range(0, num, 7):
        alone = ahead_in(config, mapped(lambda leaf, k=k: leaf[k], states))
        np.testing.assert_allclose(alone.own, all_of.own[..., k], atol=1e-5)
        np.testing.assert_allclose(alone.of_table, all_of.of_table[..., k], atol=1e-5)
    gone = ~states.is_on_table.T
    assert (all_of.own[:, :, gone] == 0.0).all()


@pytest.mark.parametrize("config", CONFIGS)
def test_nothing_missed_is_the_look_one_step_ahead(config):
    states = states_in_play(config)
    expected = one_step_q(config, states)
    policies = AssistedPolicy(config), AssistedPolicy(config, excess=Excess.none(config.horizon))
    for policy in policies:
        np.testing.assert_allclose(policy.q_values(states), expected, rtol=1e-6)


def test_excess_is_its_coefficients_times_the_features_within_the_range_that_was_fitted():
    rng = np.random.default_rng(0)
    shape = (FITTED.horizon, 2)
    coefficients = rng.normal(size=(*shape, 1 + NUM_EXCESS_FEATURES)).astype(np.float32)
    excess = Excess(coefficients, np.full(shape, -1.0, dtype=np.float32), np.full(shape, 2.0, dtype=np.float32))
    states = states_in_play(FITTED, 6)
    ahead = ahead_in(FITTED, states)
    found = excess(ahead)
    for lane in range(len(states.steps_to_go)):
        for choice in range(8):
            features = features_of(ahead, np.array([choice]), np.array([lane]))[0]
            of_verb = coefficients[states.steps_to_go[lane] - 1, choice // 4]
            value = of_verb[0] + features @ of_verb[1:]
            assert found[choice, lane] == pytest.approx(np.clip(value, -1.0, 2.0), abs=1e-4)


def test_what_is_missed_with_two_steps_to_go_is_what_rollouts_of_the_look_find():
    short = replace(FITTED, horizon=2)
    state, _ = start(short, mapped(lambda leaf: leaf[0], LAYOUTS), random.key_of(5))
    worth = sampled_values(short, state, random.key_of(6), 3000)
    lanes = 6000
    many = mapped(lambda leaf: np.repeat(np.asarray(leaf)[None], lanes, axis=0), state)
    ahead, rng = ahead_in(short, many), np.random.default_rng(0)
    for choice in range(8):
        tried = np.full((1, lanes), choice)
        after = ahead_of(short, after_each(short, ahead, tried, rng))
        rows = rows_of(ahead, tried, np.ones_like(tried, dtype=bool), after)
        found = left_price(short, ahead.table) + ahead.one_step[choice] + rows.beyond
        expected, own = worth[:, 1 + choice], found.std() / np.sqrt(lanes)
        error = np.hypot(own, expected.std() / np.sqrt(len(expected)))
        assert found.mean() == pytest.approx(expected.mean(), abs=4.0 * error + 1e-4)


def test_one_seed_gives_the_same_numbers_again_and_another_others():
    fits = [fitted_excess(FITTED, LAYOUTS, seed, 150) for seed in (1, 1, 2)]
    for name in ("coefficients", "low", "high"):
        one, same, other = (getattr(fit, name) for fit in fits)
        assert one.tobytes() == same.tobytes()
        assert one.tobytes() != other.tobytes()
    assert (fits[0].coefficients[0] == 0.0).all(), "with one step to go nothing is missed"
    assert (fits[0].low <= fits[0].high).all()


@pytest.mark.slow
@pytest.mark.parametrize("config", CONFIGS)
def test_it_earns_more_than_the_look_alone(config):
    from halfseen.planners.control import controlled

    layouts, episodes = LAYOUTS, np.arange(3000)
    excess = fitted_excess(config, layouts, seed=0, num_trajectories=3000)
    key = random.key_of(11)
    with_excess, alone = (
        controlled(config, layouts, policy, key, episodes).reward
        for policy in (AssistedPolicy(config, excess=excess), AssistedPolicy(config))
    )
    gain = with_excess - alone
    assert gain.mean() > 2.0 * gain.std() / np.sqrt(len(gain))


def test_where_all_tables_are_soon_cleared_nothing_is_missed_at_steps_that_none_reaches():
    config = WorldConfig(horizon=10)
    for num_objects in (1, 2):
        scene = Scene(np.zeros((num_objects, num_objects)))
        excess = fitted_excess(config, pad_scenes([scene]), 0, 40)
        assert np.isfinite(excess.coefficients).all()
        assert not excess.coefficients[0].any()


HORIZON = FITTED.horizon


def log_of(episodes, config=FITTED, **options):
    logs = logs_of(episodes, config, **options)
    return weighted_log(logs, states_alone(logs, HORIZON))


@pytest.mark.slow
@pytest.mark.parametrize("config", [WorldConfig(), FITTED])
def test_residuals_are_those_of_a_loop_over_stages(config):
    log = log_of(12, config)
    found = residuals_of(config, log)
    assert (found.weight > 0.0).all()
    assert len(found.residual) == (log.weight > 0.0).sum()
    for k in range(len(found.residual)):
        i, t = found.trajectory[k], found.stage[k]

        def valued(stage, i=i):
            table = table_of(config, mapped(lambda leaf: leaf[i, stage], log.states))
            look = outlook_of(config, table, setting_of((config,), table))
            return table, look, left_price(config, table)

        table, look, left = valued(t)
        values = rule_and_control(config, table, look)[0 if table.steps_to_go == 1 else 1]
        action = log.action[i, t]
        q = left + (0.0 if action == 0 else values[action - 1])
        after = 0.0
        if not log.is_last[i, t]:
            next_table, next_look, next_left = valued(t + 1)
            after = next_left + control_value(next_table, next_look)
        assert found.residual[k] == pytest.approx(log.reward[i, t] + after - q, abs=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("config", [WorldConfig(), FITTED])
def test_right_laws_are_rejected_as_rarely_as_the_level_says(config, monkeypatch):
    # The share that is cut may be a little off; most of the time would go into finding it.
    monkeypatch.setattr("halfseen.world.table_world.NUM_PILOT_TRAJECTORIES", 50)
    p = [hotelling_test(residuals_of(config, log_of(60, config, seed=seed)), 60).p_value for seed in range(100)]
    assert np.mean(np.array(p) < 0.05) < 0.12
    assert 0.3 < np.mean(p) < 0.7


def test_wrong_laws_are_rejected():
    log = log_of(300)
    news = replace(FITTED, seeing=AssumedSeeing(0.5, 0.3, 1.0))
    slippery = replace(FITTED, grasping=replace(FITTED.grasping, log_odds=-1.0))
    assert not hotelling_test(residuals_of(FITTED, log), 300).is_rejected
    for config in (news, slippery):
        found = hotelling_test(residuals_of(config, log), 300)
        assert found.is_rejected
        assert max(abs(z) for z in found.z.values()) > 3.0


def test_few_trajectories_reject_nothing():
    assert hotelling_test(residuals_of(FITTED, log_of(6)), 6).p_value == 1.0


@pytest.mark.slow
def test_the_learner_says_what_it_found_and_what_it_builds_on():
    logs = logs_of(120)
    learner = CensoredQLearner.for_table(HORIZON).fit(logs)
    assert learner.assisted_.basis == "model"
    assert any("does not contradict the laws" in sentence for sentence in learner.chosen_)


@pytest.fixture(scope="module")
def log():
    logs = logs_of(200, FITTED, cut_share=0.5)
    return weighted_log(logs, states_alone(logs, HORIZON))


def test_a_price_with_which_the_log_agrees_is_left_as_it_is(log):
    assert with_lift_price(FITTED, log) == (FITTED, None)


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_lifts_are_priced_as_they_paid(log, factor):
    is_lift = ActionSpace(log.states.num_objects).verb(log.action) == Verb.LIFT
    found, words = with_lift_price(FITTED, log._replace(reward=np.where(is_lift, factor * log.reward, log.reward)))
    assert words is not None
    assert replace(found, reward_lift_per_s=FITTED.reward_lift_per_s) == FITTED
    # By a loop over the log's LIFTs.
    space, paid, expected = ActionSpace(log.states.num_objects), 0.0, 0.0
    seconds = expected_attempt_s(FITTED, occlusion(log.states), grip_posterior(FITTED, log.states))
    for i, t in np.argwhere(is_lift & (log.weight > 0.0) & ~log.is_last):
        paid += log.weight[i, t] * factor * log.reward[i, t]
        expected += log.weight[i, t] * seconds[i, t, space.target(log.action[i, t])]
    assert found.reward_lift_per_s == pytest.approx(paid / expected, rel=1e-5)


def test_without_lifts_or_without_a_price_nothing_is_scaled(log):
    none = log._replace(weight=np.where(log.action == 0, log.weight, 0.0))
    free = replace(FITTED, reward_lift_per_s=0.0)
    assert with_lift_price(FITTED, none) == (FITTED, None)
    assert with_lift_price(free, log) == (free, None)
