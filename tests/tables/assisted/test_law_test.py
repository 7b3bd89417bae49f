"""The test of laws, against a loop, right laws and wrong ones; and the price of a LIFT, as LIFTs paid."""

from dataclasses import replace

import numpy as np
import pytest
from small_tables import logs_of

from fitted_laws import FITTED
from halfseen.arrays import mapped
from halfseen.learning import CensoredQLearner
from halfseen.planners.belief import expected_attempt_s, grip_posterior
from halfseen.planners.one_step import control_value, left_price, outlook_of, rule_and_control, setting_of, table_of
from halfseen.tables.encoding import states_alone
from halfseen.tables.law_test import hotelling_test, residuals_of, weighted_log, with_lift_price
from halfseen.world import ActionSpace, AssumedSeeing, Verb, WorldConfig
from halfseen.world.state import occlusion

HORIZON = FITTED.horizon


def log_of(episodes, config=FITTED, **options):
    logs = logs_of(episodes, config, **options)
    return weighted_log(logs, states_alone(logs, HORIZON))


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
