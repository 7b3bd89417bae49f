"""The test of laws: its residuals against a loop, its level under right laws, its power against wrong ones."""

from dataclasses import replace

import numpy as np
import pytest
from small_tables import logs_of

from fitted_laws import FITTED
from halfseen.arrays import mapped
from halfseen.learning import CensoredQLearner
from halfseen.planners.belief import belief_of
from halfseen.planners.one_step import control_value, left_price, outlook_of, rule_and_control, setting_of, table_of
from halfseen.tables.encoding import states_alone
from halfseen.tables.law_test import hotelling_test, residuals_of, weighted_log
from halfseen.world import AssumedSeeing, WorldConfig

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
            table = table_of(belief_of(config, mapped(lambda leaf: leaf[i, stage], log.states)))
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
def test_right_laws_are_rejected_as_rarely_as_the_level_says(config):
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
