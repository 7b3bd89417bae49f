"""Kinds of stored linear table policies, of one robot and of a team.

Such a policy is in single precision, as it decides. A team's policy has one block of coefficients for all verbs. Its
horizon counts the decisions of all robots, and the policy that each robot learned alone is stored under the robot's
number.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType

from halfseen.errors import ArgumentError, PolicyError
from halfseen.policies.folder.kinds import (
    BEHAVIOUR,
    COEFFICIENTS,
    GRASP,
    LARGEST,
    MARGIN,
    Arrays,
    PolicyKind,
    check_shapes,
    kernel_map_of,
    linear_arrays,
    linear_shapes,
    sizes_of,
)
from halfseen.policies.folder.record import Horizon, converted
from halfseen.tables import features as table_features
from halfseen.tables.grasp_table import GraspByRobot, GraspTable
from halfseen.tables.policy import IndependentPolicies, LinearTablePolicy, LinearTeamPolicy
from halfseen.world.actions import VERB_NAMES, Verb
from halfseen.world.policy import GraspModel, Policy

TEAM_VERSION = 1
"""Version of `team_features`; policies with features of another version cannot be read."""
PER_GRIP, OWN, ALONE, CAUTION = "grasp.per_grip", "own.", "alone", "caution"
"""Names of arrays, and prefixes: of each robot's own grasps, axis K first, and of each robot's own policy."""
VERBS, TEAM_VERBS = [verb.name for verb in Verb], list(VERB_NAMES)


class LinearSchema(Struct):
    """What a linear policy chooses from."""

    horizon: Horizon
    actions: list[str]
    seen: list[Annotated[list[str], Meta(min_length=1)]] | UnsetType = UNSET
    """Verbs with a value, by steps to go; all verbs in a folder that does not say."""

    def __post_init__(self) -> None:
        if self.seen is not UNSET and (
            len(self.seen) != self.horizon or not all({*row} <= {*self.actions} for row in self.seen)
        ):
            raise ValueError(f"seen is {self.seen}; it must list verbs for each number of steps to go")


class TeamSchema(LinearSchema, kw_only=True):
    """For a team, also its number of robots, and what each learned alone."""

    num_robots: int
    alone: list[dict[str, Any]] = []

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.num_robots < 1 or self.horizon % self.num_robots:
            raise ValueError(
                f"num_robots is {self.num_robots}, and horizon {self.horizon}; a team needs at least 1 robot, and the "
                "same number of decisions for each"
            )
        if len(self.alone) not in (0, self.num_robots):
            raise ValueError(f"{ALONE} is {self.alone!r}; it must describe each of {self.num_robots} robots")


class PriorSchema(Struct):
    """The prior of DIRTY, whether looks were counted, and the least reward of each verb in a log."""

    dirty_share: Annotated[float, Meta(gt=0.0, lt=1.0)]
    counts_views: bool = False
    least_rewards: dict[Literal[tuple(VERBS)], float] = {}


def check_features(schema: Mapping[str, Any], features: Mapping[str, Any], verbs: list[str], versions: Any) -> None:
    """Refuse a policy with features or verbs other than those of this halfseen.

    Raises
    ------
    PolicyError
        Its features or verbs differ.
    """
    if schema.get("features") != features or schema.get("actions") != verbs:
        raise PolicyError(
            f"the policy looks at features {schema.get('features')}, but this halfseen knows {features}; use the "
            f"halfseen that wrote it ({versions.get('halfseen')}), or learn the policy again"
        )


class _Linear(NamedTuple):
    """What differs between linear policies of one robot and of a team."""

    policy_type: Any
    schema: type[LinearSchema]
    verbs: list[str]
    num_blocks: int
    features: dict[str, Any]

    def schema_of(self, policy: Any) -> dict[str, Any]:
        """Horizon, verbs, features, and the verbs with a value; if there are none, all verbs are possible."""
        horizon = len(policy.coefficients)
        rows = np.ones((horizon, len(self.verbs)), dtype=bool) if policy.is_seen is None else np.asarray(policy.is_seen)
        seen = [[self.verbs[k] for k in np.flatnonzero(row)] or self.verbs for row in rows]
        return {"horizon": horizon, "actions": self.verbs, "features": self.features, "seen": seen}

    def policy_of(self, schema: dict[str, Any], versions: Any, arrays: Arrays, **others: Any) -> Any:
        """Rebuild a policy."""
        check_features(schema, self.features, self.verbs, versions)
        known = converted(schema, self.schema)
        wanted = linear_shapes(arrays, known.horizon, self.num_blocks, self.features["number"])
        check_shapes(arrays, wanted | grasp_shapes(arrays, others.get("num_robots")), np.float32)
        given: dict[str, Any] = {name: arrays[name] for name in (COEFFICIENTS, MARGIN, BEHAVIOUR) if name in arrays}
        rows = [] if known.seen is UNSET else [[verb in row for verb in self.verbs] for row in known.seen]
        is_seen = None if np.all(rows) else np.array(rows)
        kernel_map, grasp = kernel_map_of(arrays), grasp_of(arrays)
        return self.policy_type(**given, kernel_map=kernel_map, grasp=grasp, is_seen=is_seen, **others)


_TABLE = _Linear(
    LinearTablePolicy,
    LinearSchema,
    VERBS,
    len(VERBS),
    {"of": "table", "version": table_features.FEATURES_VERSION, "number": table_features.NUM_FEATURES},
)
_TEAM = _Linear(
    LinearTeamPolicy,
    TeamSchema,
    TEAM_VERBS,
    1,
    {
        "of": "team",
        "version": TEAM_VERSION,
        "version_of_tables": table_features.FEATURES_VERSION,
        "number": table_features.NUM_TEAM_FEATURES,
    },
)


def grasp_arrays(grasp: GraspModel | None) -> dict[str, np.ndarray]:
    """Return the arrays of a grasp model by name; none for the rule of succession.

    Raises
    ------
    ArgumentError
        The grasp model is no table of numbers.
    """
    if grasp is None:
        return {}
    if isinstance(grasp, GraspByRobot):
        return grasp_arrays(grasp.shared) | {f"{OWN}{name}": each for name, each in grasp_arrays(grasp.own).items()}
    if not isinstance(grasp, GraspTable):
        raise ArgumentError(
            f"grasp is a {type(grasp).__name__}, whose code a folder cannot hold; learn with BetaGrasp() or SVMGrasp()"
        )
    return {GRASP: np.asarray(grasp.probabilities), PER_GRIP: np.asarray(grasp.per_grip, dtype=np.float32)}


def grasp_shapes(arrays: Arrays, num_robots: int | None = None) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays of a grasp model; none for the rule of succession.

    Raises
    ------
    PolicyError
        The grasp model has no chances.
    """
    robots = [num_robots] if num_robots and any(name.startswith(OWN) for name in arrays) else []
    if GRASP not in arrays and not robots:
        return {}
    levels, most, _ = sizes_of(arrays, GRASP, 3)
    shape = (max(levels, 2), max(most, 1), max(most, 1))
    # Older folders of one robot lack the second array.
    wanted: dict[str, tuple[int, ...]] = {GRASP: shape} | ({PER_GRIP: ()} if robots or PER_GRIP in arrays else {})
    own = {f"{OWN}{name}": (*robots, *size) for name, size in wanted.items()} if robots else {}
    return wanted | own


