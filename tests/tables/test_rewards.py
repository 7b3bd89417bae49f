"""Less noise, the same mean: what a WASH pays, what labels say, what ended in a team; and what shaping adds up to."""

from itertools import pairwise

import numpy as np
import pytest

from halfseen.arrays import mapped
from halfseen.censoring import stage_weights
from halfseen.learning import CensoredQLearner, NamedActions
from halfseen.learning.rows import trajectory_arrays
from halfseen.learning.task import Encoded, RewardedStages
from halfseen.planners import GreedyPolicy
from halfseen.tables import TeamTask
from halfseen.tables.encoding import encoded_states
from halfseen.tables.rewards import (
    expected,
    expected_rewards,
    label_control_variates,
    outcomes_of,
    pays_of,
    shaped,
    wash_pay,
)
from halfseen.world import ActionSpace, ExploringPolicy, Scene, TableWorld, Verb, WorldConfig, random
from halfseen.world.cuts import cut, cut_rate
from halfseen.world.logs import to_logs
from halfseen.world.rollout import play
from halfseen.world.state import pad_scenes
from picked import picked
from played_teams import SCENE as TEAM_SCENE
from played_teams import logged, played, team_of

CONFIG = WorldConfig()
SCENE = Scene(np.array([[0.0, 0.5, 0.0], [0.0, 0.0, 0.0], [0.3, 0.3, 0.0]]), name="three")
SPACE = ActionSpace(3)
LOGGER = ExploringPolicy(GreedyPolicy(CONFIG, uses_history=True, counts_penalty=True), 0.5)


@pytest.fixture(scope="module")
def cuts():
    episodes = play(CONFIG, pad_scenes([SCENE]), LOGGER, random.key_of(0), 2000)
    return cut(episodes, cut_rate(episodes, 0.4, "independent"), "independent", np.random.default_rng(0))


@pytest.fixture(scope="module")
def encoded(cuts):
    return encoded_states(cuts.episodes.states, np.asarray(cuts.episodes.action), np.asarray(cuts.episodes.is_taken))


@pytest.fixture(scope="module")
def seen(cuts, encoded):
    return trajectory_arrays(to_logs(cuts, "independent", [SCENE]), encoded, None)


@pytest.fixture(scope="module")
def weight(seen):
    return stage_weights(seen.clocks.elapsed_s, seen.clocks.end_s, seen.clocks.is_finished)


def of_target(values, action):
    target = np.asarray(SPACE.target(action))
    return np.take_along_axis(np.asarray(values), target[..., None], axis=-1)[..., 0]


def reduced(stages):
    return expected_rewards(stages, wash_pay([stages]))


def test_it_finds_what_a_wash_pays(cuts, encoded, seen, weight):
    expected = reduced(RewardedStages(encoded, seen.reward, weight, seen.is_last))
    there = np.asarray(cuts.episodes.states.is_on_table)
    is_wash = SPACE.verb(encoded.action) == Verb.WASH
    used = (weight > 0) & ~seen.is_last & is_wash
    left = ~of_target(np.concatenate([there[:, 1:], there[:, -1:]], axis=1), encoded.action)
    is_dirty = 1.0 / (1.0 + np.exp(-of_target(cuts.episodes.states.log_odds, encoded.action).astype(float)))
    dirty, clean, failed = CONFIG.reward_wash_dirty, CONFIG.reward_wash_clean, CONFIG.reward_wash_failed
    truth = np.where(left, is_dirty * dirty + (1.0 - is_dirty) * clean, failed)
    assert 0.2 < left[used].mean() < 0.8
    np.testing.assert_allclose(expected[used & ~left], failed, atol=1e-6)
    assert np.abs(expected - truth)[used].max() < 1.0 < np.abs(seen.reward - truth)[used].mean()
    assert np.array_equal(expected[~used], seen.reward[~used])


