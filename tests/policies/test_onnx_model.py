"""A policy as an ONNX graph decides as the policy does."""

import json
from dataclasses import replace

import numpy as np
import onnx
import onnxruntime
import pandas as pd
import pytest

from halfseen.arrays import stacked
from halfseen.errors import ArgumentError, PolicyError
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.policies.folder import read_policy
from halfseen.policies.folder.stored import StoredPolicy
from halfseen.policies.onnx_model import onnx_model, table_inputs
from halfseen.tables import BetaGrasp
from halfseen.world.state import NO_ATTEMPT, TableState
from small_logs import flat_log, table_log

FLAT = {
    "linear": {"reg": 0.1},
    "linear, pessimistic": {"reg": 0.1, "pessimism": 1.0},
    "kernel": {"reg": 0.1, "q_function": "kernel"},
    "smooth, pessimistic": {"reg": 0.1, "q_function": "smooth", "pessimism": 0.5, "stages": "trend"},
    "what the log does": {"reg": 0.1, "pessimism": 1.0, "behaviour_weight": 0.7},
}
TABLES = {
    "linear": {"reg": 0.1},
    "default": {},
    "grasps, pessimistic": {"reg": 0.1, "pessimism": 1.0, "grasp": BetaGrasp()},
    "smooth, pessimistic": {"reg": 0.1, "q_function": "smooth", "pessimism": 0.5},
}


def metadata(model):
    return {each.key: json.loads(each.value) for each in onnx.load_from_string(model).metadata_props}


def assert_alike(scores, action, wanted, chosen, margin, least_clear):
    """Scores are close, and where the best is clear the action is the same."""
    np.testing.assert_allclose(scores, wanted, rtol=1e-5, atol=1e-5)
    second, best = np.sort(wanted, axis=1)[:, -2:].T
    is_clear = best - second > margin
    assert is_clear.mean() > least_clear
    np.testing.assert_array_equal(action[is_clear], chosen[is_clear])


