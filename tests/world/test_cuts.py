import numpy as np
import pytest
from naive_world import hidden_share

from halfseen.errors import ArgumentError
from halfseen.world.cuts import CUT_KINDS, cut, cut_rate, unit_hazards
from picked import picked

SHARES = (1 / 6, 1 / 3, 1 / 2)


@pytest.mark.parametrize("kind", CUT_KINDS)
@pytest.mark.parametrize("share", SHARES)
def test_the_wanted_share_is_cut(played, played_again, kind, share):
    cuts = cut(played_again, cut_rate(played, share, kind), kind, np.random.default_rng(0))
    num = len(cuts.end_s)
    # The pilot's rate is as noisy as the share itself, hence √2.
    assert abs(np.mean(~cuts.is_finished) - share) < 4.0 * np.sqrt(2.0 * share * (1.0 - share) / num)


@pytest.mark.parametrize("kind", CUT_KINDS)
def test_a_cut_falls_after_what_was_completed_and_before_the_next(played, kind):
    cuts = cut(played, cut_rate(played, 0.5, kind), kind, np.random.default_rng(1))
    elapsed = np.asarray(played.elapsed_s, dtype=float)
    is_taken = np.asarray(played.is_taken)
    num_completed, num_stages = cuts.is_completed.sum(axis=1), is_taken.sum(axis=1)
    rows = np.arange(len(elapsed))
    own_end = elapsed[rows, num_stages - 1]
    assert cuts.end_s[cuts.is_finished] == pytest.approx(own_end[cuts.is_finished], rel=1e-5)
    assert (num_completed[cuts.is_finished] == num_stages[cuts.is_finished]).all()
    was_cut = ~cuts.is_finished
    before = np.where(num_completed > 0, elapsed[rows, np.maximum(num_completed - 1, 0)], 0.0)
    after = elapsed[rows, np.minimum(num_completed, 9)]
    slack_s = 1e-4
    assert (cuts.end_s > before - slack_s)[was_cut].all()
    assert (cuts.end_s < after + slack_s)[was_cut].all()
    # Stages are completed in a row from the first, and of a cut trajectory one more was begun.
    assert (cuts.is_completed[:, 1:] <= cuts.is_completed[:, :-1]).all()
    assert (cuts.is_begun.sum(axis=1) == num_completed + was_cut).all()
    assert (cuts.is_begun <= is_taken).all()
    assert (was_cut & (num_completed == 0)).any(), "some trajectory is cut in its first stage"


def test_the_hazards_are_those_of_the_text(played):
    sample = picked(played, np.s_[:60])
    duration = np.asarray(sample.duration_s, dtype=float)
    expected = {kind: np.zeros(duration.shape) for kind in CUT_KINDS}
    for trajectory, stage in np.argwhere(np.asarray(sample.is_taken)):
        hides = np.asarray(sample.states.hides)[trajectory, stage]
        on_table = np.asarray(sample.states.is_on_table)[trajectory, stage].tolist()
        hidden = [hidden_share(hides, on_table, i) for i in np.flatnonzero(on_table)]
        seconds = duration[trajectory, stage]
        expected["independent"][trajectory, stage] = seconds
        expected["attempt"][trajectory, stage] = seconds**2 / 2.0
        expected["occlusion"][trajectory, stage] = seconds * np.exp(3.0 * np.mean(hidden))
    for kind in CUT_KINDS:
        assert unit_hazards(sample, kind) == pytest.approx(expected[kind], rel=1e-4), kind


def _cuts_per_second(played, kind, is_counted):
    cuts = cut(played, cut_rate(played, 0.5, kind), kind, np.random.default_rng(2))
    duration = np.asarray(played.duration_s, dtype=float)
    is_cut_stage = cuts.is_begun & ~cuts.is_completed
    done_s = np.where(cuts.is_completed, duration, 0.0)
    watched_s = done_s + np.where(is_cut_stage, (cuts.end_s - done_s.sum(axis=1))[:, None], 0.0)
    return is_cut_stage[is_counted].sum() / watched_s[is_counted].sum()


@pytest.mark.parametrize(("kind", "ratio"), [("independent", (0.8, 1.25)), ("occlusion", (2.0, 20.0))])
def test_cuts_follow_occlusion_only_where_they_should(played, kind, ratio):
    clutter = np.broadcast_to((np.arange(len(played.action)) % 3 == 2)[:, None], played.action.shape)
    in_clutter, alone = (_cuts_per_second(played, kind, mask) for mask in (clutter, np.roll(clutter, 1, axis=0)))
    assert ratio[0] < in_clutter / alone < ratio[1]


@pytest.mark.parametrize(("kind", "expected"), [("independent", 1 / 2), ("attempt", 2 / 3)])
def test_the_age_at_which_a_hand_comes(played, kind, expected):
    # At a low rate the age has the hazard's own density: flat, or rising in proportion to the age.
    cuts = cut(played, cut_rate(played, 0.15, kind), kind, np.random.default_rng(3))
    duration = np.asarray(played.duration_s, dtype=float)
    stage = cuts.is_completed.sum(axis=1)[~cuts.is_finished]
    rows = np.flatnonzero(~cuts.is_finished)
    begun = np.where(cuts.is_completed, duration, 0.0).sum(axis=1)[rows]
    share = (cuts.end_s[rows] - begun) / duration[rows, stage]
    assert abs(share.mean() - expected) < 4.0 * share.std() / np.sqrt(len(share)) + 0.01


@pytest.mark.parametrize("kind", CUT_KINDS)
def test_share_zero_cuts_nothing(played, kind):
    rate = cut_rate(played, 0.0, kind)
    cuts = cut(played, rate, kind, np.random.default_rng(4))
    assert rate == 0.0
    assert cuts.is_finished.all()
    assert (cuts.is_completed == np.asarray(played.is_taken)).all()
    assert (cuts.is_begun == cuts.is_completed).all()


@pytest.mark.parametrize("share", [-0.1, 1.0, 1.5, float("nan")])
def test_an_impossible_share_is_refused(played, share):
    with pytest.raises(ArgumentError, match=r"in \[0, 1\)"):
        cut_rate(played, share, "independent")


def test_an_unknown_kind_is_refused_by_name(played):
    with pytest.raises(ArgumentError, match="'sunspots'; it is one of independent, occlusion, attempt"):
        unit_hazards(played, "sunspots")


def test_a_share_that_is_next_to_nothing_is_the_rate_times_the_hazard(played):
    total = unit_hazards(played, "independent").sum(axis=1).mean()
    for share in (1e-300, 1e-20, 1e-14):
        np.testing.assert_allclose(cut_rate(played, share, "independent"), share / total, rtol=0.05)
