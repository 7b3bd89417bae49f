from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from naive_world import accuracy, hidden_share, mean_grasp_s, naive_step

from halfseen.world import AssumedGrasping, Scene, WorldConfig, random
from halfseen.world.actions import ActionSpace, Verb, possible_actions
from halfseen.world.attempts import look
from halfseen.world.state import HiddenState, Layout, TableState, attempt_counts, occlusion, pad_scenes
from halfseen.world.transition import start, step
from picked import leaves_of, picked, repeated

CONFIG = WorldConfig()
NUM_OBJECTS = 5


def table_of(state):
    """One table as plain lists, padding left out."""
    num = int(np.sum(state.is_object))
    attempts = zip(state.attempt_object, state.attempt_occlusion, state.attempt_succeeded, strict=True)
    return {
        "hides": np.asarray(state.hides, dtype=float)[:num, :num].tolist(),
        "on_table": np.asarray(state.is_on_table)[:num].tolist(),
        "log_odds": np.asarray(state.log_odds, dtype=float)[:num].tolist(),
        "lifts": np.asarray(state.lifts)[:num].tolist(),
        "attempts": [(int(i), float(occ), bool(ok)) for i, occ, ok in attempts if i >= 0],
        "steps_to_go": int(state.steps_to_go),
        "dirty": np.asarray(state.is_dirty)[:num].tolist(),
        "offset": np.asarray(state.grasp_trait, dtype=float)[:num].tolist(),
    }


def draws(key):
    grasp_key, see_key = random.split(key)
    return random.exponential(grasp_key), random.uniform(see_key, NUM_OBJECTS)


@pytest.fixture(scope="module")
def steps(played):
    """A few hundred states of all kinds, with the action taken there and one step from each."""
    path, stage = np.nonzero(np.asarray(played.is_taken)[:150])
    states = picked(played.states, (path, stage))
    hidden = picked(played.hidden, path)
    action = played.action[path, stage]
    keys = random.keys_of(random.key_of(11), len(path))
    after, _, outcome = step(CONFIG, states, hidden, action, keys)
    exponential, uniforms = draws(keys)
    return states, hidden, action, exponential, uniforms, after, outcome


def row(tree, k):
    return picked(tree, k)


def tables_of(states, hidden):
    """Each row of a batch as plain lists."""
    told = {field.name: getattr(states, field.name) for field in fields(states)}
    values = {name: np.asarray(leaf) for name, leaf in told.items() if leaf is not None}
    values |= {"is_dirty": np.asarray(hidden.is_dirty), "grasp_trait": np.asarray(hidden.grasp_trait)}
    return [
        table_of(SimpleNamespace(**{name: leaf[k] for name, leaf in values.items()}))
        for k in range(len(hidden.is_dirty))
    ]


def test_a_step_is_the_step_of_the_text(steps):
    states, hidden, action, exponential, uniforms, after, outcome = steps
    kinds = set()
    actions = ActionSpace(NUM_OBJECTS)
    verbs, targets = actions.verb(action), actions.target(action)
    tables, tables_after = tables_of(states, hidden), tables_of(after, hidden)
    for k, (table, got) in enumerate(zip(tables, tables_after, strict=True)):
        verb, target = Verb(verbs[k]).name, int(targets[k])
        reward, duration_s, is_over, then = naive_step(table, verb, target, exponential[k], uniforms[k])
        assert outcome.reward[k] == pytest.approx(reward, abs=1e-4)
        assert outcome.duration_s[k] == pytest.approx(duration_s, rel=1e-5)
        assert outcome.is_over[k] == is_over
        for name in ("on_table", "lifts", "steps_to_go", "dirty", "offset", "hides"):
            assert got[name] == then[name], name
        assert got["log_odds"] == pytest.approx(then["log_odds"], abs=1e-5)
        assert len(got["attempts"]) == len(then["attempts"])
        for (i, occ, ok), (j, occ_then, ok_then) in zip(got["attempts"], then["attempts"], strict=True):
            assert (i, ok) == (j, ok_then)
            assert occ == pytest.approx(occ_then, abs=1e-6)
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
    scene = Scene(np.zeros((3, 3)))
    layout = row(pad_scenes([scene]), 0)
    state, _ = start(CONFIG, layout, random.key_of(0))
    state = replace(state, steps_to_go=np.asarray(1, dtype=np.int32))
    hidden = HiddenState(np.array([True, True, False]), np.array([-20.0, 0.0, 0.0]))
    lift = np.asarray(ActionSpace(3).encode(Verb.LIFT, 0))
    *_, lifted = step(CONFIG, state, hidden, lift, random.key_of(1))
    *_, finished = step(CONFIG, state, hidden, np.asarray(0), random.key_of(1))
    assert bool(lifted.is_over)
    assert float(finished.reward) == -10.0
    assert float(lifted.reward) == pytest.approx(-10.0 - 0.1 * 7.0)


