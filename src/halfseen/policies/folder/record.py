"""policy.json: what a policy looks at, what it was learned from and how, and what its weights are worth."""

import json
import platform
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

import numpy as np
from jaxtyping import Bool

import halfseen
from halfseen.censoring import positivity_report, weight_diagnostics
from halfseen.errors import ArgumentError, PolicyError
from halfseen.learners.q_learning.flat_policy import FlatPolicy
from halfseen.learners.q_learning.q_learner import CensoredQLearner
from halfseen.logs import Logs
from halfseen.policies.folder.log_digest import log_digest
from halfseen.policies.folder.seen import seen_states, seen_tables
from halfseen.policies.folder.specification import described
from halfseen.tables.features import NUM_FEATURES
from halfseen.world.action_space import Verb

FORMAT, VERSION = "halfseen-policy", 1

TABLE_FEATURES_VERSION = 1
"""Coefficients mean nothing beside other features: raise this number whenever a feature of a table changes."""

FLAT, TABLE = "flat", "table"

_VERBS = [verb.name for verb in Verb]


def record_of(learner: CensoredQLearner, logs: Logs) -> dict[str, Any]:
    """Describe a fitted learner and its log.

    Raises
    ------
    ArgumentError
        An action has a name that a JSON file cannot hold.
    """
    policy = learner.policy_
    is_flat = isinstance(policy, FlatPolicy)
    is_by_stage = learner.stages == "separate"
    schema = _flat_schema(policy) if is_flat else _table_schema(learner.horizon)
    seen = seen_states(logs, policy.covariates, is_by_stage) if is_flat else seen_tables(logs)
    return {
        "format": FORMAT,
        "version": VERSION,
        "versions": {
            "halfseen": halfseen.__version__,
            "python": platform.python_version(),
            **{name: version(name) for name in ("numpy", "jax")},
        },
        "kind": FLAT if is_flat else TABLE,
        "schema": schema,
        "seen": seen,
        "learner": described(learner.model_),
        "seed": int(learner.random_state),
        "reg": {
            "rows": "stage" if is_by_stage else "steps to go",
            "columns": schema["actions"],
            "values": np.asarray(learner.q_functions_.reg).tolist(),
        },
        "log": {"sha256": log_digest(logs), "sentence": str(logs.summary()), **asdict(logs.summary())},
        "diagnostics": _diagnostics(learner, logs),
    }


