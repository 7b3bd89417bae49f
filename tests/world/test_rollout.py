import numpy as np
import pytest
from worlds import InTurn, Suspicious, random_scene

from halfseen.arrays import mapped
from halfseen.errors import ArgumentError
from halfseen.world import ExploringPolicy, UniformPolicy, WorldConfig, random, rollout
from halfseen.world.actions import ActionSpace
from halfseen.world.rollout import evaluate, evaluate_each, evaluate_some, play
from halfseen.world.state import pad_scenes
from halfseen.world.transition import start, step
from picked import leaves_of, picked, repeated

CONFIG = WorldConfig()


def same(left, right):
    return all(
        np.array_equal(one, other, equal_nan=True) for one, other in zip(leaves_of(left), leaves_of(right), strict=True)
    )


@pytest.fixture(scope="module")
def in_turn(scenes):
    return play(CONFIG, pad_scenes(scenes[2:]), InTurn(), random.key_of(1), 64)


def test_padding_poisoned_with_nan_changes_nothing(scenes, in_turn):
    padded = play(CONFIG, pad_scenes(scenes[2:], num_objects=10), InTurn(), random.key_of(1), 64)
    wide, narrow = ActionSpace(10), ActionSpace(5)
    assert np.array_equal(wide.verb(padded.action), narrow.verb(in_turn.action))
    assert np.array_equal(wide.target(padded.action), narrow.target(in_turn.action))
    for name in ("reward", "duration_s", "is_taken", "elapsed_s"):
        assert np.array_equal(getattr(padded, name), getattr(in_turn, name)), name
    for name in ("is_on_table", "lifts"):
        assert np.array_equal(getattr(padded.states, name)[..., :5], getattr(in_turn.states, name)), name
    # A product over ten factors of which five are 1 may round otherwise than one over five.
    assert np.asarray(padded.states.log_odds)[..., :5] == pytest.approx(np.asarray(in_turn.states.log_odds), abs=1e-5)
    assert not np.asarray(padded.states.is_on_table)[..., 5:].any()


def test_padding_holds_whatever_it_likes(scenes, in_turn):
    layout = pad_scenes(scenes[2:], num_objects=10)
    poisons = (np.nan, 1e30, 0.5)
    poisoned = [
        play(
            CONFIG,
            mapped(lambda leaf, poison=poison: np.nan_to_num(leaf, nan=poison), layout),
            InTurn(),
            random.key_of(1),
            64,
        )
        for poison in poisons
    ]
    assert same(poisoned[0], poisoned[1])
    assert same(poisoned[0], poisoned[2])


def test_a_batch_is_a_loop(scenes):
    key = random.key_of(1)
    batch = play(CONFIG, pad_scenes(scenes), InTurn(), key, 6)
    layouts = pad_scenes(scenes)
    for k in range(6):
        start_key, world_key, policy_key = random.split(random.fold_in(key, k), 3)
        layout = picked(layouts, k % 3)
        state, hidden = start(CONFIG, layout, start_key)
        for t in range(10):
            assert same(state, picked(batch.states, (k, t)))
            action = InTurn().decide(state, policy_key).action
            state, hidden, outcome = step(CONFIG, state, hidden, action, random.fold_in(world_key, t))
            assert bool(batch.is_taken[k, t])
            assert int(batch.action[k, t]) == int(action)
            assert float(batch.reward[k, t]) == pytest.approx(float(outcome.reward), rel=1e-6)
            if outcome.is_over:
                assert not np.asarray(batch.is_taken)[k, t + 1 :].any()
                break
        else:
            raise AssertionError("a path outlived the horizon")


def test_other_members_of_a_batch_do_not_leak_in(scenes):
    others = [random_scene(4, 5), scenes[1], random_scene(2, 6)]
    here = play(CONFIG, pad_scenes(scenes), InTurn(), random.key_of(1), 6)
    there = play(CONFIG, pad_scenes(others, num_objects=5), InTurn(), random.key_of(1), 6)
    assert same(picked(here, np.s_[1::3]), picked(there, np.s_[1::3]))
    assert not same(here, there)


