from dataclasses import replace

import numpy as np
import pytest

from fitted_laws import GRASPING, SEEING
from halfseen.errors import ArgumentError
from halfseen.planners import GreedyPolicy, information_relaxation_bound, solve_table
from halfseen.planners.belief import belief_of
from halfseen.world import (
    ActionSpace,
    AssumedGrasping,
    AssumedSeeing,
    GraspLaw,
    KnownGrasping,
    KnownSeeing,
    Scene,
    SeeingLaw,
    UniformPolicy,
    Verb,
    WorldConfig,
    random,
)
from halfseen.world.rollout import play
from halfseen.world.seeing import label_evidence
from halfseen.world.state import pad_scenes
from halfseen.world.transition import start, step
from other_laws import Nudging, Persisting
from picked import picked
from world.world_cases import THREE

OTHER = WorldConfig(grasping=Nudging(), seeing=Persisting(), horizon=6)
LIFT = ActionSpace(3).of(Verb.LIFT).start


class EvenChance:
    def probability(self, state):
        return np.full(state.is_on_table.shape, 0.5)


@pytest.fixture(scope="module")
def episodes():
    return play(OTHER, pad_scenes([THREE]), UniformPolicy(), random.key_of(0), 60)


def test_the_laws_are_what_the_world_takes():
    assert isinstance(WorldConfig().grasping, AssumedGrasping)
    assert isinstance(WorldConfig().seeing, AssumedSeeing)
    for known, law, one in ((KnownGrasping, GraspLaw, Nudging()), (KnownSeeing, SeeingLaw, Persisting())):
        assert isinstance(one, law)
        assert not isinstance(one, known)
    assert isinstance(AssumedGrasping(), KnownGrasping)
    assert isinstance(AssumedSeeing(), KnownSeeing)


# As drawn before the laws stood apart from the world.
GOLDEN_ACTION = [[3, 4, 5, 4], [5, 0, 4, 0], [2, 0, 6, 3], [5, 5, 4, 1]]
GOLDEN_REWARD = [13.209863662719727, -0.13612963259220123, -11.0, -1.6473300457000732]
GOLDEN_S = [28.1484375, 2.3612961769104004, 8.0, 18.675079345703125]
GOLDEN_LOG_ODDS = [0.5303280353546143, 0.40546512603759766, 0.40546518564224243, 0.40546518564224243]


@pytest.mark.slow
def test_the_assumed_laws_draw_what_the_world_always_drew():
    layouts = pad_scenes([THREE, Scene(np.zeros((2, 2)))])
    played = play(WorldConfig(), layouts, UniformPolicy(), random.key_of(5), 4)
    earned = np.where(played.is_taken, played.reward, 0.0)
    assert np.asarray(played.action)[:, :4].tolist() == GOLDEN_ACTION
    assert earned.sum(axis=1) == pytest.approx(GOLDEN_REWARD, rel=1e-5)
    assert np.asarray(played.elapsed_s)[:, -1] == pytest.approx(GOLDEN_S, rel=1e-5)
    assert np.asarray(played.states.log_odds)[:, 1, 0] == pytest.approx(GOLDEN_LOG_ODDS, rel=1e-5)


def test_an_attempt_may_move_what_it_lifts():
    state, hidden = start(OTHER, picked(pad_scenes([THREE]), 0), random.key_of(0))
    after, hidden, outcome = step(OTHER, state, hidden, np.asarray(LIFT + 1), random.key_of(1))
    expected = THREE.hides.copy()
    expected[1], expected[:, 1] = 0.0, 0.0
    assert np.asarray(after.hides) == pytest.approx(expected)
    assert hidden.grasp_trait["count"].tolist() == [0, 1, 0]
    assert float(outcome.duration_s) == pytest.approx(1.0 + 1.0 + 0.3)
    then, hidden, _ = step(OTHER, after, hidden, np.asarray(0), random.key_of(2))
    assert np.array_equal(then.hides, after.hides)
    assert hidden.grasp_trait["count"].tolist() == [0, 1, 0]


