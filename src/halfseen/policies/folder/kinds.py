"""Kinds of policies that a folder can hold, by name.

The kind of named actions is here, those of tables in `table_kinds` and `law_kinds`, which bring the world.
"""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from halfseen.errors import ArgumentError
from halfseen.learning.covariates import Covariates
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.logs.missing import Filling
from halfseen.policies.folder.arrays import (
    BEHAVIOUR,
    COEFFICIENTS,
    LARGEST,
    MARGIN,
    Arrays,
    PolicyKind,
    check_shapes,
    kernel_map_of,
    linear_arrays,
    linear_shapes,
)
from halfseen.policies.folder.record import Horizon, converted


def kind_named(name: str) -> PolicyKind:
    """Kind of this name; those of tables bring the world, which takes longer than what the other is asked for."""
    return FLAT if name == "flat" else _table_kinds()[name]


def kind_name_of(policy: Any) -> str:
    """Name of the kind that a policy is of.

    Raises
    ------
    ArgumentError
        It is of none.
    """
    kinds = {"flat": FLAT, **_table_kinds()}
    for name, kind in kinds.items():
        if isinstance(policy, kind.policy_type):
            return name
    types = ", ".join(kind.policy_type.__name__ for kind in kinds.values())
    raise ArgumentError(f"a {type(policy).__name__} cannot be written to a folder; these can: {types}")


def _table_kinds() -> dict[str, PolicyKind]:
    from halfseen.policies.folder.law_kinds import LAW_KINDS
    from halfseen.policies.folder.table_kinds import TABLE_KINDS

    return TABLE_KINDS | LAW_KINDS


class DiscreteSchema(Struct):
    """Covariates, their categories and what stands for missing ones; actions, and those that each stage allows."""

    horizon: Horizon
    covariates: list[str]
    actions: list[int | str]
    possible: list[Annotated[list[int | str], Meta(min_length=1)]]
    categories: dict[str, list[str]] = {}
    behaviour_weight: Annotated[float, Meta(ge=0.0, le=LARGEST)] = 0.0
    missing: Filling | None = None

    def __post_init__(self) -> None:
        if not {*self.categories} <= {*self.covariates}:
            raise ValueError(f"categories are of {', '.join(self.categories)}; each is of a covariate")
        for name, each in {"actions": self.actions, "covariates": self.covariates, **self.categories}.items():
            if len(set(each)) < len(each):
                raise ValueError(f"{name} is {each}; each has a name of its own")
        if len(self.possible) != self.horizon or not all({*each} <= {*self.actions} for each in self.possible):
            raise ValueError(
                f"possible is {self.possible}; it lists some of the actions for each of the {self.horizon} stages"
            )


def _flat_schema(policy: DiscretePolicy) -> dict[str, Any]:
    names = [_action_name(name) for name in policy.actions]
    missing = {} if policy.filling is None else {"missing": asdict(policy.filling)}
    return {
        "horizon": policy.horizon,
        "covariates": list(policy.covariates),
        "categories": {name: list(known) for name, known in policy.categories.items()},
        "actions": names,
        "possible": [[names[k] for k in np.flatnonzero(row)] for row in policy.is_possible],
        **missing,
    } | ({"behaviour_weight": policy.behaviour_weight} if policy.behaviour_weight > 0 else {})


def _action_name(name: Any) -> int | str:
    value = name.item() if isinstance(name, np.generic) else name
    if isinstance(value, bool) or not isinstance(value, (int, str)):
        raise ArgumentError(f"action {name!r} is neither a whole number nor text; a folder cannot hold other names")
    return value


def _discrete_policy(record: Mapping[str, Any], arrays: Arrays) -> DiscretePolicy:
    schema = converted(record["schema"], DiscreteSchema)
    categories = {name: tuple(each) for name, each in schema.categories.items()}
    looks_at = Covariates(tuple(schema.covariates), categories)
    check_shapes(arrays, linear_shapes(arrays, schema.horizon, len(schema.actions), looks_at.num_features), np.float64)
    return DiscretePolicy(
        actions=tuple(schema.actions),
        covariates=looks_at.columns,
        is_possible=np.array([[name in names for name in schema.actions] for names in schema.possible]),
        coefficients=arrays[COEFFICIENTS],
        kernel_map=kernel_map_of(arrays),
        margin=arrays.get(MARGIN),
        behaviour=arrays.get(BEHAVIOUR),
        behaviour_weight=schema.behaviour_weight,
        categories=looks_at.categories,
        filling=schema.missing,
    )


FLAT = PolicyKind(DiscretePolicy, _flat_schema, linear_arrays, _discrete_policy, is_flat=True)
