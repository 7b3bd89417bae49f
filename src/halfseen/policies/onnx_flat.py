"""A policy of named actions as an ONNX graph, for controllers without Python.

Inputs are the covariates of n states as numbers, in double precision, in the order of `Covariates.names`, and the
stage, from 1; outputs are what the policy goes by, −∞ where an action is not possible, and the number of the best
action. The metadata of the model name actions and covariates; text among these is an indicator of each category but the
first. Each function below is the line of `FlatPolicy.valued`, or of `KernelMap`, that it is named after.
"""

from typing import Any

import numpy as np
from onnx import TensorProto, helper, numpy_helper

from halfseen.learning.flat_policy import FlatPolicy
from halfseen.learning.kernel_map import KernelMap

OPSET, IR_VERSION = 18, 9
COVARIATES, STAGE, SCORES, ACTION = "covariates", "stage", "scores", "action"


class _Graph:
    """Nodes and constants, written down as they are asked for."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, value: Any) -> str:
        array = np.asarray(value)
        array = array.astype(np.float64) if array.dtype.kind == "f" else array
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(array).reshape(array.shape), name))
        return name

    def __call__(self, operator: str, *inputs: Any, to: str | None = None, **attributes: Any) -> str:
        names = [one if isinstance(one, str) else self.constant(one) for one in inputs]
        name = to or f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, names, [name], **attributes))
        return name

    def cast(self, truth: str) -> str:
        name = f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node("Cast", [truth], [name], to=TensorProto.DOUBLE))
        return name


def flat_graph(policy: FlatPolicy) -> tuple[Any, dict[str, Any]]:
    """Write a policy of named actions as an ONNX model, and what is to be known of it."""
    graph = _Graph()
    at = graph("Sub", STAGE, np.int64(1))
    possible = graph("Gather", policy.is_possible, at)
    features = COVARIATES if policy.kernel_map is None else _features(graph, policy.kernel_map)
    ones = graph("Expand", np.float64(1.0), graph("Concat", graph("Shape", COVARIATES, end=1), np.array([1]), axis=0))
    design = graph("Concat", ones, features, axis=1)
    each = graph("Gather", policy.coefficients, at)
    scores = graph("MatMul", design, graph("Transpose", each, perm=[1, 0]))
    if policy.margin is not None:
        margins = _margins(graph, policy, design, at)
        if policy.behaviour is not None:
            utility = graph("MatMul", graph("Concat", ones, COVARIATES, axis=1), policy.behaviour.T)
            margins = graph("Mul", graph("Sub", np.float64(1.0), _leaning(graph, utility, possible)), margins)
        scores = graph("Sub", scores, margins)
    graph("Where", possible, scores, np.float64(-np.inf), to=SCORES)
    graph("ArgMax", SCORES, axis=1, keepdims=0, to=ACTION)
    told = {"actions": list(policy.actions), "covariates": list(policy.looks_at.names), "horizon": policy.horizon}
    return _model(graph, policy), told


def _features(graph: _Graph, psi: KernelMap) -> str:
    """ψ(x)."""
    scaled = graph("Div", graph("Sub", COVARIATES, np.asarray(psi.centre)), np.asarray(psi.scale))
    landmarks = np.asarray(psi.landmarks, dtype=np.float64)
    square = graph("ReduceSum", graph("Mul", scaled, scaled), np.array([1]), keepdims=1)
    far = graph("Add", square, np.sum(landmarks**2, axis=1))
    distance = graph("Max", graph("Sub", far, graph("MatMul", scaled, 2.0 * landmarks.T)), np.float64(0.0))
    smooth = graph("MatMul", graph("Exp", graph("Mul", distance, -np.float64(psi.gamma))), np.asarray(psi.projection))
    if psi.trend is None:
        return smooth
    one, other = np.triu_indices(landmarks.shape[1])
    products = graph("Mul", graph("Gather", scaled, one, axis=1), graph("Gather", scaled, other, axis=1))
    trend = graph("Mul", graph("Concat", scaled, products, axis=1), np.asarray(psi.trend))
    return graph("Concat", trend, smooth, axis=1)


def _margins(graph: _Graph, policy: FlatPolicy, design: str, at: str) -> str:
    """‖Mᵀ (1, features)‖ of each action."""
    each = graph("MatMul", design, graph("Gather", policy.margin, at))
    squares = graph("ReduceSum", graph("Mul", each, each), np.array([2]), keepdims=0)
    return graph("Transpose", graph("Sqrt", squares), perm=[1, 0])


def _leaning(graph: _Graph, utility: str, possible: str) -> str:
    """How far the log's own choice is from chance towards each action."""
    odds = graph("Softmax", graph("Where", possible, utility, np.float64(-np.inf)), axis=1)
    number = graph("ReduceSum", graph.cast(possible), keepdims=1)
    chance = graph("Div", np.float64(1.0), graph("Max", number, np.float64(2.0)))
    far = graph("Div", graph("Sub", odds, chance), graph("Sub", np.float64(1.0), chance))
    return graph("Clip", far, np.float64(0.0), np.float64(1.0))


def _model(graph: _Graph, policy: FlatPolicy) -> Any:
    double, whole = TensorProto.DOUBLE, TensorProto.INT64
    made = helper.make_graph(
        graph.nodes,
        "policy",
        [
            helper.make_tensor_value_info(COVARIATES, double, ["n", policy.looks_at.num_features]),
            helper.make_tensor_value_info(STAGE, whole, []),
        ],
        [
            helper.make_tensor_value_info(SCORES, double, ["n", len(policy.actions)]),
            helper.make_tensor_value_info(ACTION, whole, ["n"]),
        ],
        graph.constants,
    )
    return helper.make_model(made, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
