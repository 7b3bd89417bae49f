"""Policies as ONNX models, for controllers without Python; the metadata describe inputs and outputs in JSON.

A table policy is converted from the formulas of `halfseen.tables.features`, operator by operator. The inputs are the
fields of `TableState`, for a fixed number of objects; fields of absent objects are 0 and False. The outputs are the
compared values of each action, −∞ if it is impossible, and the index of the best action. Each function corresponds to
the one of `features`, `GraspTable` or `LinearTablePolicy` of the same name.
"""

import json
from dataclasses import asdict
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import onnx
from onnx import TensorProto, helper

import halfseen
from halfseen.errors import ArgumentError, PolicyError
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.policies.folder.stored import StoredPolicy
from halfseen.policies.onnx_graph import ACTION, SCORES, OnnxGraph, choose, discrete_graph, kernel_features, place_of
from halfseen.tables.features import LEAST_IN_SIGHT, LIKELY_ODDS, NUM_FEATURES, NUM_TABLE_FEATURES, ROUNDING
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


class _State(NamedTuple):
    """Quantities computed from a state before its features."""

    is_dirty: str
    in_sight: str
    laid_bare: str
    """[j, i], how much more of j would be visible without i."""
    successes: str
    failures: str


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
    graph, actions = OnnxGraph(np.float32), ActionSpace(num_objects)
    raw = _features(graph, num_objects, policy.grasp)
    phi = raw if policy.kernel_map is None else kernel_features(graph, raw, policy.kernel_map)
    design, verbs = _with_one(graph, phi, actions), actions.verbs
    at = place_of(graph, graph.as_count("steps_to_go"), policy.coefficients.shape[-3])
    possible = _possible(graph, policy, at, verbs)
    scores = _dot(graph, design, graph("Gather", graph("Gather", policy.coefficients, at), verbs))
    margins = None if policy.margin is None else _margins(graph, policy, design, at, verbs)
    utility = None
    if policy.behaviour is not None:
        utility = _dot(graph, _with_one(graph, raw, actions), np.asarray(policy.behaviour)[verbs])
    choose(graph, possible, scores, margins, utility)
    properties = {"actions": list(actions.names), "objects": num_objects, "horizon": horizon}
    outputs = [
        helper.make_tensor_value_info(SCORES, TensorProto.FLOAT, [actions.num_actions]),
        helper.make_tensor_value_info(ACTION, TensorProto.INT64, []),
    ]
    return graph.model(_inputs(horizon, num_objects), outputs), properties


def table_inputs(state: TableState) -> dict[str, np.ndarray]:
    """Return the fields of a state as inputs of the model."""
    return {name: np.asarray(value) for name, value in vars(state).items() if value is not None}


def _inputs(horizon: int, num_objects: int) -> list[Any]:
    none = np.zeros(num_objects, dtype=np.float32)
    layout = Layout(np.zeros((num_objects, num_objects), dtype=np.float32), np.ones(num_objects, dtype=bool), none)
    fields = table_inputs(initial_state(WorldConfig(horizon=horizon), layout))
    kinds = {name: helper.np_dtype_to_tensor_dtype(field.dtype) for name, field in fields.items()}
    return [helper.make_tensor_value_info(name, kinds[name], field.shape) for name, field in fields.items()]


def _features(graph: OnnxGraph, num_objects: int, grasp: Any) -> str:
    """φ of every action, one per row."""
    state = _state(graph, num_objects)
    columns = _columns(graph, state, _ease(graph, state) if grasp is None else _probability(graph, grasp, state))
    summed = [
        graph.total(graph("Where", "is_on_table", each, np.float32(0.0)), 0, keeps=True) for each in columns.table
    ]
    table = graph("Concat", *summed, columns.idle, axis=0)
    every = graph("Expand", graph("Unsqueeze", table, np.array([0])), np.array([num_objects, NUM_TABLE_FEATURES]))
    first = graph("Unsqueeze", graph("Slice", table, np.array([0]), np.array([1])), np.array([0]))
    rows = [graph("Concat", first, np.zeros((1, NUM_FEATURES - 1)), axis=1)]
    for values in (columns.washed, columns.lifted):
        own = graph("Concat", *(graph("Unsqueeze", value, np.array([1])) for value in values), axis=1)
        padding = np.zeros((num_objects, NUM_FEATURES - NUM_TABLE_FEATURES - len(values)))
        rows.append(graph("Concat", every, own, *([padding] if padding.size else []), axis=1))
    return graph("Concat", *rows, axis=0)


