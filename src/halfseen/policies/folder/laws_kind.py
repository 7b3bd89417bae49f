"""Policies of tables that decide by fitted laws, in a folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.errors import PolicyError
from halfseen.policies.folder.arrays import GRASP, PER_GRIP, Arrays, check_shapes, sizes_of
from halfseen.policies.folder.json_values import check_features, horizon_of, names_in, typed
from halfseen.policies.folder.seen_tables import TABLE_RANGES, seen_tables
from halfseen.policies.folder.table_kind import TableFacts, check_facts, counts_views, facts_schema, least_rewards
from halfseen.policies.folder.table_parts import grasp_arrays, grasp_of
from halfseen.policies.folder.world_values import values_of_world, world_of_values
from halfseen.tables.assisted import AssistedPolicy, Excess, LawPolicy, Mending, RulePolicy
from halfseen.tables.look_ahead import EXCESS_VERSION, NUM_EXCESS_FEATURES
from halfseen.tables.present import prior_facts
from halfseen.world.actions import Verb
from halfseen.world.seeing import PersistentSeeing

if TYPE_CHECKING:
    from halfseen.logs import Logs
else:
    Logs = Any  # Who reads a policy loads no log.

_VERBS = [verb.name for verb in Verb]
_FEATURES = {"of": "laws", "version": EXCESS_VERSION, "number": NUM_EXCESS_FEATURES}
_BASES = {"model": AssistedPolicy, "rule": RulePolicy}
_EXCESS = ("coefficients", "low", "high")
_MENDING = ("recorded", "mended")


@dataclass(frozen=True)
class LawsKind:
    """Kind ``"table-laws"``: a `LawPolicy`, with the laws that it decides by."""

    policy_type = LawPolicy

    def facts(self, logs: Logs) -> TableFacts:
        """What a log tells of the prior, of views and of rewards."""
        return TableFacts(prior_facts(logs), counts_views(logs), least_rewards(logs))

    def schema(self, policy: LawPolicy, facts: Sequence[TableFacts]) -> dict[str, Any]:
        """What it is built on, the laws, and what the log told of looks and verbs."""
        seen = getattr(policy, "is_seen", None)
        basis = next(name for name, kind in _BASES.items() if isinstance(policy, kind))
        return {
            "horizon": policy.config.horizon,
            "actions": _VERBS,
            "features": _FEATURES,
            "basis": basis,
            "seen": _VERBS if seen is None else [verb for verb, is_it in zip(_VERBS, seen, strict=True) if is_it],
            "laws": values_of_world(policy.config),
            **facts_schema(facts),
        }

    def seen(self, logs: Logs, policy: LawPolicy, is_by_stage: bool) -> list[dict[str, Any]]:
        """Ranges over all stages: tables are alike in every stage."""
        return seen_tables(logs)

    def range_names(self, policy: LawPolicy) -> tuple[str, ...]:
        """What the ranges are of."""
        return TABLE_RANGES

    def arrays_of(self, policy: LawPolicy) -> dict[str, np.ndarray]:
        """E, or the grasp model of a rule; and what mends log-odds.

        Raises
        ------
        ArgumentError
            The grasp model is no table of numbers.
        """
        named: dict[str, np.ndarray] = {}
        if policy.mending is not None:
            named |= {f"mending.{name}": np.asarray(getattr(policy.mending, name)) for name in _MENDING}
        if isinstance(policy, RulePolicy):
            return named | grasp_arrays(policy.grasp)
        assert isinstance(policy, AssistedPolicy)
        if policy.excess is not None:
            named |= {f"excess.{name}": np.asarray(getattr(policy.excess, name)) for name in _EXCESS}
        return named

    def policy_of(self, record: Mapping[str, Any], arrays: Arrays) -> LawPolicy:
        """Put a policy together again.

        Raises
        ------
        PolicyError
            Its features are not those of this halfseen, its laws are none, or arrays do not fit.
        """
        schema, horizon = record["schema"], horizon_of(record)
        check_features(record, _FEATURES, _VERBS)
        if schema.get("basis") not in list(_BASES):
            raise PolicyError(f"basis is {schema.get('basis')!r}; it is {' or '.join(_BASES)}: learn the policy anew")
        check_facts(record)
        config = world_of_values(typed(schema, "laws", dict, "the laws"))
        if config.horizon != horizon:
            raise PolicyError(f"horizon is {horizon}, and {config.horizon} in the laws; learn the policy anew")
        wanted = _wanted(arrays, horizon, schema["basis"])
        check_shapes(arrays, wanted, np.float32)
        single: Any = dict(arrays)
        mending = None
        if "mending.recorded" in arrays:
            law = config.seeing if isinstance(config.seeing, PersistentSeeing) else None
            prior = np.log(config.dirty_share) - np.log1p(-config.dirty_share)
            mending = Mending(single["mending.recorded"], single["mending.mended"], float(prior), law)
            if (np.diff(mending.recorded) <= 0.0).any() or (np.diff(mending.mended) < 0.0).any():
                raise PolicyError("mending.recorded and mending.mended rise; learn the policy anew")
        if schema["basis"] == "rule":
            return RulePolicy(config, mending, grasp_of(single))
        excess = Excess(*(single[f"excess.{name}"] for name in _EXCESS)) if "excess.low" in arrays else None
        seen = names_in(schema, "seen", (str,))
        if not set(seen) <= set(_VERBS):
            raise PolicyError(f"seen is {list(seen)}; it lists verbs, {', '.join(_VERBS)}: learn the policy anew")
        is_seen = None if set(seen) == set(_VERBS) else np.array([verb in seen for verb in _VERBS])
        return AssistedPolicy(config, mending, excess, is_seen)


def _wanted(arrays: Arrays, horizon: int, basis: str) -> dict[str, tuple[int, ...]]:
    wanted: dict[str, tuple[int, ...]] = {}
    if any(name.startswith("mending.") for name in arrays):
        wanted |= dict.fromkeys((f"mending.{name}" for name in _MENDING), sizes_of(arrays, "mending.recorded", 1))
    if basis == "model" and any(name.startswith("excess.") for name in arrays):
        shapes = ((horizon, 2, 1 + NUM_EXCESS_FEATURES), (horizon, 2), (horizon, 2))
        wanted |= {f"excess.{name}": shape for name, shape in zip(_EXCESS, shapes, strict=True)}
    if basis == "rule" and GRASP in arrays:
        levels, most, _ = sizes_of(arrays, GRASP, 3)
        wanted |= {GRASP: (max(levels, 2), max(most, 1), max(most, 1)), PER_GRIP: ()}
    return wanted
