"""A step is that of the text, and with given keys what it was when it was JAX's; in any batch, and under `jax.jit`."""

from dataclasses import fields, replace
from functools import reduce
from pathlib import Path

import numpy as np
import pytest
from naive_world import hidden_share, naive_step

from halfseen.arrays import known_to_jax, mapped
from halfseen.world import (
    ActionSpace,
    AssumedGrasping,
    Scene,
    TableState,
    UniformPolicy,
    Verb,
    WorldConfig,
    random,
    rollout,
)
from halfseen.world.actions import possible_actions
from halfseen.world.state import HiddenState, attempt_counts, occlusion, pad_scenes
from halfseen.world.transition import start, step
from picked import assert_same, picked
from world.world_cases import TEAMS, recorded_scenes, world_of

CONFIG = WorldConfig()
NUM_OBJECTS = 5


def table_of(state, hidden):
    """One table as plain lists, padding left out."""
    num = int(np.sum(state.is_object))
    attempts = zip(state.attempt_object, state.attempt_occlusion, state.attempt_succeeded, strict=True)
    return {
        "hides": state.hides.astype(float)[:num, :num].tolist(),
        "on_table": state.is_on_table[:num].tolist(),
        "log_odds": state.log_odds.astype(float)[:num].tolist(),
        "lifts": state.lifts[:num].tolist(),
        "attempts": [(int(i), float(occ), bool(ok)) for i, occ, ok in attempts if i >= 0],
        "steps_to_go": int(state.steps_to_go),
        "dirty": hidden.is_dirty[:num].tolist(),
        "offset": hidden.grasp_latent.astype(float)[:num].tolist(),
    }


def tables_of(states, hidden):
    return [table_of(picked(states, k), picked(hidden, k)) for k in range(len(hidden.is_dirty))]


@pytest.fixture(scope="module")
def steps(played):
    """A few hundred states of all kinds, with what is hidden, the action taken there and its key."""
    trajectory, stage = np.nonzero(played.is_taken[:150])
    keys = random.keys_of(random.key_of(11), len(trajectory))
    return (
        picked(played.states, (trajectory, stage)),
        picked(played.hidden, trajectory),
        played.action[trajectory, stage],
        keys,
    )


def test_a_step_is_the_step_of_the_text(steps):
    states, hidden, action, keys = steps
    after, _, outcome = step(CONFIG, states, hidden, action, keys)
    grasp_key, see_key = random.split(keys)
    exponential, uniforms = random.exponential(grasp_key), random.uniform(see_key, NUM_OBJECTS)
    kinds, actions = set(), ActionSpace(NUM_OBJECTS)
    for k, (table, got) in enumerate(zip(tables_of(states, hidden), tables_of(after, hidden), strict=True)):
        verb, target = Verb(actions.verb(action[k])).name, int(actions.target(action[k]))
        reward, duration_s, is_over, then = naive_step(table, verb, target, exponential[k], uniforms[k])
        assert outcome.reward[k] == pytest.approx(reward, abs=1e-4)
        assert outcome.duration_s[k] == pytest.approx(duration_s, rel=1e-5)
        assert outcome.is_over[k] == is_over
        for name in ("on_table", "lifts", "steps_to_go", "dirty", "offset", "hides"):
            assert got[name] == then[name], name
        assert got["log_odds"] == pytest.approx(then["log_odds"], abs=1e-5)
        assert [(i, ok) for i, _, ok in got["attempts"]] == [(i, ok) for i, _, ok in then["attempts"]]
        assert [occ for _, occ, _ in got["attempts"]] == pytest.approx(
            [occ for _, occ, _ in then["attempts"]], abs=1e-6
        )
        held = verb == "LIFT" and then["lifts"] != table["lifts"]
        kinds.add((verb, held, then["on_table"] != table["on_table"], is_over, any(then["on_table"])))
    # Washed and not, lifted and not, cleared tables, horizons: a sample without them would prove little.
    assert {
        ("WASH", False, True, True, False),
        ("WASH", False, True, False, True),
        ("WASH", False, False, False, True),
        ("LIFT", True, False, False, True),
        ("LIFT", False, False, False, True),
        ("FINISH", False, False, True, True),
    } <= kinds


