"""Policies of tables in a folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from halfseen.errors import PolicyError
from halfseen.policies.folder.arrays import (
    BEHAVIOUR,
    COEFFICIENTS,
    MARGIN,
    Arrays,
    Shape,
    check_arrays,
    kernel_map_of,
    policy_arrays,
)
from halfseen.policies.folder.json_values import check_features, horizon_of, typed
from halfseen.policies.folder.seen_tables import TABLE_RANGES, seen_tables
from halfseen.policies.folder.table_parts import grasp_arrays, grasp_of, is_seen_of, seen_verbs
from halfseen.tables.features import FEATURES_VERSION, NUM_FEATURES
from halfseen.tables.policy import LinearTablePolicy
from halfseen.tables.present import PriorFacts, dirty_share, prior_facts
from halfseen.world.actions import Verb

if TYPE_CHECKING:
    from halfseen.logs import Logs
else:
    Logs = Any  # Who reads a policy loads no log.

_VERBS = [verb.name for verb in Verb]
_FEATURES = {"of": "table", "version": FEATURES_VERSION, "number": NUM_FEATURES}


@dataclass(frozen=True)
class TableKind:
    """Kind ``"table"``: a `LinearTablePolicy`, in single precision, as it decides."""

    policy_type = LinearTablePolicy

    def facts(self, logs: Logs) -> "TableFacts":
        """What a log tells of the prior, of views and of rewards."""
        return TableFacts(prior_facts(logs), counts_views(logs), least_rewards(logs))

    def schema(self, policy: LinearTablePolicy, facts: Sequence["TableFacts"]) -> dict[str, Any]:
        """Verbs, features, the prior of DIRTY that the log-odds of the log started from, what looks and verbs told."""
        return {**schema_of(policy), **facts_schema(facts)}

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
        return policy_arrays(policy) | grasp_arrays(policy.grasp)

    def policy_of(self, record: Mapping[str, Any], arrays: Arrays) -> LinearTablePolicy:
        """Put a policy together again.

        Raises
        ------
        PolicyError
            Its features are not those of this halfseen, its prior is none, or arrays do not fit.
        """
        policy = policy_in(record, arrays)
        check_facts(record)
        return policy


def facts_schema(facts: Sequence["TableFacts"]) -> dict[str, Any]:
    """The prior of DIRTY that the log-odds of a log started from, what looks counted, and the least each verb paid."""
    paid = {verb: [part.least_rewards[verb] for part in facts if verb in part.least_rewards] for verb in _VERBS}
    return {
        "dirty_share": dirty_share([part.prior for part in facts]),
        "counts_views": any(part.counts_views for part in facts),
        "least_rewards": {verb: min(least) for verb, least in paid.items() if least},
    }


def schema_of(policy: LinearTablePolicy) -> dict[str, Any]:
    """What a record tells of the arrays of a policy: verbs, features, and which verbs have a value."""
    horizon = len(policy.coefficients)
    seen = seen_verbs(_VERBS, policy.is_seen, horizon)
    return {"horizon": horizon, "actions": _VERBS, "features": _FEATURES, "seen": seen}


def policy_in(record: Mapping[str, Any], arrays: Arrays) -> LinearTablePolicy:
    """Put a policy together again by what a record tells of its arrays alone.

    Raises
    ------
    PolicyError
        Its features are not those of this halfseen, or arrays do not fit.
    """
    check_features(record, _FEATURES, _VERBS)
    check_arrays(arrays, Shape(horizon_of(record), len(Verb), NUM_FEATURES, np.float32), may_grasp=True)
    single: Any = dict(arrays)
    grasp, kernel_map, margin = grasp_of(single), kernel_map_of(single), single.get(MARGIN)
    is_seen, behaviour = is_seen_of(_VERBS, record), single.get(BEHAVIOUR)
    return LinearTablePolicy(single[COEFFICIENTS], grasp, kernel_map, is_seen, margin, behaviour)


class TableFacts(NamedTuple):
    """What the schema needs of a log, or of a part of it."""

    prior: PriorFacts
    counts_views: bool
    least_rewards: dict[str, float]


def least_rewards(logs: Logs) -> dict[str, float]:
    """The least that each verb paid, where a stage of it was completed."""
    done: Any = logs.stages[logs.stages["reward"].notna()]
    paid = {str(verb): float(least) for verb, least in done.groupby("action", observed=True)["reward"].min().items()}
    return {verb: paid[verb] for verb in _VERBS if verb in paid}


def counts_views(logs: Logs) -> bool:
    """Whether the recorder counted how much of an object has been in view, so that a second look may be no news."""
    return logs.objects is not None and "seen" in logs.objects.columns and bool((logs.objects["seen"] > 0.0).any())


def check_facts(record: Mapping[str, Any]) -> None:
    """Refuse a record whose prior or whose rewards are none.

    Raises
    ------
    PolicyError
        As above.
    """
    schema = record["schema"]
    least_rewards = typed({"least_rewards": {}, **schema}, "least_rewards", dict, "an object")
    if not all(verb in _VERBS and isinstance(paid, float) for verb, paid in least_rewards.items()):
        raise PolicyError(f"least_rewards is {least_rewards}; it holds a number for each verb: learn the policy anew")
    dirty_share = typed(schema, "dirty_share", float, "the probability that an object is dirty")
    if not 0.0 < dirty_share < 1.0:
        raise PolicyError(f"dirty_share is {dirty_share}; it lies between 0 and 1: learn the policy anew")
