"""Many tables played to their end, and cut: by their hazards, at the share that is wanted."""

import numpy as np
import pytest
from naive_world import hidden_share

from halfseen.arrays import expit, mapped
from halfseen.errors import ArgumentError
from halfseen.world import ActionSpace, ExploringPolicy, UniformPolicy, WorldConfig, random, rollout
from halfseen.world.cuts import CUT_KINDS, cut, cut_rate, unit_hazards
from halfseen.world.rollout import evaluate, evaluate_each, evaluate_some, play
from halfseen.world.state import pad_scenes
from halfseen.world.transition import start, step
from picked import leaves_of, picked, repeated
from world.world_cases import InTurn, Suspicious

CONFIG, KEY = WorldConfig(), random.key_of(1)


def same(left, right):
    return all(
        np.array_equal(one, other, equal_nan=True) for one, other in zip(leaves_of(left), leaves_of(right), strict=True)
    )


@pytest.fixture(scope="module")
def in_turn(scenes):
    return play(CONFIG, pad_scenes(scenes[2:]), InTurn(), KEY, 64)


def test_padding_poisoned_with_anything_changes_nothing(scenes, in_turn):
    layout = pad_scenes(scenes[2:], num_objects=10)
    padded, *others = (
        play(CONFIG, mapped(lambda leaf, of=of: np.nan_to_num(leaf, nan=of), layout), InTurn(), KEY, 64)
        for of in (np.nan, 1e30, 0.5)
    )
    assert all(same(padded, other) for other in others)
    wide, narrow = ActionSpace(10), ActionSpace(5)
    assert np.array_equal(wide.verb(padded.action), narrow.verb(in_turn.action))
    assert np.array_equal(wide.target(padded.action), narrow.target(in_turn.action))
    for name in ("reward", "duration_s", "is_taken", "elapsed_s"):
        assert np.array_equal(getattr(padded, name), getattr(in_turn, name)), name
    for name in ("is_on_table", "lifts"):
        assert np.array_equal(getattr(padded.states, name)[..., :5], getattr(in_turn.states, name)), name
    # A product over ten factors of which five are 1 may round otherwise than one over five.
    assert padded.states.log_odds[..., :5] == pytest.approx(in_turn.states.log_odds, abs=1e-5)
    assert not padded.states.is_on_table[..., 5:].any()


def test_a_batch_is_a_loop(scenes):
    layouts = pad_scenes(scenes)
    batch = play(CONFIG, layouts, InTurn(), KEY, 6)
    for k in range(6):
        start_key, world_key, policy_key = random.split(random.fold_in(KEY, k), 3)
        state, hidden = start(CONFIG, picked(layouts, k % 3), start_key)
        for t in range(batch.is_taken[k].sum()):
            assert same(state, picked(batch.states, (k, t)))
            action = InTurn().decide(state, policy_key).action
            state, hidden, outcome = step(CONFIG, state, hidden, action, random.fold_in(world_key, t))
            assert batch.is_taken[k, t]
            assert batch.action[k, t] == action
            assert batch.reward[k, t] == pytest.approx(float(outcome.reward), rel=1e-6)
        assert outcome.is_over


def test_one_seed_same_bytes_and_the_global_seed_changes_nothing(scenes, in_turn):
    np.random.seed(12345)  # noqa: NPY002
    expected = np.random.RandomState(12345).get_state()[1]
    again = play(CONFIG, pad_scenes(scenes[2:]), InTurn(), KEY, 64)
    assert np.array_equal(np.random.get_state()[1], expected)  # noqa: NPY002
    assert same(again, in_turn)
    assert not same(play(CONFIG, pad_scenes(scenes[2:]), InTurn(), random.key_of(2), 64), in_turn)


@pytest.mark.parametrize("batch", [24, 512])
def test_in_any_batch_the_same_is_played_and_the_totals_are_of_it(scenes, in_turn, monkeypatch, batch):
    monkeypatch.setattr(rollout, "BATCH", batch)
    args = CONFIG, pad_scenes(scenes[2:]), InTurn(), KEY
    in_batches, is_taken = play(*args, 64), in_turn.is_taken
    assert np.array_equal(in_batches.is_taken, is_taken)
    for name in ("action", "probability", "reward", "duration_s"):
        assert np.array_equal(getattr(in_batches, name)[is_taken], getattr(in_turn, name)[is_taken]), name
    totals, some = evaluate(*args, 64), evaluate_some(*args, np.array([40, 3]))
    assert totals.reward == pytest.approx(np.where(is_taken, in_turn.reward, 0.0).sum(axis=1), rel=1e-5, abs=1e-4)
    assert totals.robot_s == pytest.approx(in_turn.elapsed_s[:, -1], rel=1e-5)
    assert np.array_equal(totals.num_steps, is_taken.sum(axis=1))
    assert some.reward == pytest.approx(totals.reward[[40, 3]], rel=1e-5, abs=1e-4)
    assert some.num_steps.tolist() == totals.num_steps[[40, 3]].tolist()