def grasp_of(arrays: Any) -> GraspTable | GraspByRobot | None:
    """Rebuild a grasp model; None for the rule of succession."""
    tables = [
        GraspTable(arrays[f"{of}{GRASP}"], arrays.get(f"{of}{PER_GRIP}", 1.0))
        for of in ("", OWN)
        if f"{of}{GRASP}" in arrays
    ]
    return GraspByRobot(*tables) if len(tables) > 1 else tables[0] if tables else None


def _table_arrays(policy: LinearTablePolicy) -> dict[str, np.ndarray]:
    return linear_arrays(policy) | grasp_arrays(policy.grasp)


def _table_policy(record: Mapping[str, Any], arrays: Arrays) -> LinearTablePolicy:
    policy = _TABLE.policy_of(record["schema"], record["versions"], arrays)
    converted(record["schema"], PriorSchema)
    return policy


def _each_alone(base: Policy | None) -> tuple[Any, ...]:
    """The policies that each robot learned alone, which the team's policy improves upon."""
    if base is None:
        return ()
    if isinstance(base, IndependentPolicies) and all(isinstance(policy, LinearTablePolicy) for policy in base.policies):
        return base.policies
    raise ArgumentError(
        f"base is a {type(base).__name__}, whose code a folder cannot hold; learn with base='auto' or None"
    )


def _team_schema(policy: LinearTeamPolicy) -> dict[str, Any]:
    if policy.num_robots is None:
        raise ArgumentError("num_robots is None; learn with CensoredQLearner.for_team, which sets it")
    schema = _TEAM.schema_of(policy)
    first = {"horizon": schema["horizon"], "num_robots": policy.num_robots, "actions": TEAM_VERBS}
    alone = [_TABLE.schema_of(each) for each in _each_alone(policy.base)]
    return first | {"blocks": ["all actions"]} | schema | ({ALONE: alone} if alone else {})


def _team_arrays(policy: LinearTeamPolicy) -> dict[str, np.ndarray]:
    named = linear_arrays(policy) | {CAUTION: np.asarray(policy.caution)} | grasp_arrays(policy.grasp)
    for robot, each in enumerate(_each_alone(policy.base)):
        named |= {f"{ALONE}.{robot}.{name}": array for name, array in _table_arrays(each).items()}
    return named


def _team_policy(record: Mapping[str, Any], arrays: Arrays) -> LinearTeamPolicy:
    schema, versions = record["schema"], record["versions"]
    check_features(schema, _TEAM.features, TEAM_VERBS, versions)
    known = converted(schema, TeamSchema)
    prefixes = tuple(f"{ALONE}.{robot}." for robot in range(len(known.alone)))
    unknown = [name for name in arrays if name.startswith(f"{ALONE}.") and not name.startswith(prefixes)]
    if unknown:
        raise PolicyError(f"array {unknown[0]!r} belongs to no robot of the record; learn the policy again")
    each = []
    for of_robot, prefix in zip(known.alone, prefixes, strict=True):
        its = {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
        each.append(_TABLE.policy_of(of_robot, versions, its))
    own = {name: array for name, array in arrays.items() if not name.startswith(f"{ALONE}.")}
    caution = own.pop(CAUTION, np.float32(0.0))
    if caution.shape != () or not 0.0 <= caution <= LARGEST:
        raise PolicyError(f"caution is {caution.tolist()}; it must be one number, 0 or above: learn the policy again")
    base = IndependentPolicies(tuple(each)) if each else None
    return _TEAM.policy_of(schema, versions, own, num_robots=known.num_robots, base=base, caution=caution)


TABLE_KINDS = {
    "table": PolicyKind(LinearTablePolicy, _TABLE.schema_of, _table_arrays, _table_policy, has_prior=True),
    "team": PolicyKind(LinearTeamPolicy, _team_schema, _team_arrays, _team_policy),
}
