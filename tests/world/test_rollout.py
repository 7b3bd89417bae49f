import numpy as np
import pytest

from halfseen.arrays import expit, mapped
from halfseen.errors import ArgumentError
from halfseen.world import ActionSpace, ExploringPolicy, UniformPolicy, WorldConfig, random, rollout
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


def test_one_key_folds_in_as_many_numbers_as_there_are():
    numbers = np.arange(40_000)
    found = random.fold_in(random.key_of(3), numbers)
    np.testing.assert_array_equal(found[[0, 30_000]], [random.fold_in(random.key_of(3), k) for k in (0, 30_000)])
