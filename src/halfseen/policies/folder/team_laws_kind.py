"""Policies of teams that decide by fitted laws, in a folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.errors import PolicyError
from halfseen.policies.folder.arrays import Arrays, check_shapes
from halfseen.policies.folder.json_values import check_features, horizon_of, typed
from halfseen.policies.folder.seen_tables import TABLE_RANGES, seen_tables
from halfseen.policies.folder.world_values import values_of_world, world_of_values
from halfseen.tables.assisted import AssistedTeamPolicy, TeamExcess
from halfseen.tables.look_ahead import NUM_TEAM_EXCESS_FEATURES, TEAM_EXCESS_VERSION
from halfseen.world.actions import VERB_NAMES

if TYPE_CHECKING:
    from halfseen.logs import Logs
else:
    Logs = Any  # Who reads a policy loads no log.

_VERBS = list(VERB_NAMES)
_FEATURES = {"of": "team-laws", "version": TEAM_EXCESS_VERSION, "number": NUM_TEAM_EXCESS_FEATURES}
_COEFFICIENTS = "excess.coefficients"
_NUMBERS = ("low", "high", "caution")


@dataclass(frozen=True)
class TeamLawsKind:
    """Kind ``"team-laws"``: an `AssistedTeamPolicy`, with the laws that it decides by."""

    policy_type = AssistedTeamPolicy

    def facts(self, logs: Logs) -> None:
        """The schema needs nothing of the log."""

    def schema(self, policy: AssistedTeamPolicy, facts: Sequence[Any]) -> dict[str, Any]:
        """Number of robots, verbs, laws, and the bounds of E."""
        excess = policy.excess
        return {
            "horizon": policy.num_stages,
            "num_robots": policy.num_robots,
            "actions": _VERBS,
            "blocks": ["all actions"],
            "features": _FEATURES,
            "basis": "model",
            "laws": values_of_world(policy.config),
            "excess": None if excess is None else {name: float(getattr(excess, name)) for name in _NUMBERS},
        }

    def seen(self, logs: Logs, policy: AssistedTeamPolicy, is_by_stage: bool) -> list[dict[str, Any]]:
        """Ranges over all stages: tables are alike in every stage."""
        return seen_tables(logs)

    def range_names(self, policy: AssistedTeamPolicy) -> tuple[str, ...]:
        """What the ranges are of."""
        return TABLE_RANGES

    def arrays_of(self, policy: AssistedTeamPolicy) -> dict[str, np.ndarray]:
        """The coefficients of E."""
        return {} if policy.excess is None else {_COEFFICIENTS: np.asarray(policy.excess.coefficients)}

    def policy_of(self, record: Mapping[str, Any], arrays: Arrays) -> AssistedTeamPolicy:
        """Put a policy together again.

        Raises
        ------
        PolicyError
            Its features are not those of this halfseen, its laws are none, or arrays do not fit.
        """
        schema, horizon = record["schema"], horizon_of(record)
        check_features(record, _FEATURES, _VERBS)
        if schema.get("basis") != "model":
            raise PolicyError(f"basis is {schema.get('basis')!r}; it is model: learn the policy anew")
        config = world_of_values(typed(schema, "laws", dict, "the laws"))
        found = typed(schema, "num_robots", int, "a whole number"), horizon
        if found != (config.num_robots, config.num_stages):
            raise PolicyError(
                f"num_robots is {found[0]}, and horizon {horizon}; the laws are of {config.num_robots} robots and "
                f"{config.num_stages} decisions of all together: learn the policy anew"
            )
        bounds = schema.get("excess")
        check_shapes(arrays, {} if bounds is None else {_COEFFICIENTS: (NUM_TEAM_EXCESS_FEATURES,)}, np.float32)
        if bounds is None:
            return AssistedTeamPolicy(config)
        bounds = typed(schema, "excess", dict, "the bounds of what is added to the look")
        low, high, caution = (typed(bounds, name, float, "a number") for name in _NUMBERS)
        return AssistedTeamPolicy(config, TeamExcess(arrays[_COEFFICIENTS], low, high, caution))
