"""Policies of teams in a folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.errors import ArgumentError, PolicyError
from halfseen.policies.folder.arrays import Arrays, Shape, check_arrays, kernel_map_of, policy_arrays
from halfseen.policies.folder.json_values import check_features, horizon_of, typed
from halfseen.policies.folder.seen_tables import TABLE_RANGES, seen_tables
from halfseen.policies.folder.table_parts import is_seen_of, seen_verbs
from halfseen.policies.folder.team_base import base_arrays, base_of, base_schema, split_arrays
from halfseen.policies.folder.team_grasp import split_grasp, team_grasp_arrays, team_grasp_of
from halfseen.tables.features import FEATURES_VERSION as TABLE_FEATURES_VERSION
from halfseen.tables.features import NUM_TEAM_FEATURES
from halfseen.tables.policy import LinearTeamPolicy
from halfseen.world.actions import VERB_NAMES

if TYPE_CHECKING:
    from halfseen.logs import Logs
else:
    Logs = Any  # Who reads a policy loads no log.

FEATURES_VERSION = 1
"""Of `team_features`; a policy that looked at others cannot be read."""

_VERBS = list(VERB_NAMES)
_FEATURES = {
    "of": "team",
    "version": FEATURES_VERSION,
    "version_of_tables": TABLE_FEATURES_VERSION,
    "number": NUM_TEAM_FEATURES,
}
_OTHERWISE = ("grasp", "is_seen", "kernel_map", "base")
_STATIC = tuple(field.name for field in fields(LinearTeamPolicy) if field.metadata.get("static"))
_ARRAYS = tuple(field.name for field in fields(LinearTeamPolicy) if field.name not in (*_OTHERWISE, *_STATIC))
"""Fields of a policy that are told in ways of their own, in the schema by their names, and as arrays of their names."""


@dataclass(frozen=True)
class TeamKind:
    """Kind ``"team"``: a `LinearTeamPolicy`, in single precision, as it decides; its horizon is of all robots together.

    One block of coefficients serves all verbs.
    """

    policy_type = LinearTeamPolicy

    def facts(self, logs: Logs) -> None:
        """The schema needs nothing of the log."""

    def schema(self, policy: LinearTeamPolicy, facts: Sequence[Any]) -> dict[str, Any]:
        """Number of robots, verbs, features, and the verbs that the log told.

        Raises
        ------
        ArgumentError
            The policy does not say for how many robots it is.
        """
        if policy.num_robots is None:
            raise ArgumentError("num_robots is None; learn with CensoredQLearner.for_team, which is told the number")
        horizon = len(policy.coefficients)
        return {
            "horizon": horizon,
            **{name: getattr(policy, name) for name in _STATIC},
            "actions": _VERBS,
            "blocks": ["all actions"],
            "features": _FEATURES,
            "seen": seen_verbs(_VERBS, policy.is_seen, horizon),
            **base_schema(policy.base),
        }

    def seen(self, logs: Logs, policy: LinearTeamPolicy, is_by_stage: bool) -> list[dict[str, Any]]:
        """Ranges over all stages: tables are alike in every stage."""
        return seen_tables(logs)

    def range_names(self, policy: LinearTeamPolicy) -> tuple[str, ...]:
        """What the ranges are of."""
        return TABLE_RANGES

    def arrays_of(self, policy: LinearTeamPolicy) -> dict[str, np.ndarray]:
        """Every field that holds numbers, by its name, and those of the grasp model and of the base if there are.

        Raises
        ------
        ArgumentError
            The grasp model is no table of numbers, or the base is not each alone.
        """
        given = {name: getattr(policy, name) for name in _ARRAYS}
        others = {name: np.asarray(value) for name, value in given.items() if value is not None}
        return policy_arrays(policy) | others | team_grasp_arrays(policy.grasp) | base_arrays(policy.base)

    def policy_of(self, record: Mapping[str, Any], arrays: Arrays) -> LinearTeamPolicy:
        """Put a policy together again.

        Raises
        ------
        PolicyError
            Its features are not those of this halfseen, its number of robots is none, or arrays do not fit.
        """
        _check_schema(record)
        shape = Shape(horizon_of(record), 1, NUM_TEAM_FEATURES, np.float32)
        arrays, of_base = split_arrays(arrays)
        arrays, of_grasp = split_grasp(arrays, record["schema"]["num_robots"])
        check_arrays(arrays, shape, may_grasp=True, others=_ARRAYS)
        _check_caution(arrays.get("caution"))
        base = base_of(record, of_base)
        given: dict[str, Any] = {name: arrays[name] for name in _ARRAYS if name in arrays}
        given |= {name: record["schema"][name] for name in _STATIC if name in record["schema"]}
        kernel_map = kernel_map_of(arrays)
        given |= {} if kernel_map is None else {"kernel_map": kernel_map}
        is_seen = is_seen_of(_VERBS, record)
        return LinearTeamPolicy(**given, grasp=team_grasp_of(arrays, of_grasp), is_seen=is_seen, base=base)


def _check_caution(caution: np.ndarray | None) -> None:
    if caution is not None and not (caution.shape == () and caution >= 0):
        raise PolicyError(f"caution is {caution.tolist()}; it is one number, 0 or above: learn the policy anew")


def _check_schema(record: Mapping[str, Any]) -> None:
    check_features(record, _FEATURES, _VERBS)
    schema = record["schema"]
    num_robots, horizon = typed(schema, "num_robots", int, "a whole number"), horizon_of(record)
    if num_robots < 1 or horizon % num_robots:
        raise PolicyError(
            f"num_robots is {num_robots}, and horizon {horizon}; a team has at least 1 robot, and each as many "
            "decisions: learn the policy anew"
        )