def test_the_trajectory_keeps_what_the_laws_did(episodes):
    hides, action = np.asarray(episodes.states.hides), np.asarray(episodes.action)
    moved = np.array(episodes.is_taken)[:, :-1] & np.array(episodes.is_taken)[:, 1:] & (action[:, :-1] >= LIFT)
    trajectory, stage = np.nonzero(moved)
    assert len(trajectory) > 20
    target = action[trajectory, stage] - LIFT
    assert (hides[trajectory, stage + 1, target] == 0.0).all()
    assert (hides[trajectory, stage + 1, :, target] == 0.0).all()


def test_what_is_not_there_cannot_be_held():
    config = replace(OTHER, seeing=AssumedSeeing())
    state, hidden = start(config, picked(pad_scenes([THREE]), 0), random.key_of(3))
    gone = replace(state, is_on_table=np.array([False, True, True]))
    after, hidden, outcome = step(config, gone, hidden, np.asarray(LIFT), random.key_of(4))
    assert not after.attempt_succeeded[0]
    assert float(outcome.duration_s) == 1.0 + Nudging().limit_s
    assert np.array_equal(after.hides, state.hides)
    assert hidden.grasp_trait["count"].tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (WorldConfig(grasping=Nudging()), "grasping of the config is Nudging, a law that can be drawn from but"),
        (WorldConfig(seeing=Persisting()), "seeing of the config is Persisting, .* plan with a config"),
    ],
)
def test_planners_say_which_law_they_do_not_know(config, message):
    with pytest.raises(ArgumentError, match=message):
        solve_table(THREE, config, horizon=2)


def test_a_policy_that_needs_no_law_decides_under_any(episodes):
    state = picked(episodes.states, (0, 0))
    with pytest.raises(ArgumentError, match="planners need them"):
        belief_of(OTHER, state)
    with pytest.raises(ArgumentError, match="Nudging"):
        GreedyPolicy(OTHER).decide(state, random.key_of(0))
    learned = GreedyPolicy(OTHER, uses_history=True, grasp=EvenChance())
    assert 0 <= int(learned.decide(state, random.key_of(0)).action) <= 3


def test_times_are_told_only_of_a_law_that_has_them():
    with pytest.raises(ArgumentError, match="grasping is Nudging, whose times are not known: use 'hidden'"):
        information_relaxation_bound(THREE, WorldConfig(grasping=Nudging()), horizon=2, reveals="everything")


OCCLUDED, OFFSET, SEEN = np.linspace(1.0, 0.0, 21)[:, None], np.array([-2.0, 0.0, 0.7]), np.linspace(0.0, 1.0, 11)


@pytest.mark.parametrize(
    "of",
    [
        *[law.log_failure for law in (AssumedGrasping(), GRASPING)],
        *[law.expected_s for law in (AssumedGrasping(), GRASPING)],
        AssumedGrasping().scale_s,
        lambda occluded, _: AssumedSeeing().accuracy(occluded),
        *[lambda *at, which=which: SEEING.positive(*at)[which] for which in (0, 1)],
        *[lambda *at, says=says: SEEING.after(*at, says) for says in (True, False)],
    ],
)
@pytest.mark.parametrize("other", [OFFSET, SEEN], ids=["offset", "seen"])
def test_formulas_are_the_same_in_single_precision(of, other):
    ours, single = of(OCCLUDED, other), of(OCCLUDED.astype(np.float32), other.astype(np.float32))
    assert (ours.dtype, single.dtype) == (np.float64, np.float32)
    np.testing.assert_allclose(single, ours, rtol=1e-5, atol=2e-6)


def test_the_same_view_tells_nothing_new():
    config = replace(OTHER, seeing=Persisting())
    state, hidden = start(config, picked(pad_scenes([THREE]), 0), random.key_of(3))
    after, hidden, _ = step(config, state, hidden, np.asarray(LIFT), random.key_of(4))
    # Object 0 was held up and seen whole, and no longer hid object 2; object 1 was seen as before.
    assert (after.log_odds != state.log_odds).tolist() == [True, False, True]
    again, _, _ = step(config, after, hidden, np.asarray(LIFT), random.key_of(5))
    assert np.array_equal(again.log_odds, after.log_odds)


@pytest.mark.parametrize("says_dirty", [np.asarray(True), np.array([True, False])])
def test_a_label_that_the_law_does_not_expect_is_no_evidence(says_dirty):
    zero = np.zeros(says_dirty.shape)
    np.testing.assert_array_equal(label_evidence(zero, zero, says_dirty), zero)
