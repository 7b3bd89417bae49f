"""The world does with given keys what it did when it was JAX's; and it does so in any batch, and under `jax.jit`."""

from functools import reduce
from pathlib import Path

import numpy as np
import pytest
from worlds import TEAMS, recorded_scenes, world_of

from halfseen.arrays import known_to_jax, mapped
from halfseen.world import UniformPolicy, random, rollout
from halfseen.world.transition import start, step
from picked import leaves_of

RECORDED = np.load(Path(__file__).parents[1] / "recorded" / "world.npz")
NAMES = sorted(
    {name.rsplit("/", 1)[0] for name in RECORDED if name.count("/") > 1}
    | {name.rsplit("/", 1)[0] for name in RECORDED if "/is_taken" in name}
)
EPISODES, KEY = 40, random.key_of(7)
RENAMED = {"states.table.": "states.", "hidden.table.": "hidden.", "of_robots.reward": "paid_alone"}
RENAMED |= {"of_robots.out_s": "out_s"}
pytestmark = pytest.mark.filterwarnings("ignore:.*in no robot's reach")


def _world(name):
    team, law = name.split("/")[-3:-1] if name.count("/") == 2 else ("alone", name.split("/")[0])
    return world_of(team, law)


def _leaf(record, field):
    return reduce(lambda at, part: at[int(part)] if part.isdecimal() else getattr(at, part), field.split("."), record)


def _fields(name):
    """Recorded arrays of one case, by today's fields, and whether each stayed as it was in the first stage."""
    for key in RECORDED:
        if key.startswith(f"{name}/"):
            field, _, still = key[len(name) + 1 :].partition(" ")
            for old, new in RENAMED.items():
                field = field.replace(old, new)
            yield field, bool(still), RECORDED[key]


def _replayed(name):
    """Episodes in which the recorded actions were taken: state, action and outcome of each stage."""
    world, is_taken, actions = _world(name), RECORDED[f"{name}/is_taken"], RECORDED[f"{name}/action"]
    config, tables = world.played_config, world.layouts(recorded_scenes())
    keys = random.fold_in(KEY, np.arange(EPISODES))
    start_key, world_key, _ = random.split(keys, 3)
    layout = mapped(lambda leaf: leaf[np.arange(EPISODES) % len(leaf)], tables)
    state, hidden = start(config, layout, start_key)
    first, stages = hidden, []
    for t in range(config.num_stages):
        action = np.where(is_taken[:, t], actions[:, t], 0)
        before = state
        state, hidden, outcome = step(config, state, hidden, action, random.fold_in(world_key, t))
        stages.append((before, outcome))
    return is_taken, first, stages


@pytest.mark.parametrize("name", NAMES)
def test_steps_do_what_was_recorded_of_them(name):
    is_taken, hidden, stages = _replayed(name)
    num_checked = 0
    for field, is_still, expected in _fields(name):
        of, _, rest = field.partition(".")
        if of == "hidden":
            np.testing.assert_allclose(_leaf(hidden, rest), expected, rtol=2e-5, atol=2e-5, err_msg=field)
        elif field not in ("action", "probability", "is_taken"):
            for t in range(is_taken.shape[1]):
                now, then = is_taken[:, t], expected if is_still else expected[:, t]
                got = _leaf(stages[t][0], rest) if of == "states" else _leaf(stages[t][1], field)
                assert got.dtype == then.dtype, field
                np.testing.assert_allclose(got[now], then[now], rtol=2e-5, atol=3e-5, err_msg=f"{field}, stage {t}")
        num_checked += 1
    assert num_checked > 15


@pytest.mark.parametrize("name", [name for name in NAMES if name.endswith("uniform")])
def test_a_rollout_draws_what_was_recorded(name):
    world = _world(name)
    played = rollout.play(world.played_config, world.layouts(recorded_scenes()), UniformPolicy(), KEY, EPISODES)
    is_taken = played.is_taken
    assert np.array_equal(is_taken, RECORDED[f"{name}/is_taken"])
    assert np.array_equal(played.action[is_taken], RECORDED[f"{name}/action"][is_taken])
    for field in ("probability", "reward", "duration_s"):
        expected = RECORDED[f"{name}/{field}"][is_taken]
        np.testing.assert_allclose(getattr(played, field)[is_taken], expected, rtol=2e-5, atol=3e-5)


def _equal(one, other):
    for pair in zip(leaves_of(one), leaves_of(other), strict=True):
        np.testing.assert_array_equal(*pair)


@pytest.mark.parametrize("team", TEAMS)
def test_the_size_of_a_batch_changes_nothing(team, monkeypatch):
    world = world_of(team, "calibrated")
    args = world.played_config, world.layouts(recorded_scenes()), UniformPolicy(), KEY, 9
    whole = rollout.play(*args)
    monkeypatch.setattr(rollout, "BATCH", 2)
    parts = rollout.play(*args)
    assert np.array_equal(whole.is_taken, parts.is_taken)
    for one, other in (
        (whole.action, parts.action),
        (whole.reward, parts.reward),
        (whole.duration_s, parts.duration_s),
    ):
        assert np.array_equal(one[whole.is_taken], other[whole.is_taken])
    _equal(whole.hidden, parts.hidden)


@pytest.mark.parametrize("team", TEAMS)
def test_one_table_goes_as_it_does_in_a_batch(team):
    world = world_of(team)
    config, tables = world.played_config, world.layouts(recorded_scenes())
    keys = random.split(KEY, 3)
    state, hidden = start(config, tables, np.stack(keys))
    action = UniformPolicy().decide(state, np.stack(keys)).action
    after = step(config, state, hidden, action, np.stack(keys))
    for k, key in enumerate(keys):
        one = start(config, mapped(lambda leaf, k=k: leaf[k], tables), key)
        _equal(one, mapped(lambda leaf, k=k: leaf[k], (state, hidden)))
        assert UniformPolicy().decide(one[0], key).action == action[k]
        _equal(step(config, *one, action[k], key), mapped(lambda leaf, k=k: leaf[k], after))


@pytest.mark.slow
@pytest.mark.parametrize("team", ["alone", "team2", "team2 of two laws", "team3"])
def test_under_jax_jit_the_same_comes_out(team):
    pytest.importorskip("jax")
    jax = known_to_jax()
    world = world_of(team, "calibrated")
    config, tables = world.played_config, world.layouts(recorded_scenes())
    keys = np.stack(random.split(KEY, 3))
    begin, advance = start, step
    ours, theirs = start(config, tables, keys), begin(config, tables, keys)
    for t in range(6):
        step_keys = random.fold_in(keys, t)
        action = UniformPolicy().decide(ours[0], step_keys).action
        assert np.array_equal(UniformPolicy().decide(theirs[0], jax.numpy.asarray(step_keys)).action, action)
        *ours, outcome = step(config, *ours, action, step_keys)
        *theirs, of_jax = advance(config, *theirs, action, step_keys)
        mapped(
            lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-4),
            (*ours, tuple(outcome)),
            (*theirs, tuple(of_jax)),
        )