@pytest.mark.parametrize("at_once", [1, 64, 1000])
def test_side_by_side_policies_earn_what_each_does_alone(scenes, at_once, monkeypatch):
    monkeypatch.setattr(rollout, "SIDE_BY_SIDE", at_once)
    args, policies = (CONFIG, pad_scenes(scenes[2:])), [InTurn(), Suspicious(), UniformPolicy()]
    side_by_side = evaluate_each(*args, policies, KEY, 30)
    alone = [evaluate(*args, policy, KEY, 30) for policy in policies]
    assert all(same(*pair) for pair in zip(side_by_side, alone, strict=True))


@pytest.fixture(scope="module")
def suspicious(scenes):
    return play(CONFIG, pad_scenes(scenes), Suspicious(), random.key_of(7), 300)


def test_policies_meet_the_same_world(played, suspicious):
    assert same(suspicious.hidden, picked(played.hidden, np.s_[:300]))
    assert not np.array_equal(suspicious.action, played.action[:300])


def believed_and_dirty(episodes, stage):
    """Of each object that there is in a stage, what is believed and what is true."""
    alive = episodes.is_taken[:, stage]
    is_object = episodes.states.is_object[alive, stage]
    believed = expit(episodes.states.log_odds.astype(float)[alive, stage][is_object])
    return believed, episodes.hidden.is_dirty[alive][is_object]


@pytest.mark.parametrize("stage", [0, 3, 6])
def test_among_objects_believed_dirty_with_x_a_share_x_is(played, stage):
    believed, dirty = believed_and_dirty(played, stage)
    bins = np.digitize(believed, [0.3, 0.5, 0.7, 0.9])
    for k in np.unique(bins):
        inside = believed[bins == k]
        error = np.sqrt((inside * (1.0 - inside)).sum()) / len(inside)
        assert abs(dirty[bins == k].mean() - inside.mean()) < 4.0 * error
    assert len(np.unique(bins)) >= 3


def test_a_policy_that_chooses_by_belief_does_not_spoil_it(suspicious):
    believed, dirty = believed_and_dirty(suspicious, 4)
    assert len(dirty) > 300
    assert abs(dirty.mean() - believed.mean()) < 4.0 * np.sqrt((believed * (1 - believed)).sum()) / len(dirty)


def test_the_clock_runs_and_a_trajectory_ends_once(played):
    is_taken = played.is_taken
    assert is_taken[:, 0].all()
    assert (is_taken[:, 1:] <= is_taken[:, :-1]).all()
    assert (np.diff(played.elapsed_s, axis=1)[is_taken[:, 1:]] > 0).all()
    assert set(is_taken.sum(axis=1)) >= {1, 2, 5, 10}


@pytest.fixture(scope="module")
def first(scenes):
    return start(CONFIG, picked(pad_scenes(scenes), 1), random.key_of(0))[0]


def test_the_logged_probability_is_that_of_the_action(first):
    num_draws = 20_000
    policy = ExploringPolicy(Suspicious(), random_share=0.3)
    action, said = policy.decide(repeated(first, num_draws), random.keys_of(random.key_of(2), num_draws))
    count = np.bincount(action, minlength=11)
    taken = np.flatnonzero(count)
    assert taken.tolist() == [0, 1, 2, 3, 6, 7, 8]
    probability = np.array([said[action == code][0] for code in taken])
    assert all(np.ptp(said[action == code]) == 0.0 for code in taken)
    assert probability.sum() == pytest.approx(1.0, abs=1e-6)
    assert sorted(probability)[-1] == pytest.approx(0.7 + 0.3 / 7, abs=1e-6)
    error = np.sqrt(probability * (1.0 - probability) / num_draws)
    assert np.all(np.abs(count[taken] / num_draws - probability) < 4.0 * error)


def test_the_ends_of_exploring(first):
    base = Suspicious().decide(first, random.key_of(0))
    keys = random.keys_of(random.key_of(2), 200)
    never, always = (ExploringPolicy(Suspicious(), share).decide(repeated(first, 200), keys) for share in (0.0, 1.0))
    assert (never.action == int(base.action)).all()
    assert (never.probability == 1.0).all()
    assert len(np.unique(always.action)) == 7
    assert always.probability == pytest.approx(1.0 / 7)
    assert float(UniformPolicy().decide(first, random.key_of(0)).probability) == pytest.approx(1.0 / 7)


@pytest.mark.parametrize("share", [-0.1, 2.0, float("nan")])
def test_a_share_of_random_decisions_lies_between_0_and_1(share):
    with pytest.raises(ArgumentError, match=rf"random_share is {share}; give the share .*, in \[0, 1\]"):
        ExploringPolicy(Suspicious(), share)


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
    with pytest.raises(ArgumentError, match="'sunspots'; give one of independent, occlusion, attempt"):
        unit_hazards(played, "sunspots")


def test_a_share_that_is_next_to_nothing_is_the_rate_times_the_hazard(played):
    total = unit_hazards(played, "independent").sum(axis=1).mean()
    for share in (1e-300, 1e-20, 1e-14):
        np.testing.assert_allclose(cut_rate(played, share, "independent"), share / total, rtol=0.05)