def test_the_weighted_mean_stays_what_it_was(cuts, encoded, seen, weight):
    expected = reduced(RewardedStages(encoded, seen.reward, weight, seen.is_last))
    assert (weight * expected).sum() == pytest.approx((weight * seen.reward).sum(), rel=1e-9)
    flat = reduced(RewardedStages(encoded, seen.reward, (weight > 0) * 1.0, seen.is_last))
    assert np.abs(flat - expected).max() > 1e-4, "the weights must matter"


def parts_of(stages, *ends):
    return [mapped(lambda leaf, at=slice(*at): leaf[at], stages) for at in pairwise((0, *ends))]


def test_parts_find_what_the_whole_does_and_without_a_wash_nothing_changes(encoded, seen, weight):
    stages = RewardedStages(encoded, seen.reward, weight, seen.is_last)
    parts = parts_of(stages, *range(90, len(weight) + 90, 90))
    np.testing.assert_allclose(wash_pay(parts), wash_pay([stages]), rtol=1e-10)
    lifted = encoded._replace(action=np.where(encoded.action > 0, SPACE.encode(Verb.LIFT, 0), 0))
    assert np.array_equal(reduced(stages._replace(encoded=lifted)), seen.reward)


@pytest.mark.slow
def test_q_varies_less_between_logs():
    layouts = pad_scenes([SCENE])
    states = picked(play(CONFIG, layouts, LOGGER, random.key_of(1), 50).states, np.s_[:, 0])
    watched = [TableWorld().simulate([SCENE], LOGGER, episodes=100, seed=seed, cut_share=0.3) for seed in range(6)]

    def spread(reduces_variance):
        learners = [
            CensoredQLearner.for_table(reg=0.1, reduces_variance=reduces_variance).fit(logs) for logs in watched
        ]
        return np.std([learner.policy_.q_values(states) for learner in learners], axis=0).mean()

    assert spread(True) < 0.8 * spread(False)


def test_control_variates_have_mean_zero_whatever_was_done(cuts, encoded, seen):
    variates = label_control_variates(encoded)
    verb = SPACE.verb(encoded.action)
    for one in (Verb.WASH, Verb.LIFT):
        rows = variates[seen.is_completed & ~seen.is_last & (verb == one)]
        assert (rows.std(axis=0) > 0.01).all()
        assert (np.abs(rows.mean(axis=0)) < 4.0 * rows.std(axis=0) / np.sqrt(len(rows))).all()
    first = np.asarray(cuts.episodes.states.log_odds)[:, :2].astype(float)
    lifted = (verb[:, 0] == Verb.LIFT) & seen.is_completed[:, 0] & ~seen.is_last[:, 0]
    moved = np.diff(1.0 / (1.0 + np.exp(-first)), axis=1)[:, 0]
    np.testing.assert_allclose(variates[lifted, 0, 0], moved.sum(axis=1)[lifted], atol=1e-5)
    np.testing.assert_allclose(variates[lifted, 0, 5], of_target(moved, encoded.action[:, 0])[lifted], atol=1e-5)


def test_named_actions_have_no_noise_that_is_known():
    reward = np.ones((4, 2))
    encoded = Encoded(np.zeros((4, 2, 1, 0)), np.ones((4, 2, 1), dtype=bool), np.zeros((4, 2), dtype=int))
    same, variates = NamedActions(["A"]).reduce_variance(RewardedStages(encoded, reward, reward, reward > 1))
    assert same is reward
    assert variates is None


REACH = [[1, 1, 1, 0], [0, 1, 1, 1]]
PRICE = -0.2
TEAM_SPACE = ActionSpace(TEAM_SCENE.num_objects)


def rewarded(trajectories, cut_share=0.0):
    """What the stages of a log paid, as the learner sees them."""
    learner = CensoredQLearner(trajectories.action.shape[1], TeamTask(grasp=None), q_function="linear", stages="pooled")
    logs = logged(trajectories, cut_share)
    model = learner.compose(logs)
    laid = model.lay_out(logs)
    return model.rewarded(laid, np.ones(laid.reward.shape))