def test_occlusion_is_one_minus_the_product(steps):
    states, hidden, *_ = steps
    seen = occlusion(states)
    for k, table in enumerate(tables_of(states, hidden)):
        expected = [hidden_share(table["hides"], table["on_table"], i) for i in range(len(table["on_table"]))]
        assert seen[k, : len(expected)] == pytest.approx(expected, abs=1e-6)
    assert (seen > 0.3).any()


@pytest.mark.parametrize(("occluded", "offset"), [(0.0, 0.0), (0.5, -1.0), (0.9, 0.5)])
def test_grasps_succeed_as_often_as_one_minus_exp(occluded, offset):
    chance = -np.expm1(CONFIG.grasping.log_failure(occluded, offset))
    assert chance == pytest.approx(1.0 - np.exp(-6.0 / mean_grasp_s(occluded, offset)), rel=1e-5)
    scene = Scene(np.array([[0.0, occluded], [0.0, 0.0]]))
    layout = row(pad_scenes([scene]), 0)
    state, _ = start(CONFIG, layout, random.key_of(0))
    hidden = HiddenState(np.array([True, True]), np.array([offset, 0.0]))
    keys = random.keys_of(random.key_of(3), 20_000)
    action = np.full(len(keys), ActionSpace(2).encode(Verb.WASH, 0))
    after, *_ = step(CONFIG, *repeated((state, hidden), len(keys)), action, keys)
    frequency = 1.0 - after.is_on_table[:, 0].mean()
    assert abs(frequency - chance) < 4.0 * np.sqrt(chance * (1.0 - chance) / len(keys))


def test_labels_are_right_as_often_as_the_accuracy_says():
    scene = Scene(np.array([[0.0, 0.0, 0.3], [0.0, 0.0, 0.7], [0.0, 0.0, 0.0]]))
    layout = row(pad_scenes([scene]), 0)
    state, _ = start(CONFIG, layout, random.key_of(0))
    hidden = HiddenState(np.array([True, False, True]), np.zeros(3))
    keys = random.keys_of(random.key_of(5), 20_000)
    held = np.zeros((len(keys), 3), dtype=bool)
    looked, _ = look(CONFIG, *repeated((state, hidden), len(keys)), held, keys)
    frequency = ((looked.log_odds > state.log_odds) == hidden.is_dirty).mean(axis=0)
    expected = np.array([accuracy(0.3), accuracy(0.7), accuracy(0.0)])
    assert CONFIG.seeing.accuracy(np.array([0.3, 0.7, 0.0])) == pytest.approx(expected, rel=1e-6)
    assert np.all(np.abs(frequency - expected) < 4.0 * np.sqrt(expected * (1.0 - expected) / len(keys)))


def test_only_what_stands_on_the_table_can_be_acted_on(steps):
    states, *_ = steps
    possible, on_table = possible_actions(states), states.is_on_table
    assert possible[:, 0].all()
    assert (possible[:, 1:] == np.concatenate([on_table, on_table], axis=1)).all()


def test_attempts_are_counted_by_object(steps):
    states, hidden, *_ = steps
    successes, failures = attempt_counts(states)
    for k, table in enumerate(tables_of(states, hidden)):
        attempts = table["attempts"]
        for i in range(NUM_OBJECTS):
            assert successes[k, i] == sum(ok for j, _, ok in attempts if j == i)
            assert failures[k, i] == sum(not ok for j, _, ok in attempts if j == i)
    assert successes.max() > 1
    assert failures.max() > 1


def test_a_policy_sees_nothing_hidden(scenes):
    names = {field.name for field in fields(TableState)}
    assert names == {
        "attempt_robot",
        "hides",
        "is_object",
        "is_on_table",
        "grip",
        "log_odds",
        "seen",
        "lifts",
        "attempt_object",
        "attempt_occlusion",
        "attempt_succeeded",
        "steps_to_go",
        "robots",
        "workspace",
        "decider",
    }
    # The same labels, other grips: the state at the start is the same to the last bit.
    layout = row(pad_scenes(scenes), 2)
    gripping = start(replace(CONFIG, grasping=AssumedGrasping(offset_std=0.0)), layout, random.key_of(0))
    slipping = start(replace(CONFIG, grasping=AssumedGrasping(offset_std=9.0)), layout, random.key_of(0))
    assert not np.array_equal(gripping[1].grasp_trait, slipping[1].grasp_trait)
    for left, right in zip(leaves_of(gripping[0]), leaves_of(slipping[0]), strict=True):
        assert np.array_equal(left, right)


def test_layout_is_padded_with_nan(scenes):
    layout = pad_scenes(scenes, num_objects=8)
    assert isinstance(layout, Layout)
    assert np.asarray(layout.is_object).sum(axis=1).tolist() == [1, 3, 5]
    assert np.isnan(np.asarray(layout.hides)[1, 3:]).all()