def as_json(record: Mapping[str, Any]) -> bytes:
    """Write a record down; the same record gives the same bytes."""
    return (json.dumps(_finite(record), indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def from_json(data: bytes) -> dict[str, Any]:
    """Read a record, and check that it is one of this version.

    Raises
    ------
    PolicyError
        It is no JSON, describes no policy, or one of another version.
    """
    try:
        record: Any = json.loads(data.decode(), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise PolicyError(f"it is no JSON ({error}); learn the policy anew") from error
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise PolicyError("it describes no policy; give a folder that `halfseen learn` wrote")
    if record.get("version") != VERSION:
        raise PolicyError(
            f"version {record.get('version')!r} is not the {VERSION} that halfseen {halfseen.__version__} reads; use "
            "the halfseen that wrote it, or learn the policy anew"
        )
    if record.get("kind") not in (FLAT, TABLE):
        raise PolicyError(f"kind is {record.get('kind')!r}; it is {FLAT!r} or {TABLE!r}: learn the policy anew")
    _names(record, "column_major", (str,))
    for name in ("schema", "learner", "log", "diagnostics", "reg", "versions"):
        _typed(record, name, dict, "an object")
    return record


def horizon_of(record: Mapping[str, Any]) -> int:
    """Number T of stages."""
    horizon = _typed(record["schema"], "horizon", int, "a whole number")
    if horizon < 1:
        raise PolicyError(f"horizon is {horizon}; a path has at least 1 stage: learn the policy anew")
    return horizon


def check_features(record: Mapping[str, Any]) -> None:
    """Refuse a policy of tables whose features are not those of this halfseen.

    Raises
    ------
    PolicyError
        They are others, so the coefficients would be taken for what they are not.
    """
    told, known = record["schema"].get("features"), _table_schema(1)["features"]
    if told != known or record["schema"].get("actions") != _VERBS:
        raise PolicyError(
            f"the policy looks at features {told}, and this halfseen knows {known}; use the halfseen that wrote it "
            f"({record['versions'].get('halfseen')}), or learn the policy anew"
        )


def names_of(record: Mapping[str, Any]) -> tuple[tuple[int | str, ...], tuple[str, ...], Bool[np.ndarray, "T A"]]:
    """Actions and covariates of a policy of named actions, and which actions each stage allows.

    Raises
    ------
    PolicyError
        A name is none, is there twice, or a stage allows none of the actions.
    """
    schema, horizon = record["schema"], horizon_of(record)
    actions = _names(schema, "actions", (int, str))
    covariates = _names(schema, "covariates", (str,))
    possible = _typed(schema, "possible", list, "a list")
    is_right = len(possible) == horizon and all(isinstance(names, list) and names for names in possible)
    if not is_right or not all(name in actions for names in possible for name in names):
        raise PolicyError(f"possible is {possible}; it lists some of the actions for each of the {horizon} stages")
    return actions, covariates, np.array([[name in names for name in actions] for names in possible])


def _flat_schema(policy: FlatPolicy) -> dict[str, Any]:
    names = [_action_name(name) for name in policy.actions]
    return {
        "horizon": policy.horizon,
        "covariates": list(policy.covariates),
        "actions": names,
        "possible": [[name for name, is_it in zip(names, row, strict=True) if is_it] for row in policy.is_possible],
    }


def _table_schema(horizon: int) -> dict[str, Any]:
    features = {"of": "table", "version": TABLE_FEATURES_VERSION, "number": NUM_FEATURES}
    return {"horizon": horizon, "actions": _VERBS, "features": features}


def _action_name(name: Any) -> int | str:
    value = name.item() if isinstance(name, np.generic) else name
    if isinstance(value, bool) or not isinstance(value, (int, str)):
        raise ArgumentError(f"action {name!r} is neither a whole number nor text; a folder cannot hold other names")
    return value


def _diagnostics(learner: CensoredQLearner, logs: Logs) -> dict[str, Any]:
    positivity = positivity_report(logs.end_s, logs.is_finished, path_ids=logs.path_ids)
    by_stage = [
        weight_diagnostics(column, getattr(learner.model_.targets, "truncate_at", None))
        for column in learner.weights_[:, : logs.horizon].T
    ]
    return {
        "weights": asdict(learner.diagnostics_),
        "weights_by_stage": [asdict(one) for one in by_stage],
        "positivity": {
            "censoring": "kaplan-meier by path",
            "text": str(positivity),
            "is_sound": positivity.is_sound,
            "mean_weight": positivity.mean_weight,
            "identified_until_s": positivity.identified_until_s,
        },
    }


def _finite(value: Any) -> Any:
    """Write null for a number that JSON does not have."""
    if isinstance(value, Mapping):
        return {str(key): _finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(entry) for entry in value]
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _typed(record: Mapping[str, Any], name: str, kind: type, what: str) -> Any:
    value = record.get(name)
    if not isinstance(value, kind) or isinstance(value, bool):
        raise PolicyError(f"{name} is {value!r} and not {what}; learn the policy anew")
    return value


def _names(schema: Mapping[str, Any], name: str, kinds: tuple[type, ...]) -> tuple[Any, ...]:
    names = _typed(schema, name, list, "a list")
    is_right = all(isinstance(one, kinds) and not isinstance(one, bool) for one in names)
    if not is_right or len(set(names)) < len(names):
        raise PolicyError(f"{name} is {names}; each has a name of its own: learn the policy anew")
    return tuple(names)


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no number of JSON")
