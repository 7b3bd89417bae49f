"""A policy as an ONNX model, for controllers without Python; its metadata say what it takes and gives, in JSON."""

import json

import onnx
from onnx import helper

import halfseen
from halfseen.errors import ArgumentError, PolicyError
from halfseen.learning.flat_policy import FlatPolicy
from halfseen.policies.folder.stored import StoredPolicy
from halfseen.policies.onnx_flat import flat_graph
from halfseen.tables.policy import LinearTablePolicy


def onnx_model(stored: StoredPolicy, num_objects: int | None = None) -> bytes:
    """Write a policy as an ONNX model.

    Parameters
    ----------
    stored
        A policy of named actions, or of tables for one robot.
    num_objects
        Most objects that a table has; None for as many as the log showed, and for a policy of named actions.

    Raises
    ------
    PolicyError
        It is of another kind.
    ArgumentError
        It holds what ONNX cannot, or `num_objects` is not for it.
    """
    policy = stored.policy
    if isinstance(policy, FlatPolicy):
        if num_objects is not None:
            raise ArgumentError("a number of objects is for policies of tables, and this one is not: leave it out")
        model, told = flat_graph(policy)
    elif isinstance(policy, LinearTablePolicy) and stored.is_table:
        from halfseen.policies.onnx_table import table_graph

        model, told = table_graph(policy, stored.horizon, num_objects or _most_objects(stored))
    else:
        without = "; learn it without laws (halfseen learn --no-laws)" if stored.is_table else ""
        raise PolicyError(f"the policy is of kind {stored.record['kind']!r}, which is not exported: serve it{without}")
    model.producer_name, model.producer_version = "halfseen", halfseen.__version__
    helper.set_model_props(model, {name: json.dumps(value) for name, value in told.items()})
    try:
        onnx.checker.check_model(model)
    except onnx.checker.ValidationError as error:
        raise ArgumentError(f"the policy is none that ONNX can hold ({str(error).splitlines()[0]})") from error
    return model.SerializeToString()


def _most_objects(stored: StoredPolicy) -> int:
    ranges = ((stored.ranges(stage) or {}).get("num_objects") for stage in range(1, stored.horizon + 1))
    most = max((seen[1] for seen in ranges if isinstance(seen, tuple)), default=None)
    if most is None:
        raise ArgumentError("the policy does not say how many objects its log showed: give the number (--objects)")
    return int(most)