@pytest.mark.slow
@pytest.mark.parametrize("options", FLAT.values(), ids=FLAT)
def test_it_decides_ten_thousand_states_alike(options, stored):
    rng, options = np.random.default_rng(0), dict(options)
    weight = options.pop("behaviour_weight", 0.0)
    kept = stored(CensoredQLearner(2, {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"], **options), flat_log())
    kept = replace(kept, policy=replace(kept.policy, behaviour_weight=weight))
    session, policy = onnxruntime.InferenceSession(onnx_model(kept)), kept.policy
    frame = pd.DataFrame({"x1": rng.normal(size=5000), "x2": rng.integers(0, 3, 5000).astype(float)})
    for stage in (1, 2):
        given = {"covariates": policy.looks_at.encode(frame), "stage": np.array(stage)}
        scores, action = session.run(["scores", "action"], given)
        wanted = np.where(policy.is_possible[stage - 1], policy.scores(frame, stage), -np.inf)
        assert_alike(scores, np.array(policy.actions)[action], wanted, policy.decide(frame, stage), 1e-9, 0.99)


def random_state(num_objects, horizon, rng):
    """Any state with an object on the table and a step to go; of objects that are not there all is 0 and False."""
    is_object = np.arange(num_objects) < rng.integers(1, num_objects + 1)
    is_on_table = is_object & (rng.random(num_objects) < 0.8)
    is_on_table[0] |= not is_on_table.any()
    hides = rng.random((num_objects, num_objects)) * (rng.random((num_objects, num_objects)) < 0.4)
    np.fill_diagonal(hides, 0.0)
    steps_to_go = rng.integers(1, horizon + 1)
    is_tried = np.arange(horizon) < rng.integers(0, horizon - steps_to_go + 1)
    tried = np.where(is_tried, rng.integers(0, is_object.sum(), horizon), NO_ATTEMPT)

    def of_objects(values):
        return np.where(is_object, values, 0).astype(np.float32)

    return TableState(
        hides=(hides * is_object * is_object[:, None]).astype(np.float32),
        is_object=is_object,
        is_on_table=is_on_table,
        grip=of_objects(rng.normal(size=num_objects)),
        log_odds=of_objects(rng.normal(0.4, 2.0, num_objects)),
        seen=of_objects(rng.random(num_objects)),
        lifts=of_objects(rng.integers(0, 3, num_objects)).astype(np.int32),
        attempt_object=tried.astype(np.int32),
        attempt_occlusion=np.where(is_tried, rng.random(horizon), 0.0).astype(np.float32),
        attempt_succeeded=is_tried & (rng.random(horizon) < 0.5),
        steps_to_go=np.int32(steps_to_go),
    )


@pytest.mark.slow
@pytest.mark.parametrize("options", TABLES.values(), ids=TABLES)
def test_it_decides_a_thousand_tables_alike(options, stored):
    """250 of each of the four kinds."""
    rng, horizon, num_objects = np.random.default_rng(1), 3, 4
    kept = stored(CensoredQLearner.for_table(horizon, laws=None, **options), table_log(num_trajectories=60))
    session = onnxruntime.InferenceSession(onnx_model(kept, num_objects))
    states = [random_state(num_objects, horizon, rng) for _ in range(250)]
    wanted = kept.policy.q_values(stacked(states))
    given = [session.run(["scores", "action"], table_inputs(state)) for state in states]
    scores, action = (np.stack(each) for each in zip(*given, strict=True))
    assert_alike(scores, action, wanted, wanted.argmax(axis=1), 1e-5, 0.9)


@pytest.mark.slow
def test_the_model_names_what_it_takes_and_gives_and_a_number_of_objects_is_for_tables(kept):
    flat, tables = (read_policy(kept / kind) for kind in ("flat", "tables"))
    named = {"actions": ["A", "B", "C"], "covariates": ["x1", "x2"], "horizon": 2}
    assert metadata(onnx_model(flat)) == named
    with pytest.raises(ArgumentError, match="leave it out"):
        onnx_model(flat, 3)
    # A model of tables is for as many objects as the log showed, and pads.
    named = {"actions": ["FINISH", "WASH 0", "WASH 1", "LIFT 0", "LIFT 1"], "objects": 2, "horizon": 3}
    assert metadata(onnx_model(tables)) == named
    of_three = onnxruntime.InferenceSession(onnx_model(tables, 3))
    state = random_state(3, 3, np.random.default_rng(0))
    assert [each.name for each in of_three.get_inputs()] == list(table_inputs(state))
    with pytest.raises(PolicyError, match="of kind 'team', which cannot be exported: serve it"):
        onnx_model(StoredPolicy(policy=None, record={"kind": "team"}))


def test_text_comes_as_an_indicator_of_each_category_but_the_first(stored):
    plain, rng = flat_log(), np.random.default_rng(3)
    kind = rng.choice(["mug", "glass", "bowl"], len(plain.stages))
    logs = Logs(plain.stages.assign(kind=kind), plain.trajectories)
    policy = stored(CensoredQLearner(2, ["A", "B", "C"], ["x1", "kind"], reg=0.1), logs)
    model = onnx_model(policy)
    assert metadata(model)["covariates"] == ["x1", "kind=glass", "kind=mug"]
    frame = pd.DataFrame({"x1": [0.3, -1.0, 0.0], "kind": ["bowl", "glass", "mug"]})
    encoded = np.array([[0.3, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    scores, _ = onnxruntime.InferenceSession(model).run(None, {"covariates": encoded, "stage": np.array(1)})
    np.testing.assert_allclose(scores, policy.policy.scores(frame, 1), rtol=1e-9)


@pytest.mark.slow
def test_a_stage_that_is_none_and_nan_are_no_decision(kept, capfd):
    flat, tables = (onnxruntime.InferenceSession(onnx_model(read_policy(kept / kind))) for kind in ("flat", "tables"))
    states = np.array([[0.3, 1.0], [np.nan, 1.0]])
    _, (known, unknown) = flat.run(None, {"covariates": states, "stage": np.array(1)})
    assert (known in (0, 1), unknown) == (True, -1)
    # A controller may count from 0; the graph would wrap -1 around to the last stage.
    for stage in (0, -1, 3):
        with pytest.raises(Exception, match="out of"):
            flat.run(None, {"covariates": states, "stage": np.array(stage)})
    state = random_state(2, 3, np.random.default_rng(0))
    for to_go in (0, 4):
        with pytest.raises(Exception, match="out of"):
            tables.run(None, table_inputs(replace(state, steps_to_go=np.int32(to_go))))
    _, action = tables.run(None, table_inputs(replace(state, log_odds=state.log_odds + np.float32(np.nan))))
    assert action == -1
    capfd.readouterr()
