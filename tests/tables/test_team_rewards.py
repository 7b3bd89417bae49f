"""Rewards that eq. 3 runs on: what was paid, measured from leaving the table, with less noise."""

import numpy as np
import pytest

from halfseen.arrays import mapped
from halfseen.learning import CensoredQLearner
from halfseen.tables import TeamTask
from halfseen.tables.rewards import expected, outcomes_of, pays_of, shaped
from halfseen.world.actions import ActionSpace, Verb
from played_teams import SCENE, logged, played, team_of

REACH = [[1, 1, 1, 0], [0, 1, 1, 1]]
PRICE = -0.2
SPACE = ActionSpace(SCENE.num_objects)


def rewarded(paths, cut_share=0.0):
    """What the stages of a log paid, as the learner sees them."""
    learner = CensoredQLearner(paths.action.shape[1], TeamTask(grasp=None), q_function="linear", stages="pooled")
    logs = logged(paths, cut_share)
    model = learner.compose(logs)
    laid = model.lay_out(logs)
    return model.rewarded(laid, np.ones(laid.reward.shape))


@pytest.fixture(scope="module")
def paths():
    return played(team_of(2, reward_per_s=PRICE), 300, seed=7, reach=REACH)


def test_what_ended_is_what_the_rewards_say(paths):
    action, states = paths.action, paths.states
    duration_s = np.where(paths.is_taken, paths.duration_s, 0.0)
    ended = outcomes_of(states, SPACE.verb(action), SPACE.target(action), duration_s)
    goes_on = paths.is_taken[:, 1:]
    failed, lift_s, stage_s, left = (ended[:, :-1, k][goes_on] for k in range(4))
    paid = paths.reward[:, :-1][goes_on]
    certain = -failed - 0.1 * lift_s + PRICE * stage_s
    washed = paid - certain
    # A robot without decisions ends before the stage does, and its last LIFT is taken to last as long as the stage.
    spent = (states.robots.decisions_to_go <= 1).any(axis=-1)[:, :-1][goes_on]
    assert {round(float(each), 3) for each in washed[(left == 0) & ~spent]} == {0.0}
    assert {round(float(each), 2) for each in washed[(left == 1) & ~spent]} == {5.0, -10.0}
    assert (left > 0).sum() > 50
    assert (failed > 0).sum() > 50
    assert (lift_s > 0).sum() > 50


def test_prices_of_what_is_certain_are_found(paths):
    pays = pays_of([rewarded(paths)])
    np.testing.assert_allclose(pays.certain, (-1.0, -0.1, PRICE), atol=0.01)
    # An object that left pays 15 p − 10, and one that is left dirty costs 5; up to the coin that each of them is.
    np.testing.assert_allclose(pays.washed, (-10.0, 15.0), atol=4.0)
    np.testing.assert_allclose(pays.left, (-5.0,), atol=1.0)


def test_parts_of_a_log_tell_the_same_prices(paths):
    whole = rewarded(paths)
    parts = [mapped(lambda leaf, at=at: leaf[at], whole) for at in (slice(0, 90), slice(90, 300))]
    np.testing.assert_allclose(np.concatenate(pays_of(parts)), np.concatenate(pays_of([whole])), rtol=1e-9, atol=1e-9)


def test_shaped_rewards_add_up_to_what_was_paid_above_leaving_the_table(paths):
    stages = rewarded(paths)
    pays = pays_of([stages])
    above = shaped(stages, pays, stages.reward).sum(axis=1)
    left = (1.0 / (1.0 + np.exp(-paths.states.log_odds[:, 0]))).sum(axis=1) * pays.left[0]
    np.testing.assert_allclose(above, stages.reward.sum(axis=1) - left, rtol=1e-6, atol=1e-4)


def test_with_less_noise_the_mean_stays(paths):
    stages = rewarded(paths)
    pays = pays_of([stages])
    plain, reduced = (shaped(stages, pays, reward) for reward in (stages.reward, expected(stages, pays)))
    gap = (reduced - plain).sum(axis=1)
    assert abs(gap.mean()) < 4.0 * gap.std(ddof=1) / np.sqrt(len(gap)) + 1e-9
    is_stage = stages.encoded.outcome[..., :6].any(axis=-1)
    assert reduced[is_stage].std() < 0.9 * plain[is_stage].std()


def test_a_stage_that_was_cut_pays_nothing():
    paths = played(team_of(2), 40, seed=9)
    stages = rewarded(paths, 0.5)
    pays, cut = pays_of([stages]), stages._replace(weight=np.zeros_like(stages.weight))
    assert not shaped(cut, pays, expected(cut, pays)).any()


def test_finish_of_one_robot_is_no_end(paths):
    is_early = (SPACE.verb(paths.action) == Verb.FINISH)[:, :-1] & paths.is_taken[:, 1:]
    assert is_early.sum() > 50