def _state(graph: OnnxGraph, num_objects: int) -> _State:
    """Counts of attempts, and which objects are in sight."""
    in_column = graph("Unsqueeze", "is_on_table", np.array([0]))
    seen = graph("Max", graph("Sub", np.float32(1.0), "hides"), np.float32(LEAST_IN_SIGHT))
    left = graph("Where", in_column, seen, np.float32(1.0))
    in_sight = graph("ReduceProd", left, np.array([1]), keepdims=0)
    more = graph("Sub", graph("Reciprocal", left), np.float32(1.0))
    more = graph("Mul", graph("Unsqueeze", in_sight, np.array([1])), more)
    laid_bare = graph("Where", graph("Unsqueeze", "is_on_table", np.array([1])), more, np.float32(0.0))
    tried = graph("Unsqueeze", graph.as_count("attempt_object"), np.array([0]))
    is_mine = graph("Equal", tried, np.arange(num_objects)[:, None])
    held = graph("Unsqueeze", "attempt_succeeded", np.array([0]))
    counts = [graph.total(graph.as_number(graph("And", is_mine, which)), 1) for which in (held, graph("Not", held))]
    return _State(graph("Sigmoid", "log_odds"), in_sight, laid_bare, *counts)


def _ease(graph: OnnxGraph, state: _State) -> str:
    """Share in sight, times the rule of succession."""
    odds = graph("Add", np.float32(LIKELY_ODDS), graph("Exp", graph("Neg", "grip")))
    likelier = graph("Div", np.float32(1.0 + LIKELY_ODDS), odds)
    held = graph("Add", np.float32(1.0), state.successes)
    rate = graph("Div", held, graph("Add", held, state.failures))
    return graph("Mul", state.in_sight, graph("Mul", rate, likelier))


def _probability(graph: OnnxGraph, grasp: Any, state: _State) -> str:
    """Look up P(held) in a table."""
    if not isinstance(grasp, GraspTable):
        raise ArgumentError(f"grasp is a {type(grasp).__name__}, but ONNX can hold only a table of numbers")
    num_cells, most = grasp.probabilities.shape[0] - 1, grasp.probabilities.shape[-1] - 1
    not_hidden = graph("Sub", np.float32(1.0), "hides")
    shown = graph("Where", graph("Unsqueeze", "is_on_table", np.array([0])), not_hidden, np.float32(1.0))
    occluded = graph("Sub", np.float32(1.0), graph("ReduceProd", shown, np.array([1]), keepdims=0))
    place = graph("Mul", graph("Clip", occluded, np.float32(0.0), np.float32(1.0)), np.float32(num_cells))
    below = graph("Clip", graph("Floor", place), np.float32(0.0), np.float32(num_cells - 1))
    counts = [_index(graph, graph("Min", each, np.float32(most))) for each in (state.successes, state.failures)]

    def read(level: str) -> str:
        at = graph("Concat", _index(graph, level), *counts, axis=1)
        return graph("GatherND", np.asarray(grasp.probabilities), at)

    low, high = read(below), read(graph("Add", below, np.float32(1.0)))
    chance = graph("Add", low, graph("Mul", graph("Sub", place, below), graph("Sub", high, low)))
    shift = graph("Exp", graph("Mul", "grip", -np.float32(grasp.per_grip)))
    misses = graph("Mul", graph("Sub", np.float32(1.0), chance), graph("Sub", shift, np.float32(1.0)))
    return graph("Div", chance, graph("Add", np.float32(1.0), misses))


