"""What tables are to a learner is what it was when JAX computed it: features, Q, encodings, laws, one robot's view."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from halfseen.arrays import known_to_jax
from halfseen.learning import CensoredQLearner
from halfseen.logs import read_logs
from halfseen.tables import TableTask, TeamTask, agent_view, fit_world
from halfseen.tables.encoding import states_alone, team_states
from halfseen.tables.evidence import evidence_of
from halfseen.tables.features import table_features, table_q, team_features
from halfseen.tables.law_seeing import Independent
from halfseen.world import Robots, TableState, Workspace, WorldConfig
from halfseen.world.actions import possible_actions
from picked import picked

HERE = Path(__file__).parents[1] / "recorded"
WORLD, TABLES = np.load(HERE / "world.npz"), np.load(HERE / "tables.npz")
WORDS = json.loads((HERE / "tables.json").read_text())
PLAYED = sorted({key.rsplit("/", 1)[0] for key in TABLES if key.endswith("/at") and not key.startswith("encoded")})
TEAM_LOG, TABLE_LOG = HERE.parents[1] / "examples" / "two_robots" / "logs", HERE / "tables_100"


def recorded_states(name):
    """The states that were asked about."""
    found = {}
    for key in WORLD:
        if key.startswith(f"{name}/states."):
            field, _, still = key[len(f"{name}/states.") :].partition(" ")
            trajectory, stage = TABLES[f"{name}/at"].T
            found[field] = WORLD[key][trajectory] if still else WORLD[key][trajectory, stage]
    parts = {"robots": Robots, "workspace": Workspace}
    table = {
        field.removeprefix("table."): value for field, value in found.items() if not field.startswith(tuple(parts))
    }
    for part, record in parts.items():
        own = {field.removeprefix(f"{part}."): value for field, value in found.items() if field.startswith(f"{part}.")}
        table |= {part: record(**own)} if own else {}
    return TableState(**table)


@pytest.mark.parametrize("name", PLAYED)
def test_states_look_as_they_did(name):
    states = recorded_states(name)
    if states.robots is not None:
        np.testing.assert_allclose(team_features(states), TABLES[f"{name}/team_features"], rtol=1e-5, atol=3e-6)
        return
    coefficients = np.sin(np.arange(3 * 23, dtype=np.float32)).reshape(3, 23)
    np.testing.assert_allclose(table_features(states), TABLES[f"{name}/table_features"], rtol=1e-5, atol=3e-6)
    is_possible = possible_actions(states)
    np.testing.assert_array_equal(is_possible, TABLES[f"{name}/possible_actions"])
    q, expected = table_q(coefficients, states), TABLES[f"{name}/table_q"]
    np.testing.assert_allclose(q[is_possible], expected[is_possible], rtol=1e-4, atol=2e-5)


@pytest.mark.parametrize("name", PLAYED)
def test_one_state_looks_as_it_does_among_others(name):
    states = recorded_states(name)
    features = table_features if states.robots is None else team_features
    each = [features(picked(states, k)) for k in range(10)]
    np.testing.assert_array_equal(each, features(states)[:10])


@pytest.mark.parametrize(
    ("name", "task", "log", "horizon"),
    [
        ("tables", TableTask(grasp=None), TABLE_LOG, 10),
        ("two_robots", TeamTask(grasp=None, base=None, num_robots=2), TEAM_LOG, 20),
    ],
)
def test_logs_are_encoded_as_they_were(name, task, log, horizon):
    encoded, words = task.encode(read_logs(log), horizon), WORDS[f"encoded/{name}"]
    trajectory, stage = TABLES[f"encoded/{name}/at"].T
    for what, result in words.items():
        value = getattr(encoded, what)
        assert list(value.shape) == result["shape"]
        assert value.sum() == pytest.approx(result["sum"], rel=1e-6)
        np.testing.assert_allclose(
            value[trajectory, stage], TABLES[f"encoded/{name}/{what}"], rtol=1e-5, atol=3e-6, err_msg=what
        )
    assert hashlib.sha256(encoded.action.tobytes()).hexdigest() == words["action"]["sha256"]


def test_laws_are_fitted_as_they_were():
    log = read_logs(TABLE_LOG)
    fitted, words, labels = fit_world(log, WorldConfig()), WORDS["fit_world"], evidence_of(log, WorldConfig())
    assert fitted.dirty_share == pytest.approx(words["dirty_share"], rel=1e-9)
    # What was recorded knew nothing of the recorder's own law.
    by_labels = Independent(labels.labels, labels.dirty_share)
    seeing = by_labels.law(by_labels.fitted(by_labels.prior))
    for law, of in (("grasping", fitted.grasping), ("seeing", seeing)):
        numbers = {name: value for name, value in words[law].items() if name != "family"}
        assert type(of).__name__ == words[law]["family"]
        assert {name: getattr(of, name) for name in numbers} == pytest.approx(numbers, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("robot", [0, 1])
def test_the_view_of_an_agent_is_what_it_was(robot):
    view, words = agent_view(read_logs(TEAM_LOG), robot), WORDS[f"alone/{robot}"]
    for name in ("stages", "trajectories", "objects"):
        frame, result = getattr(view, name), words[name]
        text = frame.to_csv(index=False, float_format="%.9g")
        assert list(frame.columns) == result["columns"]
        assert text.splitlines()[1:6] == result["head"]
        assert hashlib.sha256(text.encode()).hexdigest() == result["sha256"], name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("learner", "log", "states_of"),
    [
        (CensoredQLearner.for_table(10, laws=None), TABLE_LOG, states_alone),
        (CensoredQLearner.for_team(2, 10, laws=None), TEAM_LOG, team_states),
    ],
    ids=["one robot", "beyond independent policies"],
)
def test_under_jax_jit_policies_say_the_same(learner, log, states_of):
    pytest.importorskip("jax")
    jax, logs = known_to_jax(), read_logs(log)
    policy, states = learner.fit(logs).policy_, states_of(logs, learner.horizon)
    states = picked(states, np.nonzero(states.is_on_table.any(axis=-1)))
    ours, key = policy.q_values(states), np.zeros((len(states.lifts), 2), dtype=np.uint32)
    theirs = np.asarray(jax.jit(lambda policy, states: policy.q_values(states))(policy, states))
    np.testing.assert_array_equal(np.isfinite(theirs), np.isfinite(ours))
    np.testing.assert_allclose(theirs, ours, rtol=1e-4, atol=1e-4)
    action = jax.jit(lambda policy, states, key: policy.decide(states, key).action)(policy, states, key)
    assert (np.asarray(action) == policy.decide(states, key).action).mean() > 0.995
