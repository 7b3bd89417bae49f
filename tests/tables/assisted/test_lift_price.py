"""The price of a LIFT: left as it is where the log agrees, and as LIFTs paid where they take another time."""

from dataclasses import replace

import numpy as np
import pytest
from small_tables import logs_of

from fitted_laws import FITTED
from halfseen.planners.belief import belief_of, expected_attempt_s
from halfseen.tables.encoding import states_alone
from halfseen.tables.law_test import weighted_log, with_lift_price
from halfseen.world import ActionSpace, Verb
from halfseen.world.state import occlusion

HORIZON = FITTED.horizon


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
    seconds = expected_attempt_s(FITTED, occlusion(log.states), belief_of(FITTED, log.states).grip)
    for i, t in np.argwhere(is_lift & (log.weight > 0.0) & ~log.is_last):
        paid += log.weight[i, t] * factor * log.reward[i, t]
        expected += log.weight[i, t] * seconds[i, t, space.target(log.action[i, t])]
    assert found.reward_lift_per_s == pytest.approx(paid / expected, rel=1e-5)


def test_without_lifts_or_without_a_price_nothing_is_scaled(log):
    none = log._replace(weight=np.where(log.action == 0, log.weight, 0.0))
    free = replace(FITTED, reward_lift_per_s=0.0)
    assert with_lift_price(FITTED, none) == (FITTED, None)
    assert with_lift_price(free, log) == (free, None)
