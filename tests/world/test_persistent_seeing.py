from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import expit, logit

from fitted_laws import FITTED, SEEING
from halfseen.errors import ArgumentError
from halfseen.world import ActionSpace, KnownSeeing, PersistentSeeing, UniformPolicy, Verb, random
from halfseen.world.rollout import play
from halfseen.world.seeing import is_independent, label_evidence
from halfseen.world.state import pad_scenes
from halfseen.world.transition import start, step
from picked import picked, repeated
from world.world_cases import THREE

LOOKS = st.lists(st.tuples(st.sampled_from(np.linspace(0.0, 1.0, 11).tolist()), st.booleans()), min_size=1, max_size=5)
LIFT = ActionSpace(3).of(Verb.LIFT).start


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
        told = labels_of((low + high) / 2.0, curve, looks)
        every[told] = every.get(told, 0.0) + high - low
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


AT = np.linspace(1.0, 0.0, 21)[:, None], np.linspace(0.0, 1.0, 11)
"""Occlusions, and shares that were seen before."""


def test_probabilities_lie_in_range_and_rise_with_the_view():
    for found in SEEING.positive(*AT):
        assert (found >= 0.0).all()
        assert (found < 1.0).all()
        assert (np.diff(found, axis=0) >= 0.0).all()
    assert (SEEING.after(*AT, False) >= AT[1]).all()


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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"facing": 0.0}, r"facing is 0\.0"),
        ({"views": (0.5, 0.2, 0.6, 1.0)}, r"views is \(0\.5, .* rising"),
        ({"sensitivity": (0.5, 0.4, 0.6, 0.9)}, "sensitivity is .* never falling"),
        (
            {"false_alarms": (0.1, 0.2)},
            r"false_alarms is \(0\.1, 0\.2\); give numbers in \[0, 1\], 4 as there are views",
        ),
        ({"sensitivity": (0.5, 0.6, 0.7, 1.2)}, "sensitivity is"),
    ],
)
def test_numbers_that_make_no_curve_are_refused(changes, message):
    with pytest.raises(ArgumentError, match=message):
        replace(SEEING, **changes)


def test_numbers_must_be_given():
    with pytest.raises(TypeError, match="missing"):
        PersistentSeeing()


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
