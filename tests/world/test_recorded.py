"""The world does with given keys what it did when it was JAX's; and it does so in any batch, and under `jax.jit`."""

from functools import reduce
from pathlib import Path

import numpy as np
import pytest

from halfseen.arrays import known_to_jax, mapped
from halfseen.world import UniformPolicy, random, rollout
from halfseen.world.transition import start, step
from picked import leaves_of, picked
from world.world_cases import TEAMS, recorded_scenes, world_of

RECORDED = np.load(Path(__file__).parents[1] / "recorded" / "world.npz")
NAMES = sorted({name.rsplit("/", 1)[0] for name in RECORDED if name.count("/") > 1 or "/is_taken" in name})
EPISODES, KEY = 40, random.key_of(7)
RENAMED = {"states.table.": "states.", "hidden.table.": "hidden.", "of_robots.reward": "paid_alone"}
RENAMED |= {"of_robots.out_s": "out_s", "grasp_trait": "grasp_latent", "seeing_trait": "seeing_latent"}
pytestmark = pytest.mark.filterwarnings("ignore:.*in no robot's reach")


def _world(name):
    team, law = name.split("/")[-3:-1] if name.count("/") == 2 else ("alone", name.split("/")[0])
    world = world_of(team, law)
    return world.played_config, world.layouts(recorded_scenes())


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


def _replayed(config, tables, actions):
    """Episodes in which the recorded actions were taken: what was hidden, and state and outcome of each stage."""
    start_key, world_key, _ = random.split(random.fold_in(KEY, np.arange(EPISODES)), 3)
    state, hidden = start(config, picked(tables, np.arange(EPISODES) % len(tables.is_object)), start_key)
    first, stages = hidden, []
    for t, action in enumerate(actions.T):
        before = state
        state, hidden, outcome = step(config, state, hidden, action, random.fold_in(world_key, t))
        stages.append((before, outcome))
    return first, stages


@pytest.mark.parametrize("name", NAMES)
def test_steps_do_what_was_recorded_of_them(name):
    is_taken = RECORDED[f"{name}/is_taken"]
    hidden, stages = _replayed(*_world(name), np.where(is_taken, RECORDED[f"{name}/action"], 0))
    num_checked = 0
    for field, is_still, expected in _fields(name):
        of, _, rest = field.partition(".")
        if of == "hidden":
            np.testing.assert_allclose(_leaf(hidden, rest), expected, rtol=2e-5, atol=2e-5, err_msg=field)
        elif field not in ("action", "probability", "is_taken"):
            for t, now in enumerate(is_taken.T):
                then = expected if is_still else expected[:, t]
                got = _leaf(stages[t][0], rest) if of == "states" else _leaf(stages[t][1], field)
                assert got.dtype == then.dtype, field
                np.testing.assert_allclose(got[now], then[now], rtol=2e-5, atol=3e-5, err_msg=f"{field}, stage {t}")
        num_checked += 1
    assert num_checked > 15


@pytest.mark.parametrize("name", [name for name in NAMES if name.endswith("uniform")])
def test_a_rollout_draws_what_was_recorded(name):
    played = rollout.play(*_world(name), UniformPolicy(), KEY, EPISODES)
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
def test_one_table_goes_as_it_does_in_a_batch(team):
    config, tables = _world(f"{team}/assumed/uniform")
    keys = np.stack(random.split(KEY, 3))
    state, hidden = start(config, tables, keys)
    action = UniformPolicy().decide(state, keys).action
    after = step(config, state, hidden, action, keys)
    for k, key in enumerate(keys):
        one = start(config, picked(tables, k), key)
        _equal(one, picked((state, hidden), k))
        assert UniformPolicy().decide(one[0], key).action == action[k]
        _equal(step(config, *one, action[k], key), picked(after, k))


@pytest.mark.slow
@pytest.mark.parametrize("team", ["alone", "team2", "team2 of two laws", "team3"])
def test_under_jax_jit_the_same_comes_out(team):
    pytest.importorskip("jax")
    jax = known_to_jax()
    config, tables = _world(f"{team}/calibrated/uniform")
    keys = np.stack(random.split(KEY, 3))
    begin, advance = jax.jit(start), jax.jit(step)
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
