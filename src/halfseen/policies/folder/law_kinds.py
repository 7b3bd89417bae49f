"""Kinds of stored table policies that decide by fitted laws, of one robot and of a team."""

from collections.abc import Mapping
from dataclasses import fields
from itertools import starmap
from typing import Annotated, Any, Literal, Union

import msgspec
import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import asdict, astuple

from halfseen.errors import ArgumentError, HalfseenError, PolicyError
from halfseen.policies.folder.kinds import Arrays, PolicyKind, check_shapes, sizes_of
from halfseen.policies.folder.record import Horizon, converted
from halfseen.policies.folder.table_kinds import (
    TEAM_VERBS,
    VERBS,
    PriorSchema,
    check_features,
    grasp_arrays,
    grasp_of,
    grasp_shapes,
)
from halfseen.tables.assisted import (
    AssistedPolicy,
    AssistedTeamPolicy,
    Excess,
    LawPolicy,
    Mending,
    RulePolicy,
    TeamExcess,
)
from halfseen.tables.look_ahead import (
    EXCESS_VERSION,
    NUM_EXCESS_FEATURES,
    NUM_TEAM_EXCESS_FEATURES,
    TEAM_EXCESS_VERSION,
)
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import AssumedGrasping, FittedGrasping
from halfseen.world.seeing import AssumedSeeing, PersistentSeeing

_FEATURES = {"of": "laws", "version": EXCESS_VERSION, "number": NUM_EXCESS_FEATURES}
_TEAM_FEATURES = {"of": "team-laws", "version": TEAM_EXCESS_VERSION, "number": NUM_TEAM_EXCESS_FEATURES}
_BASES = {"model": AssistedPolicy, "rule": RulePolicy}
_EXCESS, _MENDING, _BOUNDS = ("coefficients", "low", "high"), ("recorded", "mended"), ("low", "high", "caution")

_FAMILIES: dict[str, dict[str, Any]] = {
    "grasping": {"exponential": AssumedGrasping, "logistic": FittedGrasping},
    "seeing": {"independent": AssumedSeeing, "persistent": PersistentSeeing},
}
"""Laws that a folder can hold, by law and name."""
_OF_ROBOTS, _CURVES = ("speed", "reward_per_s", "drop_out_rate"), ("views", "sensitivity", "false_alarms")


def _family_schema(family: str, kind: Any) -> type:
    numbers = [(each.name, tuple[float, ...] if each.name in _CURVES else float) for each in fields(kind)]
    return msgspec.defstruct(kind.__name__, numbers, tag_field="family", tag=family, forbid_unknown_fields=True)


GraspingLaw, SeeingLaw = (Union[tuple(starmap(_family_schema, of.items()))] for of in _FAMILIES.values())  # noqa: UP007


class WorldLaws(Struct):
    """A world with its laws, and its robots if there are several."""

    horizon: int
    dirty_share: Annotated[float, Meta(gt=0.0, lt=1.0)]
    transport_s: float
    reward_wash_dirty: float
    reward_wash_clean: float
    reward_wash_failed: float
    reward_lift_per_s: float
    reward_dirty_left: float
    grasping: GraspingLaw
    seeing: SeeingLaw
    speed: tuple[float, ...] = (1.0,)
    reward_per_s: float = 0.0
    drop_out_rate: tuple[float, ...] | None = None


class LawsSchema(Struct):
    """The world and laws of a policy, and the verbs that the log supports."""

    horizon: Horizon
    basis: str
    seen: list[str]
    laws: WorldLaws

    def __post_init__(self) -> None:
        if self.basis not in _BASES:
            raise ValueError(f"basis is {self.basis!r}; it must be {' or '.join(_BASES)}")
        if not {*self.seen} <= {*VERBS}:
            raise ValueError(f"seen is {self.seen}; it must list verbs of {', '.join(VERBS)}")
        if self.horizon != self.laws.horizon:
            raise ValueError(f"horizon is {self.horizon}, but {self.laws.horizon} in the laws")


class TeamBounds(Struct):
    """Bounds of E of a team, and the lead that an action must have."""

    low: float
    high: float
    caution: float


class TeamLawsSchema(Struct):
    """Number of robots, laws, and the bounds of E."""

    horizon: Horizon
    num_robots: int
    basis: Literal["model"]
    laws: WorldLaws
    excess: TeamBounds | None = None


def _laws_of(config: WorldConfig) -> dict[str, Any]:
    names = [name for name in WorldLaws.__struct_fields__ if config.num_robots > 1 or name not in _OF_ROBOTS]
    return {name: _plain(name, getattr(config, name)) for name in names}


def _plain(name: str, value: Any) -> Any:
    if name in _FAMILIES:
        family = next((family for family, kind in _FAMILIES[name].items() if type(value) is kind), None)
        if family is None:
            raise ArgumentError(
                f"{name} is {type(value).__name__}, whose code a folder cannot hold; fit the law to a log"
            )
        return {"family": family, **{each.name: _plain(each.name, getattr(value, each.name)) for each in fields(value)}}
    if value is None or name == "horizon":
        return value
    return [float(each) for each in value] if isinstance(value, tuple) else float(value)


