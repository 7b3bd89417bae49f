"""A policy of named actions as an ONNX graph, for controllers without Python.

Inputs are the covariates of n states as numbers, in double precision, in the order of `Covariates.names`, and the
stage, from 1; outputs are what the policy goes by, −∞ where an action is not possible, and the number of the best
action. The metadata of the model name actions and covariates; text among these is an indicator of each category but the
first. Each function below is the line of `FlatPolicy.valued` that it is named after.
"""

from typing import Any

import numpy as np
from onnx import TensorProto, helper

from halfseen.learning.flat_policy import FlatPolicy
from halfseen.policies.onnx_graph import ACTION, SCORES, Graph, kernel_features, leaning

COVARIATES, STAGE = "covariates", "stage"


def flat_graph(policy: FlatPolicy) -> tuple[Any, dict[str, Any]]:
    """Write a policy of named actions as an ONNX model, and what is to be known of it."""
    graph = Graph(np.float64)
    at = graph("Sub", STAGE, np.int64(1))
    possible = graph("Gather", policy.is_possible, at)
    features = COVARIATES if policy.kernel_map is None else kernel_features(graph, COVARIATES, policy.kernel_map)
    ones = graph("Expand", np.float64(1.0), graph("Concat", graph("Shape", COVARIATES, end=1), np.array([1]), axis=0))
    design = graph("Concat", ones, features, axis=1)
    each = graph("Gather", policy.coefficients, at)
    scores = graph("MatMul", design, graph("Transpose", each, perm=[1, 0]))
    if policy.margin is not None:
        margins = _margins(graph, policy, design, at)
        if policy.behaviour is not None:
            utility = graph("MatMul", graph("Concat", ones, COVARIATES, axis=1), policy.behaviour.T)
            margins = graph("Mul", graph("Sub", np.float64(1.0), leaning(graph, utility, possible)), margins)
        scores = graph("Sub", scores, margins)
    graph("Where", possible, scores, np.float64(-np.inf), to=SCORES)
    graph("ArgMax", SCORES, axis=1, keepdims=0, to=ACTION)
    told = {"actions": list(policy.actions), "covariates": list(policy.looks_at.names), "horizon": policy.horizon}
    return _model(graph, policy), told


def _margins(graph: Graph, policy: FlatPolicy, design: str, at: str) -> str:
    """‖Mᵀ (1, features)‖ of each action."""
    each = graph("MatMul", design, graph("Gather", policy.margin, at))
    squares = graph("ReduceSum", graph("Mul", each, each), np.array([2]), keepdims=0)
    return graph("Transpose", graph("Sqrt", squares), perm=[1, 0])


def _model(graph: Graph, policy: FlatPolicy) -> Any:
    inputs = [
        helper.make_tensor_value_info(COVARIATES, TensorProto.DOUBLE, ["n", policy.looks_at.num_features]),
        helper.make_tensor_value_info(STAGE, TensorProto.INT64, []),
    ]
    outputs = [
        helper.make_tensor_value_info(SCORES, TensorProto.DOUBLE, ["n", len(policy.actions)]),
        helper.make_tensor_value_info(ACTION, TensorProto.INT64, ["n"]),
    ]
    return graph.model(inputs, outputs)