@pytest.fixture(scope="module")
def trajectories():
    return played(team_of(2, reward_per_s=PRICE), 300, seed=7, reach=REACH)


def test_what_ended_is_what_the_rewards_say(trajectories):
    action, states = trajectories.action, trajectories.states
    duration_s = np.where(trajectories.is_taken, trajectories.duration_s, 0.0)
    ended = outcomes_of(states, TEAM_SPACE.verb(action), TEAM_SPACE.target(action), duration_s)
    goes_on = trajectories.is_taken[:, 1:]
    failed, lift_s, stage_s, left = (ended[:, :-1, k][goes_on] for k in range(4))
    paid = trajectories.reward[:, :-1][goes_on]
    certain = -failed - 0.1 * lift_s + PRICE * stage_s
    washed = paid - certain
    # A robot without decisions ends before the stage does, and its last LIFT is taken to last as long as the stage.
    spent = (states.robots.decisions_to_go <= 1).any(axis=-1)[:, :-1][goes_on]
    assert {round(float(each), 3) for each in washed[(left == 0) & ~spent]} == {0.0}
    assert {round(float(each), 2) for each in washed[(left == 1) & ~spent]} == {5.0, -10.0}
    assert (left > 0).sum() > 50
    assert (failed > 0).sum() > 50
    assert (lift_s > 0).sum() > 50
    is_early = (TEAM_SPACE.verb(action) == Verb.FINISH)[:, :-1] & goes_on
    assert is_early.sum() > 50, "FINISH of one robot is no end"


def test_prices_of_what_is_certain_are_found_in_the_whole_and_in_parts(trajectories):
    whole = rewarded(trajectories)
    pays = pays_of([whole])
    np.testing.assert_allclose(pays.certain, (-1.0, -0.1, PRICE), atol=0.01)
    # An object that left pays 15 p − 10, and one that is left dirty costs 5; up to the coin that each of them is.
    np.testing.assert_allclose(pays.washed, (-10.0, 15.0), atol=4.0)
    np.testing.assert_allclose(pays.left, (-5.0,), atol=1.0)
    in_parts = np.concatenate(pays_of(parts_of(whole, 90, 300)))
    np.testing.assert_allclose(in_parts, np.concatenate(pays), rtol=1e-9, atol=1e-9)


def test_shaped_rewards_add_up_to_what_was_paid_above_leaving_the_table(trajectories):
    stages = rewarded(trajectories)
    pays = pays_of([stages])
    above = shaped(stages, pays, stages.reward).sum(axis=1)
    left = (1.0 / (1.0 + np.exp(-trajectories.states.log_odds[:, 0]))).sum(axis=1) * pays.left[0]
    np.testing.assert_allclose(above, stages.reward.sum(axis=1) - left, rtol=1e-6, atol=1e-4)


def test_with_less_noise_the_mean_stays(trajectories):
    stages = rewarded(trajectories)
    pays = pays_of([stages])
    plain, reduced = (shaped(stages, pays, reward) for reward in (stages.reward, expected(stages, pays)))
    gap = (reduced - plain).sum(axis=1)
    assert abs(gap.mean()) < 4.0 * gap.std(ddof=1) / np.sqrt(len(gap)) + 1e-9
    is_stage = stages.encoded.outcome[..., :6].any(axis=-1)
    assert reduced[is_stage].std() < 0.9 * plain[is_stage].std()


def test_a_stage_that_was_cut_pays_nothing():
    trajectories = played(team_of(2), 40, seed=9)
    stages = rewarded(trajectories, 0.5)
    pays, cut = pays_of([stages]), stages._replace(weight=np.zeros_like(stages.weight))
    assert not shaped(cut, pays, expected(cut, pays)).any()
