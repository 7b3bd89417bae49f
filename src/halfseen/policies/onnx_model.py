"""Policies as ONNX models, for controllers without Python; the metadata describe inputs and outputs in JSON.

The outputs are the values that are compared, −∞ for an impossible action, and the index of the best action, −1 where a
value is NaN, as of a NaN input.

The inputs of a policy of tables are the fields of `TableState`, for a fixed number of objects; fields of absent objects
are 0 and False. Those of a policy of named actions are the covariates of n states as numbers, in double precision, in
the order of `Covariates.names`, and the stage, from 1. A text covariate is encoded by an indicator of each category but
the first. A stage or a number of steps to go that there is not is an error.
"""

import json
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import onnx
from onnx import helper

import halfseen
from halfseen.arrays import mapped
from halfseen.errors import ArgumentError, PolicyError
from halfseen.learning.behaviour import excess_propensity, log_chances
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.policies.folder.stored import StoredPolicy
from halfseen.policies.onnx_graph import OnnxGraph
from halfseen.tables.grasp_table import GraspTable
from halfseen.tables.policy import LinearTablePolicy
from halfseen.world.actions import ActionSpace
from halfseen.world.config import WorldConfig
from halfseen.world.state import Layout, TableState, initial_state


def onnx_model(stored: StoredPolicy, num_objects: int | None = None) -> bytes:
    """Convert a policy to an ONNX model.

    Parameters
    ----------
    stored
        A policy of named actions, or of tables for one robot.
    num_objects
        Largest number of objects on a table; None for the log's largest, and for a policy of named actions.

    Raises
    ------
    PolicyError
        The policy is of another kind.
    ArgumentError
        The policy holds what ONNX cannot express, or `num_objects` does not apply to it.
    """
    policy = stored.policy
    if isinstance(policy, DiscretePolicy):
        if num_objects is not None:
            raise ArgumentError(
                "a number of objects is for policies of tables, but this policy is of named actions: leave it out"
            )
        model, properties = discrete_graph(policy)
        # The controller itself fills in missing covariates and their flags, before it runs the model.
        properties |= {} if policy.filling is None else {"missing": asdict(policy.filling)}
    elif isinstance(policy, LinearTablePolicy) and stored.is_table:
        model, properties = table_graph(policy, stored.horizon, num_objects or _most_objects(stored))
    else:
        without = ", or learn it without laws (halfseen learn --no-laws)" if stored.is_table else ""
        raise PolicyError(
            f"the policy is of kind {stored.record['kind']!r}, which cannot be exported: serve it{without}"
        )
    model.producer_name, model.producer_version = "halfseen", halfseen.__version__
    helper.set_model_props(model, {name: json.dumps(value) for name, value in properties.items()})
    try:
        onnx.checker.check_model(model)
    except onnx.checker.ValidationError as error:
        raise ArgumentError(f"ONNX cannot hold the policy ({str(error).splitlines()[0]})") from error
    return model.SerializeToString()


def _most_objects(stored: StoredPolicy) -> int:
    ranges = ((stored.ranges(stage) or {}).get("num_objects") for stage in range(1, stored.horizon + 1))
    most = max((seen[1] for seen in ranges if isinstance(seen, tuple)), default=None)
    if most is None:
        raise ArgumentError("the policy does not say how many objects its log showed: give the number (--objects)")
    return int(most)


def discrete_graph(policy: DiscretePolicy) -> tuple[Any, dict[str, Any]]:
    """Convert a policy of named actions to an ONNX model, and return its metadata."""
    graph, num_features = OnnxGraph(), policy.looks_at.num_features
    covariates = graph.input("covariates", np.zeros((2, num_features)), ("n", num_features))
    stage = graph.input("stage", np.array(1))
    at = _from_one(stage, policy.horizon) - 1
    each, possible = (graph.constant(of)[at] for of in (policy.coefficients, policy.is_possible))
    features: Any = covariates if policy.kernel_map is None else policy.kernel_map(covariates)
    scores, margins = each[:, 0] + features @ each[:, 1:].T, np.zeros(len(policy.actions))
    if policy.margin is not None:
        roots = graph.constant(policy.margin)[at]
        deviations = [roots[k, 0] + features @ roots[k, 1:] for k in range(len(policy.actions))]
        margins = np.sqrt(np.sum(np.stack(deviations, axis=1) ** 2, axis=-1))
    if policy.behaviour is not None:
        utility = policy.behaviour[:, 0] + covariates @ policy.behaviour[:, 1:].T
        margins = (1.0 - excess_propensity(utility, possible)) * margins
        if policy.behaviour_weight > 0:
            scores = scores + policy.behaviour_weight * log_chances(utility, possible)
    model = _model(graph, np.where(possible, scores - margins, -np.inf), ["n"])
    names = {"actions": list(policy.actions), "covariates": list(policy.looks_at.names)}
    return model, names | {"horizon": policy.horizon}


def table_graph(policy: LinearTablePolicy, horizon: int, num_objects: int) -> tuple[Any, dict[str, Any]]:
    """Convert a table policy to an ONNX model, and return its metadata.

    Parameters
    ----------
    policy
        The policy.
    horizon
        Largest number T of stages of a trajectory.
    num_objects
        Largest number of objects on a table.

    Raises
    ------
    ArgumentError
        The grasp model is no table of numbers.
    """
    if not isinstance(policy.grasp, GraspTable | None):
        raise ArgumentError(f"grasp is a {type(policy.grasp).__name__}, but ONNX can hold only a table of numbers")
    graph, none = OnnxGraph(), np.zeros(num_objects, dtype=np.float32)
    layout = Layout(np.zeros((num_objects, num_objects), dtype=np.float32), np.ones(num_objects, dtype=bool), none)
    example = initial_state(WorldConfig(horizon=horizon), layout)
    state = replace(example, **{name: graph.input(name, field) for name, field in table_inputs(example).items()})
    known, to_go = mapped(graph.constant, policy), _from_one(state.steps_to_go, policy.coefficients.shape[-3])
    model = _model(graph, known.q_values(replace(state, steps_to_go=to_go)), [])
    return model, {"actions": list(ActionSpace(num_objects).names), "objects": num_objects, "horizon": horizon}


def table_inputs(state: TableState) -> dict[str, np.ndarray]:
    """Return the fields of a state as inputs of the model."""
    return {name: np.asarray(value) for name, value in vars(state).items() if value is not None}


def _from_one(count: Any, most: int) -> Any:
    """A count from 1; for one below it, a count that has no place, as its index would be wrapped around to the end."""
    return np.where(count < 1, most + 1, count)


def _model(graph: OnnxGraph, scores: Any, batch: list[str]) -> Any:
    """The model of scores and their best action; of NaN there is none, as it would be the largest."""
    is_known = np.sum(np.isnan(scores), axis=-1) == 0
    best = np.where(is_known, np.argmax(scores, axis=-1), -1)
    return graph.model({"scores": (scores, (*batch, scores.shape[-1])), "action": (best, tuple(batch))})
