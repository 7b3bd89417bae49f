"""What a policy of a team improves upon, in its folder: the policy that each robot learned alone."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError, PolicyError
from halfseen.policies.folder.arrays import Arrays
from halfseen.policies.folder.table_kind import TableKind, policy_in, schema_of
from halfseen.tables.policy import IndependentPolicies, LinearTablePolicy
from halfseen.world.policy import Policy

ALONE = "alone"
"""In the schema, a list of what each robot's policy needs there; in names of arrays, what stands before the robot."""


def base_arrays(base: Policy | None) -> dict[str, np.ndarray]:
    """Name the arrays of each robot's policy by its number; none where nothing is improved upon.

    Raises
    ------
    ArgumentError
        It is of another kind.
    """
    named = {}
    for robot, policy in enumerate(_policies(base)):
        named |= {f"{ALONE}.{robot}.{name}": array for name, array in TableKind().arrays_of(policy).items()}
    return named


def base_schema(base: Policy | None) -> dict[str, Any]:
    """What the schema tells of each robot's policy."""
    schemas = [schema_of(policy) for policy in _policies(base)]
    return {ALONE: schemas} if schemas else {}


def split_arrays(arrays: Arrays) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Tell the arrays of the team apart from those of each robot."""
    of_base = {name for name in arrays if name.startswith(f"{ALONE}.")}
    return {name: array for name, array in arrays.items() if name not in of_base}, {n: arrays[n] for n in of_base}


def base_of(record: Mapping[str, Any], arrays: Arrays) -> IndependentPolicies | None:
    """Put each robot's policy together again; None where there is none.

    Raises
    ------
    PolicyError
        There are others than one for each robot, or one is none.
    """
    schemas, num_robots = record["schema"].get(ALONE, []), record["schema"]["num_robots"]
    is_list = isinstance(schemas, list) and all(isinstance(schema, dict) for schema in schemas)
    if not is_list or len(schemas) not in (0, num_robots):
        raise PolicyError(f"{ALONE} is {schemas!r}; it tells of each of {num_robots} robots: learn the policy anew")
    prefixes = [f"{ALONE}.{robot}." for robot in range(len(schemas))]
    unknown = [name for name in arrays if not name.startswith(tuple(prefixes))] if prefixes else sorted(arrays)
    if unknown:
        raise PolicyError(f"array {unknown[0]!r} belongs to no robot of the record; learn the policy anew")
    each = []
    for schema, prefix in zip(schemas, prefixes, strict=True):
        own = {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
        each.append(policy_in({**record, "schema": schema}, own))
    return IndependentPolicies(tuple(each)) if each else None


def _policies(base: Policy | None) -> tuple[LinearTablePolicy, ...]:
    if base is None:
        return ()
    if isinstance(base, IndependentPolicies) and all(isinstance(policy, LinearTablePolicy) for policy in base.policies):
        return base.policies  # pyright: ignore[reportReturnType]
    raise ArgumentError(
        f"base is a {type(base).__name__}, whose code a folder cannot hold; learn with base='auto' or None"
    )
