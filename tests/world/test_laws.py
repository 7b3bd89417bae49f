"""Any law may be the world's; the assumed and fitted ones by their formulas; errors of labels that persist."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import expit, logit

from fitted_laws import FITTED, GRASPING, SEEING
from halfseen.errors import ArgumentError
from halfseen.planners import GreedyPolicy, information_relaxation_bound, solve_table
from halfseen.planners.one_step import table_of
from halfseen.world import (
    ActionSpace,
    AssumedGrasping,
    AssumedSeeing,
    GraspLaw,
    KnownGrasping,
    KnownSeeing,
    SeeingLaw,
    UniformPolicy,
    Verb,
    WorldConfig,
    random,
)
from halfseen.world.rollout import play
from halfseen.world.seeing import is_independent, label_evidence
from halfseen.world.state import pad_scenes
from halfseen.world.transition import start, step
from other_laws import Nudging, Persisting
from picked import picked, repeated
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


def test_an_attempt_may_move_what_it_lifts():
    state, hidden = start(OTHER, picked(pad_scenes([THREE]), 0), random.key_of(0))
    after, hidden, outcome = step(OTHER, state, hidden, np.asarray(LIFT + 1), random.key_of(1))
    expected = THREE.hides.copy()
    expected[1], expected[:, 1] = 0.0, 0.0
    assert np.asarray(after.hides) == pytest.approx(expected)
    assert hidden.grasp_latent["count"].tolist() == [0, 1, 0]
    assert float(outcome.duration_s) == pytest.approx(1.0 + 1.0 + 0.3)
    then, hidden, _ = step(OTHER, after, hidden, np.asarray(0), random.key_of(2))
    assert np.array_equal(then.hides, after.hides)
    assert hidden.grasp_latent["count"].tolist() == [0, 1, 0]


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
    assert hidden.grasp_latent["count"].tolist() == [0, 0, 0]


def test_a_policy_that_needs_no_law_decides_under_any(episodes):
    state = picked(episodes.states, (0, 0))
    with pytest.raises(ArgumentError, match="which planners need"):
        table_of(OTHER, state)
    with pytest.raises(ArgumentError, match="Nudging"):
        GreedyPolicy(OTHER).decide(state, random.key_of(0))
    learned = GreedyPolicy(OTHER, uses_history=True, grasp=EvenChance())
    assert 0 <= int(learned.decide(state, random.key_of(0)).action) <= 3


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


LOOKS = st.lists(st.tuples(st.sampled_from(np.linspace(0.0, 1.0, 11).tolist()), st.booleans()), min_size=1, max_size=5)


def found_by(curve, share):
    return float(np.interp(share, [0.0, *SEEING.views], [0.0, *curve]))


def shown(occluded, is_held):
    return 1.0 if is_held else 0.6 * (1.0 - occluded)


def labels_of(xi, curve, looks):
    """What an object says whose hidden ξ decides: that something is found, once and when it first shows."""
    found = [any(xi < found_by(curve, shown(*look)) for look in looks[: k + 1]) for k in range(len(looks))]
    return tuple(now and not before for before, now in pairwise([False, *found]))


def likelihoods(curve, looks):
    """Of each sequence of labels, by the lengths of the intervals of ξ that make it."""
    ends = sorted({0.0, 1.0, *(found_by(curve, shown(*look)) for look in looks)})
    every = {}
    for low, high in pairwise(ends):
        labels = labels_of((low + high) / 2.0, curve, looks)
        every[labels] = every.get(labels, 0.0) + high - low
    return every


def followed(looks, labels):
    """Probabilities of a sequence of labels if dirty and if clean, and the sum of its evidence, as the law has it."""
    seen, chance, log_odds = 0.0, np.ones(2), 0.0
    for (occluded, is_held), says_dirty in zip(looks, labels, strict=True):
        positive = SEEING.positive(occluded * (not is_held), seen, is_held)
        chance *= [p if says_dirty else 1.0 - p for p in positive]
        log_odds += label_evidence(*positive, says_dirty)
        seen = SEEING.after(occluded * (not is_held), seen, says_dirty, is_held)
    return chance, log_odds


@settings(max_examples=60, deadline=None, derandomize=True)
@given(looks=LOOKS)
def test_labels_are_those_of_a_hidden_trait_that_stays(looks):
    looks = [(occluded * (not is_held), is_held) for occluded, is_held in looks]
    if_dirty, if_clean = (likelihoods(curve, looks) for curve in (SEEING.sensitivity, SEEING.false_alarms))
    assert sum(if_dirty.values()) == pytest.approx(1.0)
    for labels in if_dirty:
        chance, log_odds = followed(looks, labels)
        np.testing.assert_allclose(chance, [if_dirty[labels], if_clean.get(labels, 0.0)], atol=1e-12)
        assert log_odds == pytest.approx(np.log(if_dirty[labels]) - np.log(if_clean[labels]), abs=1e-9)


def test_probabilities_lie_in_range_and_rise_with_the_view():
    for found in SEEING.positive(OCCLUDED, SEEN):
        assert (found >= 0.0).all()
        assert (found < 1.0).all()
        assert (np.diff(found, axis=0) >= 0.0).all()
    assert (SEEING.after(OCCLUDED, SEEN, False) >= SEEN).all()


def test_a_look_that_shows_nothing_new_adds_nothing():
    assert isinstance(SEEING, KnownSeeing)
    assert not is_independent(SEEING)
    for seen, is_held in ((0.6, False), (0.9, False), (1.0, False), (1.0, True)):
        positive = SEEING.positive(0.0, seen, is_held)
        assert positive == (0.0, 0.0)
        assert label_evidence(*positive, False) == 0.0
    assert SEEING.after(0.5, 0.3, True) == 1.0


@pytest.mark.parametrize(
    "curves",
    [((0.4, 0.4, 1.0, 1.0), (0.0, 0.0, 0.0, 0.3)), ((1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 0.0))],
    ids=["flat in part", "nothing in doubt"],
)
def test_no_label_makes_the_truth_certain(curves):
    law = replace(SEEING, sensitivity=curves[0], false_alarms=curves[1])
    for says_dirty in (False, True):
        evidence = label_evidence(*law.positive(np.linspace(0.9, 0.0, 10), np.linspace(0.0, 0.05, 10)), says_dirty)
        assert np.isfinite(evidence).all()
        assert np.abs(evidence).max() < 15.0


curve = partial(replace, SEEING)


def solved(**laws):
    return solve_table(THREE, WorldConfig(**laws), horizon=2)


def bound(**laws):
    return information_relaxation_bound(THREE, WorldConfig(**laws), horizon=2, reveals="everything")


@pytest.mark.parametrize(
    ("make", "options", "message"),
    [
        (curve, {"facing": 0.0}, r"facing is 0\.0"),
        (curve, {"views": (0.5, 0.2, 0.6, 1.0)}, r"views is \(0\.5, .* rising"),
        (curve, {"sensitivity": (0.5, 0.4, 0.6, 0.9)}, "sensitivity is .* never falling"),
        (curve, {"false_alarms": (0.1, 0.2)}, r"false_alarms is \(0\.1, 0\.2\); give .*, one for each of the 4 views"),
        (curve, {"sensitivity": (0.5, 0.6, 0.7, 1.2)}, "sensitivity is"),
        (AssumedSeeing, {"gain": 0.7}, r"floor is 0\.5, gain 0\.7 .* give floor and floor \+ gain in \[0, 1\]"),
        (AssumedSeeing, {"floor": -1.0}, r"floor is -1\.0"),
        (AssumedSeeing, {"power": -1.0}, r"power -1\.0; .* a power of 0 or above"),
        (AssumedGrasping, {"limit_s": 0.0}, r"limit_s of the law is 0\.0; give a finite number, 1e-06 or more"),
        (AssumedGrasping, {"offset_std": -1.0}, r"offset_std of the law is -1\.0; give"),
        (AssumedGrasping, {"log_time": float("nan")}, "log_time of the law is nan; give"),
        (partial(replace, GRASPING), {"log_std": 0.0}, r"log_std of the law is 0\.0; give"),
        (solved, {"grasping": Nudging()}, "grasping of the config is Nudging, which can be sampled but"),
        (solved, {"seeing": Persisting()}, "seeing of the config is Persisting, .* plan with a config"),
        (bound, {"grasping": Nudging()}, "grasping is Nudging, whose times are not known; use 'hidden'"),
    ],
)
def test_numbers_that_make_no_curve_and_laws_that_planners_do_not_know_are_refused(make, options, message):
    with pytest.raises(ArgumentError, match=message):
        make(**options)


def test_an_object_in_the_hand_shows_what_the_table_hid():
    layout = picked(pad_scenes([THREE]), 0)
    keys = random.keys_of(random.key_of(0), 200)
    before, hidden = start(FITTED, repeated(layout, 200), keys)
    after, *_ = step(FITTED, before, hidden, np.full(200, LIFT + 1), random.fold_in(keys, 0))
    is_held = np.asarray(after.attempt_succeeded)[:, 0]
    is_open = (
        is_held & (np.asarray(before.seen) < 1.0).all(axis=1) & (np.asarray(after.seen)[:, [0, 2]] < 1.0).all(axis=1)
    )
    assert is_open.sum() > 5
    np.testing.assert_allclose(np.asarray(before.seen)[is_open] - 0.6 * (1.0 - THREE.occlusion), 0.0, atol=1e-6)
    np.testing.assert_allclose(np.asarray(after.seen)[is_open] - [0.6 * 0.8, 1.0, 0.6 * 0.9], 0.0, atol=1e-6)
    is_news = np.asarray(after.log_odds)[is_open] != np.asarray(before.log_odds)[is_open]
    assert is_news[:, 1].all()
    assert not is_news[:, 2].any()


@pytest.fixture(scope="module")
def played():
    return play(FITTED, pad_scenes([THREE]), UniformPolicy(), random.key_of(1), 4_000)


def test_log_odds_are_what_the_views_so_far_say(played):
    """Of what was not found: prior odds times (1 − sens) / (1 − fp) at all that was seen, however often."""
    seen, log_odds = (np.asarray(leaf, dtype=float) for leaf in (played.states.seen, played.states.log_odds))
    assert (np.diff(seen, axis=1) >= 0.0).all()
    is_open = seen < 1.0
    curves = [
        np.interp(seen, [0.0, *SEEING.views], [0.0, *curve]) for curve in (SEEING.sensitivity, SEEING.false_alarms)
    ]
    expected = logit(0.6) + np.log1p(-curves[0]) - np.log1p(-curves[1])
    np.testing.assert_allclose(log_odds[is_open], expected[is_open], atol=1e-4)
    assert is_open.mean() > 0.2


def test_one_look_is_not_counted_ten_times(played):
    """Among objects of one log-odds, as many are dirty as they say."""
    taken = np.asarray(played.is_taken)
    last = taken.sum(axis=1) - 1
    rows = np.arange(len(last))
    believed = expit(np.asarray(played.states.log_odds, dtype=float)[rows, last])
    is_dirty = np.asarray(played.hidden.is_dirty)
    for low, high in pairwise((0.0, 0.2, 0.4, 0.6, 0.8, 1.0)):
        among = (believed >= low) & (believed < high)
        if among.sum() > 200:
            error = 4.0 * 0.5 / np.sqrt(among.sum())
            assert is_dirty[among].mean() == pytest.approx(believed[among].mean(), abs=error)


@pytest.mark.slow
def test_drawn_labels_say_dirty_as_often_as_the_law_says():
    layout = picked(pad_scenes([THREE]), 0)
    keys = random.keys_of(random.key_of(0), 100_000)
    state, hidden = start(FITTED, repeated(layout, len(keys)), keys)
    says_dirty, is_dirty = state.seen == 1.0, hidden.is_dirty
    for cup, positive in enumerate(np.transpose(SEEING.positive(THREE.occlusion, 0.0))):
        for is_true, expected in zip((True, False), positive, strict=True):
            drawn = says_dirty[is_dirty[:, cup] == is_true, cup]
            assert drawn.mean() == pytest.approx(expected, abs=4.0 * 0.5 / np.sqrt(len(drawn)))