def test_one_seed_same_bytes_and_the_global_seed_changes_nothing(scenes, in_turn):
    np.random.seed(12345)  # noqa: NPY002
    expected = np.random.RandomState(12345).get_state()[1]
    again = play(CONFIG, pad_scenes(scenes[2:]), InTurn(), random.key_of(1), 64)
    assert np.array_equal(np.random.get_state()[1], expected)  # noqa: NPY002
    assert same(again, in_turn)
    other = play(CONFIG, pad_scenes(scenes[2:]), InTurn(), random.key_of(2), 64)
    assert not same(other, in_turn)


def test_evaluate_keeps_the_totals_of_what_play_records(scenes, in_turn):
    totals = evaluate(CONFIG, pad_scenes(scenes[2:]), InTurn(), random.key_of(1), 64)
    is_taken = np.asarray(in_turn.is_taken)
    assert np.asarray(totals.reward) == pytest.approx(
        np.where(is_taken, in_turn.reward, 0.0).sum(axis=1), rel=1e-5, abs=1e-4
    )
    assert np.asarray(totals.robot_s) == pytest.approx(np.asarray(in_turn.elapsed_s)[:, -1], rel=1e-5)
    assert np.array_equal(totals.num_steps, is_taken.sum(axis=1))


def test_what_is_played_in_batches_is_what_is_played_at_once(scenes, in_turn, monkeypatch):
    monkeypatch.setattr(rollout, "BATCH", 24)
    in_batches = play(CONFIG, pad_scenes(scenes[2:]), InTurn(), random.key_of(1), 64)
    assert np.array_equal(in_batches.is_taken, in_turn.is_taken)
    for name in ("action", "probability", "reward", "duration_s"):
        ours, at_once = (getattr(each, name)[each.is_taken] for each in (in_batches, in_turn))
        assert np.array_equal(ours, at_once), name
    totals = evaluate(CONFIG, pad_scenes(scenes[2:]), InTurn(), random.key_of(1), 64)
    assert totals.reward == pytest.approx(np.where(in_turn.is_taken, in_turn.reward, 0.0).sum(axis=1), abs=1e-4)


def test_some_episodes_are_those_of_all(scenes, in_turn):
    some = evaluate_some(CONFIG, pad_scenes(scenes[2:]), InTurn(), random.key_of(1), np.array([40, 3]))
    totals = evaluate(CONFIG, pad_scenes(scenes[2:]), InTurn(), random.key_of(1), 64)
    assert np.asarray(some.reward) == pytest.approx(np.asarray(totals.reward)[[40, 3]], rel=1e-5, abs=1e-4)
    assert np.asarray(some.num_steps).tolist() == np.asarray(totals.num_steps)[[40, 3]].tolist()


@pytest.mark.parametrize("at_once", [1, 64, 1000])
def test_side_by_side_policies_earn_what_each_does_alone(scenes, at_once, monkeypatch):
    monkeypatch.setattr(rollout, "SIDE_BY_SIDE", at_once)
    args, policies = (CONFIG, pad_scenes(scenes[2:])), [InTurn(), Suspicious(), UniformPolicy()]
    side_by_side = evaluate_each(*args, policies, random.key_of(1), 30)
    alone = [evaluate(*args, policy, random.key_of(1), 30) for policy in policies]
    assert all(same(*pair) for pair in zip(side_by_side, alone, strict=True))


def test_policies_meet_the_same_world(played, scenes):
    suspicious = play(CONFIG, pad_scenes(scenes), Suspicious(), random.key_of(7), 300)
    assert same(suspicious.hidden, picked(played.hidden, np.s_[:300]))
    assert not np.array_equal(suspicious.action, played.action[:300])


