"""ONNX graphs of policies: the builder, the parts common to all, and the graph of named actions.

Each function corresponds to the line of `KernelMap`, `halfseen.learning.behaviour` or `DiscretePolicy.valued` of the
same name.

The inputs of a policy of named actions are the covariates of n states as numbers, in double precision, in the order of
`Covariates.names`, and the stage, from 1; another stage is an error. The outputs are the values that are compared, −∞
for an impossible action, and the index of the best action, −1 where a value is NaN, as of a NaN covariate. The model's
metadata name actions and covariates; a text covariate is encoded by an indicator of each category but the first.
"""

from typing import Any

import numpy as np
from onnx import TensorProto, helper, numpy_helper

from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.learning.q_space import KernelMap

OPSET, IR_VERSION = 18, 9
SCORES, ACTION = "scores", "action"
_OF = {np.float64: TensorProto.DOUBLE, np.float32: TensorProto.FLOAT}


class OnnxGraph:
    """Nodes and constants, added as they are used.

    Parameters
    ----------
    precision
        ``np.float32`` or ``np.float64``, for all its numbers.
    """

    def __init__(self, precision: type) -> None:
        self.precision = precision
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, value: Any) -> str:
        """Add an array, and return its name; floats get the precision of the graph, and integers 64 bits."""
        array = np.asarray(value)
        kinds = {"f": self.precision, "i": np.int64}
        array = array.astype(kinds.get(array.dtype.kind, array.dtype))
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(array).reshape(array.shape), name))
        return name

    def __call__(self, operator: str, *inputs: Any, to: str | None = None, **attributes: Any) -> str:
        """Add an operator, and return the name of its output."""
        names = [one if isinstance(one, str) else self.constant(one) for one in inputs]
        name = to or f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, names, [name], **attributes))
        return name

    def as_number(self, value: str) -> str:
        """Convert booleans or integers to floats."""
        return self._cast(value, _OF[self.precision])

    def as_count(self, value: str) -> str:
        """Convert floats to 64-bit integers."""
        return self._cast(value, TensorProto.INT64)

    def _cast(self, value: str, kind: int) -> str:
        name = f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node("Cast", [value], [name], to=kind))
        return name

    def total(self, value: str, axis: int, *, keeps: bool = False) -> str:
        """Sum over an axis."""
        return self("ReduceSum", value, np.array([axis]), keepdims=int(keeps))

    def model(self, inputs: list[Any], outputs: list[Any]) -> Any:
        """Return the graph as a model."""
        made = helper.make_graph(self.nodes, "policy", inputs, outputs, self.constants)
        return helper.make_model(made, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)


def kernel_features(graph: OnnxGraph, features: str, psi: KernelMap) -> str:
    """ψ(x) of each row."""
    scaled = graph("Div", graph("Sub", features, np.asarray(psi.centre)), np.asarray(psi.scale))
    landmarks = np.asarray(psi.landmarks, dtype=np.float64)
    square = graph.total(graph("Mul", scaled, scaled), 1, keeps=True)
    far = graph("Add", square, np.sum(landmarks**2, axis=1))
    distance = graph("Max", graph("Sub", far, graph("MatMul", scaled, 2.0 * landmarks.T)), np.float64(0.0))
    smooth = graph("MatMul", graph("Exp", graph("Mul", distance, -np.float64(psi.gamma))), np.asarray(psi.projection))
    if psi.trend is None:
        return smooth
    one, other = np.triu_indices(landmarks.shape[1])
    products = graph("Mul", graph("Gather", scaled, one, axis=1), graph("Gather", scaled, other, axis=1))
    trend = graph("Mul", graph("Concat", scaled, products, axis=1), np.asarray(psi.trend))
    return graph("Concat", trend, smooth, axis=1)