def test_the_horizon_costs_what_finish_costs():
    state, _ = start(CONFIG, picked(pad_scenes([Scene(np.zeros((3, 3)))]), 0), random.key_of(0))
    state = replace(state, steps_to_go=np.asarray(1, dtype=np.int32))
    hidden = HiddenState(np.array([True, True, False]), np.array([-20.0, 0.0, 0.0]))
    lift = np.asarray(ActionSpace(3).encode(Verb.LIFT, 0))
    *_, lifted = step(CONFIG, state, hidden, lift, random.key_of(1))
    *_, finished = step(CONFIG, state, hidden, np.asarray(0), random.key_of(1))
    assert bool(lifted.is_over)
    assert float(finished.reward) == -10.0
    assert float(lifted.reward) == pytest.approx(-10.0 - 0.1 * 7.0)


def test_what_is_reported_of_a_state_is_what_the_text_says_of_it(steps):
    """Occlusion is one minus the product, attempts are counted by object, and what is on the table can be acted on."""
    states, hidden, *_ = steps
    seen, (successes, failures), possible = occlusion(states), attempt_counts(states), possible_actions(states)
    for k, table in enumerate(tables_of(states, hidden)):
        expected = [hidden_share(table["hides"], table["on_table"], i) for i in range(len(table["on_table"]))]
        assert seen[k, : len(expected)] == pytest.approx(expected, abs=1e-6)
        for i in range(NUM_OBJECTS):
            assert successes[k, i] == sum(ok for j, _, ok in table["attempts"] if j == i)
            assert failures[k, i] == sum(not ok for j, _, ok in table["attempts"] if j == i)
    assert (seen > 0.3).any()
    assert min(successes.max(), failures.max()) > 1
    assert possible[:, 0].all()
    assert (possible[:, 1:] == np.tile(states.is_on_table, 2)).all()


def test_a_policy_sees_nothing_hidden(scenes):
    assert {field.name for field in fields(TableState)} == {
        *("hides", "is_object", "is_on_table", "grip", "log_odds", "seen", "lifts", "steps_to_go"),
        *("attempt_object", "attempt_occlusion", "attempt_succeeded", "attempt_robot"),
        *("robots", "workspace", "decider"),
    }
    # The same labels, other grips: the state at the start is the same to the last bit.
    layout = picked(pad_scenes(scenes), 2)
    gripping, slipping = (
        start(replace(CONFIG, grasping=AssumedGrasping(offset_std=std)), layout, random.key_of(0)) for std in (0.0, 9.0)
    )
    assert not np.array_equal(gripping[1].grasp_latent, slipping[1].grasp_latent)
    assert_same(gripping[0], slipping[0])


def test_layout_is_padded_with_nan(scenes):
    layout = pad_scenes(scenes, num_objects=8)
    assert layout.is_object.sum(axis=1).tolist() == [1, 3, 5]
    assert np.isnan(layout.hides[1, 3:]).all()


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


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NAMES if name.endswith("uniform")])
def test_a_rollout_draws_what_was_recorded(name):
    played = rollout.play(*_world(name), UniformPolicy(), KEY, EPISODES)
    is_taken = played.is_taken
    assert np.array_equal(is_taken, RECORDED[f"{name}/is_taken"])
    assert np.array_equal(played.action[is_taken], RECORDED[f"{name}/action"][is_taken])
    for field in ("probability", "reward", "duration_s"):
        expected = RECORDED[f"{name}/{field}"][is_taken]
        np.testing.assert_allclose(getattr(played, field)[is_taken], expected, rtol=2e-5, atol=3e-5)


@pytest.mark.parametrize("team", TEAMS)
def test_one_table_goes_as_it_does_in_a_batch(team):
    config, tables = _world(f"{team}/assumed/uniform")
    keys = np.stack(random.split(KEY, 3))
    state, hidden = start(config, tables, keys)
    action = UniformPolicy().decide(state, keys).action
    after = step(config, state, hidden, action, keys)
    for k, key in enumerate(keys):
        one = start(config, picked(tables, k), key)
        assert_same(one, picked((state, hidden), k))
        assert UniformPolicy().decide(one[0], key).action == action[k]
        assert_same(step(config, *one, action[k], key), picked(after, k))


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
