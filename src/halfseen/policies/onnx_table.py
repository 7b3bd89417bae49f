"""A policy of tables as an ONNX graph: what JAX computes of one `TableState`, operator by operator.

Inputs are the fields of `TableState`, for a fixed number of objects; those of objects that are not there are 0 and
False. Outputs are what the policy goes by for each action, −∞ where it is not possible, and the number of the best one.
"""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxpr_as_fun
from jax2onnx import to_onnx

from halfseen.policies.onnx_flat import ACTION, IR_VERSION, OPSET, SCORES
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world.action_space import ActionSpace
from halfseen.world.config import WorldConfig
from halfseen.world.state import Layout, TableState, initial_state


def table_graph(policy: LinearTablePolicy, horizon: int, num_objects: int) -> tuple[Any, dict[str, Any]]:
    """Write a policy of tables as an ONNX model, and what is to be known of it.

    Parameters
    ----------
    policy
        The policy.
    horizon
        Number T of stages that a path may have.
    num_objects
        Most objects that a table has.
    """

    def valued(*leaves: Any) -> tuple[Any, Any]:
        scores = policy.q_values(TableState(**dict(zip(fields, leaves, strict=True))))
        return scores, jnp.argmax(scores).astype(jnp.int32)

    fields = _fields(horizon, num_objects)
    # The operators that JAX comes down to, rather than its functions, of which the converter does not know them all.
    operators = jaxpr_as_fun(jax.make_jaxpr(valued)(*fields.values()))
    model: Any = to_onnx(
        operators,
        list(fields.values()),
        model_name="policy",
        opset=OPSET,
        input_names=list(fields),
        output_names=[SCORES, ACTION],
    )
    model.ir_version = IR_VERSION
    _leave_out_unused(model.graph)
    return model, {"actions": list(ActionSpace(num_objects).names), "objects": num_objects, "horizon": horizon}


def table_inputs(state: TableState) -> dict[str, np.ndarray]:
    """Give the fields of a state as the inputs of the model."""
    return {name: np.asarray(value) for name, value in vars(state).items() if value is not None}


def _fields(horizon: int, num_objects: int) -> Mapping[str, jax.ShapeDtypeStruct]:
    none = np.zeros(num_objects, dtype=np.float32)
    layout = Layout(jnp.zeros((num_objects, num_objects), jnp.float32), jnp.ones(num_objects, bool), jnp.asarray(none))
    state = initial_state(WorldConfig(horizon=horizon), layout)
    return {name: jax.ShapeDtypeStruct(each.shape, each.dtype) for name, each in table_inputs(state).items()}


def _leave_out_unused(graph: Any) -> None:
    used = {name for node in graph.node for name in node.input} | {each.name for each in graph.output}
    kept = [each for each in graph.initializer if each.name in used]
    del graph.initializer[:]
    graph.initializer.extend(kept)
