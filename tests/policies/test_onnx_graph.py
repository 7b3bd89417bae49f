"""A policy as an ONNX graph decides as the policy does."""

import json

import numpy as np
import onnx
import onnxruntime
import pandas as pd
import pytest

from halfseen.errors import PolicyError
from halfseen.learners import CensoredQLearner
from halfseen.policies import read_policy, write_policy
from halfseen.policies.onnx_graph import onnx_model
from small_logs import flat_log, table_log

KINDS = {
    "linear": {"reg": 0.1},
    "linear, pessimistic": {"reg": 0.1, "pessimism": 1.0},
    "kernel": {"reg": 0.1, "q_function": "kernel"},
    "smooth, pessimistic": {"reg": 0.1, "q_function": "smooth", "pessimism": 0.5, "stages": "pooled"},
}


@pytest.mark.parametrize("options", KINDS.values(), ids=KINDS)
def test_it_decides_ten_thousand_states_alike(options, tmp_path):
    logs, rng = flat_log(), np.random.default_rng(0)
    learner = CensoredQLearner(2, {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"], **options)
    write_policy(learner.fit(logs), logs, tmp_path / "policy")
    stored = read_policy(tmp_path / "policy")
    session = onnxruntime.InferenceSession(onnx_model(stored))
    frame = pd.DataFrame({"x1": rng.normal(size=5000), "x2": rng.integers(0, 3, 5000).astype(float)})
    for stage in (1, 2):
        given = {"covariates": stored.policy.looks_at.encode(frame), "stage": np.array(stage)}
        scores, action = session.run(["scores", "action"], given)
        is_possible = stored.policy.is_possible[stage - 1]
        wanted = np.where(is_possible, stored.policy.scores(frame, stage), -np.inf)
        np.testing.assert_allclose(scores, wanted, rtol=1e-5, atol=1e-5)
        two_best = np.sort(wanted, axis=1)[:, -2:]
        is_clear = two_best[:, 1] - two_best[:, 0] > 1e-9
        assert is_clear.mean() > 0.99
        np.testing.assert_array_equal(
            np.array(stored.policy.actions)[action[is_clear]], stored.policy.decide(frame, stage)[is_clear]
        )


def test_the_model_names_what_it_takes_and_gives(tmp_path):
    logs = flat_log()
    write_policy(CensoredQLearner(2, ["A", "B", "C"], ["x1", "x2"], reg=0.1).fit(logs), logs, tmp_path / "policy")
    model = onnx.load_from_string(onnx_model(read_policy(tmp_path / "policy")))
    told = {each.key: json.loads(each.value) for each in model.metadata_props}
    assert told == {"actions": ["A", "B", "C"], "covariates": ["x1", "x2"], "horizon": 2}


def test_a_policy_of_tables_is_refused(tmp_path):
    logs = table_log()
    write_policy(CensoredQLearner.for_table(3, reg=0.1).fit(logs), logs, tmp_path / "policy")
    with pytest.raises(PolicyError, match="of kind 'table'"):
        onnx_model(read_policy(tmp_path / "policy"))
