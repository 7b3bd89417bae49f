"""Policies of tables in a folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from halfseen.errors import ArgumentError, PolicyError
from halfseen.logs import Logs
from halfseen.policies.folder.arrays import (
    BEHAVIOUR,
    COEFFICIENTS,
    GRASP,
    MARGIN,
    PER_GRIP,
    Arrays,
    Shape,
    check_arrays,
    kernel_map_of,
    policy_arrays,
)
from halfseen.policies.folder.json_values import horizon_of, typed
from halfseen.policies.folder.seen_tables import TABLE_RANGES, seen_tables
from halfseen.tables.features import FEATURES_VERSION, NUM_FEATURES
from halfseen.tables.grasp.grasp_table import GraspTable
from halfseen.tables.prior import PriorFacts, dirty_share, prior_facts
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world.action_space import Verb

_VERBS = [verb.name for verb in Verb]
_FEATURES = {"of": "table", "version": FEATURES_VERSION, "number": NUM_FEATURES}


@dataclass(frozen=True)
class TableKind:
    """Kind ``"table"``: a `LinearTablePolicy`, in single precision, as it decides."""

    policy_type = LinearTablePolicy

    def facts(self, logs: Logs) -> "TableFacts":
        """What a log tells of the prior, of views and of rewards."""
        return TableFacts(prior_facts(logs), counts_views(logs), _least_rewards(logs))

    def schema(self, policy: LinearTablePolicy, facts: Sequence["TableFacts"]) -> dict[str, Any]:
        """Verbs, features, the prior of DIRTY that the log-odds of the log started from, what looks and verbs told."""
        paid = {verb: [part.least_rewards[verb] for part in facts if verb in part.least_rewards] for verb in _VERBS}
        return {
            "horizon": len(policy.coefficients),
            "actions": _VERBS,
            "features": _FEATURES,
            "dirty_share": dirty_share([part.prior for part in facts]),
            "counts_views": any(part.counts_views for part in facts),
            "seen": _seen_verbs(policy),
            "least_rewards": {verb: min(least) for verb, least in paid.items() if least},
        }

    def seen(self, logs: Logs, policy: LinearTablePolicy, is_by_stage: bool) -> list[dict[str, Any]]:
        """Ranges over all stages: tables are alike in every stage."""
        return seen_tables(logs)

    def range_names(self, policy: LinearTablePolicy) -> tuple[str, ...]:
        """What the ranges are of."""
        return TABLE_RANGES

    def arrays_of(self, policy: LinearTablePolicy) -> dict[str, np.ndarray]:
        """Coefficients, and the kernel, the margin, the behaviour policy and the grasp model if there are.

        Raises
        ------
        ArgumentError
            The grasp model is no table of numbers.
        """
        arrays = policy_arrays(policy)
        if isinstance(policy.grasp, GraspTable):
            arrays[GRASP] = np.asarray(policy.grasp.probabilities)
            arrays[PER_GRIP] = np.asarray(policy.grasp.per_grip, dtype=np.float32)
        elif policy.grasp is not None:
            raise ArgumentError(
                f"grasp is a {type(policy.grasp).__name__}, whose code a folder cannot hold; learn with BetaGrasp() or "
                "SVMGrasp()"
            )
        return arrays

    def policy_of(self, record: Mapping[str, Any], arrays: Arrays) -> LinearTablePolicy:
        """Put a policy together again.

        Raises
        ------
        PolicyError
            Its features are not those of this halfseen, its prior is none, or arrays do not fit.
        """
        _check_schema(record)
        check_arrays(arrays, Shape(horizon_of(record), len(Verb), NUM_FEATURES, np.float32), may_grasp=True)
        on_device: Any = {name: jnp.asarray(array) for name, array in arrays.items()}
        grasp = GraspTable(on_device[GRASP], on_device.get(PER_GRIP, 1.0)) if GRASP in arrays else None
        kernel_map, margin = kernel_map_of(on_device), on_device.get(MARGIN)
        behaviour = on_device.get(BEHAVIOUR)
        return LinearTablePolicy(on_device[COEFFICIENTS], grasp, kernel_map, _is_seen(record), margin, behaviour)


class TableFacts(NamedTuple):
    """What the schema needs of a log, or of a part of it."""

    prior: PriorFacts
    counts_views: bool
    least_rewards: dict[str, float]


def _seen_verbs(policy: LinearTablePolicy) -> list[list[str]]:
    """Verbs that have a value, by steps to go; where none has, as in a stage that no path reached, all may be taken."""
    if policy.is_seen is None:
        return [_VERBS] * len(policy.coefficients)
    rows = np.asarray(policy.is_seen)
    return [[verb for verb, is_it in zip(_VERBS, row, strict=True) if is_it] or _VERBS for row in rows]


def _is_seen(record: Mapping[str, Any]) -> Any:
    """Which verbs have a value; None for all, as in a folder that does not say."""
    if "seen" not in record["schema"]:
        return None
    seen = typed(record["schema"], "seen", list, "a list of verbs for each number of steps to go")
    is_right = len(seen) == horizon_of(record) and all(isinstance(row, list) and row for row in seen)
    if not is_right or not all(verb in _VERBS for row in seen for verb in row):
        raise PolicyError(f"seen is {seen}; it lists verbs for each number of steps to go: learn the policy anew")
    rows = np.array([[verb in row for verb in _VERBS] for row in seen])
    return None if rows.all() else jnp.asarray(rows)


def _least_rewards(logs: Logs) -> dict[str, float]:
    """The least that each verb paid, where a stage of it was completed."""
    done: Any = logs.stages[logs.stages["reward"].notna()]
    paid = {str(verb): float(least) for verb, least in done.groupby("action", observed=True)["reward"].min().items()}
    return {verb: paid[verb] for verb in _VERBS if verb in paid}


def counts_views(logs: Logs) -> bool:
    """Whether the recorder counted how much of an object has been in view, so that a second look may be no news."""
    return logs.objects is not None and "seen" in logs.objects.columns and bool((logs.objects["seen"] > 0.0).any())


def _check_schema(record: Mapping[str, Any]) -> None:
    schema = record["schema"]
    features = schema.get("features")
    if features != _FEATURES or schema.get("actions") != _VERBS:
        raise PolicyError(
            f"the policy looks at features {features}, and this halfseen knows {_FEATURES}; use the halfseen that "
            f"wrote it ({record['versions'].get('halfseen')}), or learn the policy anew"
        )
    least_rewards = typed({"least_rewards": {}, **schema}, "least_rewards", dict, "an object")
    if not all(verb in _VERBS and isinstance(paid, float) for verb, paid in least_rewards.items()):
        raise PolicyError(f"least_rewards is {least_rewards}; it holds a number for each verb: learn the policy anew")
    dirty_share = typed(schema, "dirty_share", float, "the probability that an object is dirty")
    if not 0.0 < dirty_share < 1.0:
        raise PolicyError(f"dirty_share is {dirty_share}; it lies between 0 and 1: learn the policy anew")
