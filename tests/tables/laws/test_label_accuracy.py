"""What looks said and washing showed, against the episodes that a log was made from."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_tables import recorded

from fitted_laws import FITTED
from halfseen.tables.laws.labels import labels
from halfseen.world import WorldConfig


@pytest.mark.parametrize("cut_share", [0.0, 0.6])
def test_labels_move_the_log_odds_as_the_law_says_at_the_occlusion_of_the_look(cut_share):
    cuts, logs = recorded(60, cut_share)
    told, config = labels(logs, WorldConfig(), 0.6), WorldConfig()
    states = cuts.episodes.states
    is_on_table, log_odds = np.asarray(states.is_on_table), np.asarray(states.log_odds, dtype=float)
    moved = np.diff(log_odds, axis=1, prepend=np.log(1.5))
    path, stage, target = np.nonzero(is_on_table & cuts.is_begun[:, :, None] & (np.abs(moved) > 1e-4))
    np.testing.assert_array_equal(told.path, path)
    np.testing.assert_array_equal(told.object, 5 * path + target)
    accuracy = config.seeing.accuracy(told.occlusion)
    expected = np.where(told.says_dirty, 1.0, -1.0) * (np.log(accuracy) - np.log1p(-accuracy))
    np.testing.assert_allclose(moved[path, stage, target], expected, atol=1e-4)
    assert (told.occlusion == 0.0).any()


def test_washing_shows_what_an_object_was():
    cuts, logs = recorded(200, 0.3)
    told = labels(logs, WorldConfig(), 0.6)
    is_dirty = np.asarray(cuts.episodes.hidden.is_dirty)[told.path, told.object % 5]
    assert told.was_dirty.any()
    assert told.was_clean.any()
    assert not (told.was_dirty & told.was_clean).any()
    assert is_dirty[told.was_dirty].all()
    assert not is_dirty[told.was_clean].any()
    washed = np.unique(told.object[told.was_dirty | told.was_clean])
    assert len(washed) == num_washed(cuts)


def num_washed(cuts):
    """Objects that a completed WASH before the last step of the horizon put into the dishwasher."""
    is_on_table = np.asarray(cuts.episodes.states.is_on_table)
    # The state after the path's own end is a copy of its last one, so a table that was cleared shows it there.
    last = np.where(cuts.is_completed[:, :-1, None], is_on_table[:, :-1] & ~is_on_table[:, 1:], False)
    return int(last.sum())


def test_a_look_that_shows_nothing_new_is_no_label():
    cuts, logs = recorded(60, config=FITTED)
    told = labels(logs, FITTED, 0.6)
    num_looks = int((np.asarray(cuts.episodes.states.is_on_table) & cuts.is_begun[:, :, None]).sum())
    assert 0 < len(told.path) < 0.7 * num_looks


@pytest.mark.parametrize("cut_share", [0.0, 0.6])
def test_labels_of_a_recorder_who_counts_views_say_what_the_law_says_of_them(cut_share):
    cuts, logs = recorded(60, cut_share, config=FITTED)
    told, law = labels(logs, FITTED, 0.6), FITTED.seeing
    assert told.is_persistent
    np.testing.assert_allclose(
        told.seen_after, law.after(told.occlusion, told.seen, told.says_dirty, told.is_held), atol=1e-6
    )
    assert told.is_held.any()
    assert not told.occlusion[told.is_held].any()
    # What washing showed to be clean had its false alarms, and no more.
    if_dirty, if_clean = law.positive(told.occlusion, told.seen, told.is_held)
    assert (if_dirty > 0.0).all()
    expected = np.where(np.asarray(cuts.episodes.hidden.is_dirty)[told.path, told.object % 5], if_dirty, if_clean)
    excess = told.says_dirty - expected
    assert abs(excess.sum()) < 3.0 * np.sqrt((expected * (1.0 - expected)).sum())


def test_a_recorder_to_whom_each_look_is_news_counts_no_views():
    _, logs = recorded(20)
    told = labels(logs, WorldConfig(), 0.6)
    assert not told.is_persistent
    assert not told.seen.any()


def test_a_look_that_finds_nothing_counts_though_the_recorder_learns_nothing_from_it():
    seeing = replace(FITTED.seeing, sensitivity=(0.0, 0.55, 0.6, 0.95), false_alarms=(0.0, 0.06, 0.1, 0.2))
    flat = replace(FITTED, seeing=seeing)
    _, logs = recorded(60, config=flat)
    told = labels(logs, flat, 0.6)
    is_flat = told.seen_after <= seeing.views[0]
    assert is_flat.any()
    assert not told.says_dirty[is_flat].any()


def test_the_first_paths_tell_what_a_log_of_them_tells():
    _, logs = recorded(40, 0.5)
    some = labels(logs, WorldConfig(), 0.6).first(15)
    alone = labels(logs.select(logs.path_ids[:15]), WorldConfig(), 0.6)
    for one, other in zip(some, alone, strict=True):
        np.testing.assert_array_equal(one, other)