def excess_propensity(graph: OnnxGraph, utility: str, possible: str) -> str:
    """Excess of the log's propensity over chance, for each action; actions are the last axis."""
    odds = graph("Softmax", graph("Where", possible, utility, np.float64(-np.inf)), axis=-1)
    num_possible = graph.total(graph.as_number(possible), -1, keeps=True)
    chance = graph("Div", np.float64(1.0), graph("Max", num_possible, np.float64(2.0)))
    far = graph("Div", graph("Sub", odds, chance), graph("Sub", np.float64(1.0), chance))
    return graph("Clip", far, np.float64(0.0), np.float64(1.0))


def choose(
    graph: OnnxGraph,
    possible: str,
    scores: str,
    margins: str | None,
    utility: str | None,
    behaviour_weight: float = 0.0,
) -> None:
    """Subtract margins from the scores, smaller ones for actions common in the log, and take the best; actions last."""
    nothing = np.float64(-np.inf)
    if margins is not None:
        if utility is not None:
            margins = graph("Mul", graph("Sub", np.float64(1.0), excess_propensity(graph, utility, possible)), margins)
        scores = graph("Sub", scores, margins)
    if behaviour_weight > 0:
        prefers = graph("LogSoftmax", graph("Where", possible, utility, nothing), axis=-1)
        scores = graph("Add", scores, graph("Mul", np.float64(behaviour_weight), prefers))
    graph("Where", possible, scores, nothing, to=SCORES)
    num_nan = graph.total(graph.as_number(graph("IsNaN", SCORES)), -1)
    # Otherwise NaN would be the largest, and the first action the best.
    is_known = graph("Equal", num_nan, np.float64(0.0))
    graph("Where", is_known, graph("ArgMax", SCORES, axis=-1, keepdims=0), np.int64(-1), to=ACTION)


def place_of(graph: OnnxGraph, count: str, most: int) -> str:
    """Index of a count from 1 to `most`; of any other an index that is refused, as a negative one would be wrapped."""
    at = graph("Sub", count, np.int64(1))
    return graph("Where", graph("Less", at, np.int64(0)), np.int64(most), at)


COVARIATES, STAGE = "covariates", "stage"


def discrete_graph(policy: DiscretePolicy) -> tuple[Any, dict[str, Any]]:
    """Convert a policy of named actions to an ONNX model, and return its metadata."""
    graph = OnnxGraph(np.float64)
    at = place_of(graph, STAGE, policy.horizon)
    possible = graph("Gather", policy.is_possible, at)
    features = COVARIATES if policy.kernel_map is None else kernel_features(graph, COVARIATES, policy.kernel_map)
    ones = graph("Expand", np.float64(1.0), graph("Concat", graph("Shape", COVARIATES, end=1), np.array([1]), axis=0))
    design = graph("Concat", ones, features, axis=1)
    each = graph("Gather", policy.coefficients, at)
    scores = graph("MatMul", design, graph("Transpose", each, perm=[1, 0]))
    margins = utility = None
    if policy.margin is not None:
        # ‖Mᵀ (1, features)‖ of each action.
        deviations = graph("MatMul", design, graph("Gather", policy.margin, at))
        lengths = graph("Sqrt", graph.total(graph("Mul", deviations, deviations), 2))
        margins = graph("Transpose", lengths, perm=[1, 0])
    if policy.margin is not None and policy.behaviour is not None:
        utility = graph("MatMul", graph("Concat", ones, COVARIATES, axis=1), policy.behaviour.T)
    choose(graph, possible, scores, margins, utility, policy.behaviour_weight)
    properties = {"actions": list(policy.actions), "covariates": list(policy.looks_at.names), "horizon": policy.horizon}
    inputs = [
        helper.make_tensor_value_info(COVARIATES, TensorProto.DOUBLE, ["n", policy.looks_at.num_features]),
        helper.make_tensor_value_info(STAGE, TensorProto.INT64, []),
    ]
    outputs = [
        helper.make_tensor_value_info(SCORES, TensorProto.DOUBLE, ["n", len(policy.actions)]),
        helper.make_tensor_value_info(ACTION, TensorProto.INT64, ["n"]),
    ]
    return graph.model(inputs, outputs), properties