def _world_of(laws: WorldLaws) -> WorldConfig:
    given = asdict(laws)
    try:
        for name, families in _FAMILIES.items():
            given[name] = families[given[name].__struct_config__.tag](**asdict(given[name]))
        return WorldConfig(**given)
    except (HalfseenError, TypeError, ValueError) as error:
        raise PolicyError(f"laws: {error}; learn the policy again") from error


def _laws_schema(policy: LawPolicy) -> dict[str, Any]:
    seen = getattr(policy, "is_seen", None)
    return {
        "horizon": policy.config.horizon,
        "actions": VERBS,
        "features": _FEATURES,
        "basis": next(name for name, kind in _BASES.items() if isinstance(policy, kind)),
        "seen": VERBS if seen is None else [VERBS[k] for k in np.flatnonzero(seen)],
        "laws": _laws_of(policy.config),
    }


def _laws_arrays(policy: Any) -> dict[str, np.ndarray]:
    """E, or the grasp model of a rule; and the corrections of log-odds."""
    parts = {"mending": (policy.mending, _MENDING), "excess": (getattr(policy, "excess", None), _EXCESS)}
    named = {
        f"{part}.{name}": np.asarray(getattr(of, name))
        for part, (of, names) in parts.items()
        if of is not None
        for name in names
    }
    return named | (grasp_arrays(policy.grasp) if isinstance(policy, RulePolicy) else {})


def _laws_policy(record: Mapping[str, Any], arrays: Any) -> LawPolicy:
    check_features(record["schema"], _FEATURES, VERBS, record["versions"])
    schema = converted(record["schema"], LawsSchema, _FAMILIES)
    converted(record["schema"], PriorSchema)
    config, is_rule = _world_of(schema.laws), schema.basis == "rule"
    wanted = grasp_shapes(arrays) if is_rule else {}
    if any(name.startswith("mending.") for name in arrays):
        wanted |= dict.fromkeys((f"mending.{name}" for name in _MENDING), sizes_of(arrays, "mending.recorded", 1))
    if not is_rule and any(name.startswith("excess.") for name in arrays):
        shapes = ((schema.horizon, 2, 1 + NUM_EXCESS_FEATURES), (schema.horizon, 2), (schema.horizon, 2))
        wanted |= {f"excess.{name}": shape for name, shape in zip(_EXCESS, shapes, strict=True)}
    check_shapes(arrays, wanted, np.float32)
    mending = _mending_of(arrays, config)
    if is_rule:
        return RulePolicy(config, mending, grasp_of(arrays))
    excess = Excess(*(arrays[f"excess.{name}"] for name in _EXCESS)) if "excess.low" in arrays else None
    is_seen = None if {*schema.seen} == {*VERBS} else np.array([verb in schema.seen for verb in VERBS])
    return AssistedPolicy(config, mending, excess, is_seen)


def _mending_of(arrays: Any, config: WorldConfig) -> Mending | None:
    if "mending.recorded" not in arrays:
        return None
    recorded, mended = (arrays[f"mending.{name}"] for name in _MENDING)
    if (np.diff(recorded) <= 0.0).any() or (np.diff(mended) < 0.0).any():
        raise PolicyError("mending.recorded and mending.mended must rise; learn the policy again")
    prior = np.log(config.dirty_share) - np.log1p(-config.dirty_share)
    law = config.seeing if isinstance(config.seeing, PersistentSeeing) else None
    return Mending(recorded, mended, float(prior), law)


def _team_laws_schema(policy: AssistedTeamPolicy) -> dict[str, Any]:
    excess = policy.excess
    return {
        "horizon": policy.num_stages,
        "num_robots": policy.num_robots,
        "actions": TEAM_VERBS,
        "blocks": ["all actions"],
        "features": _TEAM_FEATURES,
        "basis": "model",
        "laws": _laws_of(policy.config),
        "excess": None if excess is None else {name: float(getattr(excess, name)) for name in _BOUNDS},
    }


def _team_laws_arrays(policy: AssistedTeamPolicy) -> dict[str, np.ndarray]:
    return {} if policy.excess is None else {"excess.coefficients": np.asarray(policy.excess.coefficients)}


def _team_laws_policy(record: Mapping[str, Any], arrays: Arrays) -> AssistedTeamPolicy:
    check_features(record["schema"], _TEAM_FEATURES, TEAM_VERBS, record["versions"])
    schema = converted(record["schema"], TeamLawsSchema, _FAMILIES)
    config, bounds = _world_of(schema.laws), schema.excess
    if (schema.num_robots, schema.horizon) != (config.num_robots, config.num_stages):
        raise PolicyError(
            f"num_robots is {schema.num_robots} and horizon {schema.horizon}, but the laws are for "
            f"{config.num_robots} robots and {config.num_stages} decisions of all together: learn the policy again"
        )
    check_shapes(arrays, {} if bounds is None else {"excess.coefficients": (NUM_TEAM_EXCESS_FEATURES,)}, np.float32)
    if bounds is None:
        return AssistedTeamPolicy(config)
    return AssistedTeamPolicy(config, TeamExcess(arrays["excess.coefficients"], *astuple(bounds)))


LAW_KINDS = {
    "table-laws": PolicyKind(LawPolicy, _laws_schema, _laws_arrays, _laws_policy, has_prior=True),
    "team-laws": PolicyKind(AssistedTeamPolicy, _team_laws_schema, _team_laws_arrays, _team_laws_policy),
}