@pytest.mark.parametrize("stage", [0, 3, 6])
def test_among_objects_believed_dirty_with_x_a_share_x_is(played, stage):
    alive = np.asarray(played.is_taken)[:, stage]
    is_object = np.asarray(played.states.is_object)[alive, stage]
    believed = 1.0 / (1.0 + np.exp(-np.asarray(played.states.log_odds, dtype=float)[alive, stage][is_object]))
    dirty = np.asarray(played.hidden.is_dirty)[alive][is_object]
    bins = np.digitize(believed, [0.3, 0.5, 0.7, 0.9])
    for k in np.unique(bins):
        inside = believed[bins == k]
        error = np.sqrt((inside * (1.0 - inside)).sum()) / len(inside)
        assert abs(dirty[bins == k].mean() - inside.mean()) < 4.0 * error
    assert len(np.unique(bins)) >= 3


def test_a_policy_that_chooses_by_belief_does_not_spoil_it(scenes):
    played = play(CONFIG, pad_scenes(scenes), Suspicious(), random.key_of(7), 300)
    washed_last = np.asarray(played.states.log_odds)[:, 4], np.asarray(played.is_taken)[:, 4]
    is_object = np.asarray(played.states.is_object)[:, 4] & washed_last[1][:, None]
    believed = 1.0 / (1.0 + np.exp(-washed_last[0][is_object].astype(float)))
    dirty = np.asarray(played.hidden.is_dirty)[is_object]
    assert len(dirty) > 300
    assert abs(dirty.mean() - believed.mean()) < 4.0 * np.sqrt((believed * (1 - believed)).sum()) / len(dirty)


def test_the_clock_runs_and_a_path_ends_once(played):
    is_taken, elapsed = np.asarray(played.is_taken), np.asarray(played.elapsed_s)
    assert is_taken[:, 0].all()
    assert (is_taken[:, 1:] <= is_taken[:, :-1]).all()
    assert (np.diff(elapsed, axis=1)[is_taken[:, 1:]] > 0).all()
    assert set(is_taken.sum(axis=1)) >= {1, 2, 5, 10}


def test_the_logged_probability_is_that_of_the_action(scenes):
    state, _ = start(CONFIG, picked(pad_scenes(scenes), 1), random.key_of(0))
    num_draws = 20_000
    policy = ExploringPolicy(Suspicious(), random_share=0.3)
    keys = random.keys_of(random.key_of(2), num_draws)
    action, said = policy.decide(repeated(state, num_draws), keys)
    count = np.bincount(action, minlength=11)
    taken = np.flatnonzero(count)
    assert taken.tolist() == [0, 1, 2, 3, 6, 7, 8]
    probability = np.array([said[action == code][0] for code in taken])
    assert all(np.ptp(said[action == code]) == 0.0 for code in taken)
    assert probability.sum() == pytest.approx(1.0, abs=1e-6)
    assert sorted(probability)[-1] == pytest.approx(0.7 + 0.3 / 7, abs=1e-6)
    error = np.sqrt(probability * (1.0 - probability) / num_draws)
    assert np.all(np.abs(count[taken] / num_draws - probability) < 4.0 * error)


@pytest.mark.parametrize("share", [-0.1, 2.0, float("nan")])
def test_a_share_of_random_decisions_lies_between_0_and_1(share):
    with pytest.raises(ArgumentError, match=rf"random_share is {share}; give the share .*, in \[0, 1\]"):
        ExploringPolicy(Suspicious(), share)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_the_ends_of_exploring(scenes, share):
    state, _ = start(CONFIG, picked(pad_scenes(scenes), 1), random.key_of(0))
    base = Suspicious().decide(state, random.key_of(0))
    keys = random.keys_of(random.key_of(2), 200)
    decisions = ExploringPolicy(Suspicious(), share).decide(repeated(state, 200), keys)
    if share == 0.0:
        assert (decisions.action == int(base.action)).all()
        assert (decisions.probability == 1.0).all()
    else:
        assert len(np.unique(decisions.action)) == 7
        assert decisions.probability == pytest.approx(1.0 / 7)
    uniform = UniformPolicy().decide(state, random.key_of(0))
    assert float(uniform.probability) == pytest.approx(1.0 / 7)