def _index(graph: OnnxGraph, value: str) -> str:
    return graph("Unsqueeze", graph.as_count(value), np.array([1]))


class _Columns(NamedTuple):
    """The columns that features are made of, as in `halfseen.tables.features.table_columns`."""

    table: list[str]
    idle: str
    washed: list[str]
    lifted: list[str]


def _columns(graph: OnnxGraph, state: _State, ease: str) -> _Columns:
    by, less, p = partial(graph, "Mul"), partial(graph, "Sub"), state.is_dirty

    def behind(value: str) -> str:
        row = graph("MatMul", graph("Unsqueeze", value, np.array([0])), state.laid_bare)
        return graph("Squeeze", row, np.array([0]))

    def win_after_look(shown: str) -> str:
        step, over = graph("Div", shown, np.float32(4.0)), less(p, np.float32(0.5))
        either = [graph("Relu", graph(operator, over, step)) for operator in ("Add", "Sub")]
        return by(np.float32(0.5), graph("Add", *either))

    unseen = less(np.float32(1.0), "seen")
    win, sure = (graph("Relu", less(p, np.float32(least))) for least in (0.5, 0.75))
    doubt = by(np.float32(4.0), by(p, less(np.float32(1.0), p)))
    is_seen = graph("Greater", "seen", np.float32(0.0))
    soon = by(ease, win_after_look(graph("Where", is_seen, np.float32(0.0), state.in_sight)))
    clearer = by(ease, less(by(ease, win_after_look(unseen)), soon))
    unseen_doubt = by(doubt, unseen)
    bare_win, bare_doubt = (by(ease, behind(value)) for value in (win, unseen_doubt))
    at_stake = [win, by(win, ease), sure, by(sure, ease)]
    best = graph("Where", "is_on_table", soon, np.float32(0.0))
    largest = graph("ReduceMax", best, np.array([0]), keepdims=1)
    ones = graph("Add", by(p, np.float32(0.0)), np.float32(1.0))
    is_gained = graph("Greater", clearer, np.float32(ROUNDING))
    gained = graph("Where", is_gained, clearer, np.float32(0.0))
    return _Columns(
        table=[p, ones, *at_stake, doubt, ease, by(doubt, ease), soon],
        idle=graph("Exp", by(largest, np.float32(-8.0))),
        washed=[bare_win, bare_doubt, p, by(p, ease), ease, *at_stake, soon, by(soon, ease)],
        lifted=[bare_doubt, unseen_doubt, ease, by(unseen_doubt, ease), gained],
    )


def _with_one(graph: OnnxGraph, features: str, actions: ActionSpace) -> str:
    return graph("Concat", np.ones((actions.num_actions, 1)), features, axis=1)


def _dot(graph: OnnxGraph, design: str, coefficients: Any) -> str:
    return graph.total(graph("Mul", design, coefficients), 1)


def _margins(graph: OnnxGraph, policy: LinearTablePolicy, design: str, at: str, verbs: np.ndarray) -> str:
    each = graph("Gather", graph("Gather", np.asarray(policy.margin), at), verbs)
    deviations = graph("MatMul", graph("Unsqueeze", design, np.array([1])), each)
    return graph("Squeeze", graph("Sqrt", graph.total(graph("Mul", deviations, deviations), 2)), np.array([1]))


def _possible(graph: OnnxGraph, policy: LinearTablePolicy, at: str, verbs: np.ndarray) -> str:
    allowed = graph("Concat", np.ones(1, dtype=bool), "is_on_table", "is_on_table", axis=0)
    if policy.is_seen is None:
        return allowed
    both = graph("And", allowed, graph("Gather", graph("Gather", np.asarray(policy.is_seen), at), verbs))
    is_none = graph("Equal", graph.total(graph.as_number(both), 0, keeps=True), np.float32(0.0))
    return graph("Or", both, graph("And", allowed, is_none))
