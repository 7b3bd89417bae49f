"""What differs between kinds of stored policies: their arrays, with checks of every shape and number, and their schema.

The kind of named actions is here; those of tables, which load the world, are in `table_kinds` and `law_kinds`.
"""

from collections.abc import Callable, Container, Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from halfseen.errors import ArgumentError, PolicyError
from halfseen.learning.covariates import Covariates
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.learning.q_space import KernelMap
from halfseen.logs.missing import Filling
from halfseen.policies.folder.record import Horizon, converted

Arrays = Mapping[str, np.ndarray]

COEFFICIENTS, MARGIN, BEHAVIOUR = "coefficients", "margin", "behaviour"
GRASP = "grasp.chances"
KERNEL_NAMES = ("centre", "scale", "landmarks", "projection", "gamma")
TREND = "kernel.trend"
LARGEST = 1e30
"""Beyond it products of features and coefficients overflow in single precision."""


@dataclass(frozen=True)
class PolicyKind:
    """What differs between the folders of different kinds of policies.

    Parameters
    ----------
    policy_type
        Class of the policies.
    schema
        What a policy looks at and chooses from, for policy.json; ``actions`` names the blocks of coefficients, unless
        ``blocks`` is given.
    arrays_of
        Returns the arrays of a policy by name.
    policy_of
        Rebuilds a policy from a record and arrays, and checks all of it.
    is_flat
        Whether actions are named ones; otherwise the policy is of tables.
    has_prior
        Whether the record also holds the log's prior, how it counts views, and its rewards.
    """

    policy_type: type
    schema: Callable[[Any], dict[str, Any]]
    arrays_of: Callable[[Any], dict[str, np.ndarray]]
    policy_of: Callable[[Mapping[str, Any], Arrays], Any]
    is_flat: bool = False
    has_prior: bool = False


def linear_arrays(policy: Any) -> dict[str, np.ndarray]:
    """Return the arrays of a policy and of its kernel by name, each in its memory order.

    Raises
    ------
    ArgumentError
        The policy is a batch of policies.
    """
    shape = np.shape(policy.coefficients)
    if len(shape) != 3:
        raise ArgumentError(f"coefficients have shape {shape}, a batch of policies; write them one by one")
    kernel = policy.kernel_map
    named = {COEFFICIENTS: policy.coefficients, MARGIN: policy.margin, BEHAVIOUR: policy.behaviour}
    if kernel is not None:
        named |= {f"kernel.{name}": getattr(kernel, name) for name in (*KERNEL_NAMES, "trend")}
    return {name: np.asarray(array) for name, array in named.items() if array is not None}


def kernel_map_of(arrays: Any) -> KernelMap | None:
    """Rebuild the kernel of a policy, if it has one."""
    if "kernel.centre" not in arrays:
        return None
    return KernelMap(**{name: arrays[f"kernel.{name}"] for name in KERNEL_NAMES}, trend=arrays.get(TREND))


def laid_out(arrays: Arrays, by_column: Container[str]) -> dict[str, np.ndarray]:
    """Copy arrays to row-major order, except the named ones, which become column-major."""
    return {name: np.array(array, order="F" if name in by_column else "C") for name, array in arrays.items()}


def linear_shapes(arrays: Arrays, horizon: int, num_blocks: int, num_features: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays of a policy whose Q, or its kernel, has this number of features.

    Raises
    ------
    PolicyError
        A kernel has no projection.
    """
    wanted: dict[str, tuple[int, ...]] = {}
    num_inputs = num_features
    if any(name.startswith("kernel.") for name in arrays):
        rows, num_inputs = sizes_of(arrays, "kernel.projection", 2)
        sizes = ((num_features,), (num_features,), (rows, num_features), (rows, num_inputs), ())
        wanted |= {f"kernel.{name}": size for name, size in zip(KERNEL_NAMES, sizes, strict=True)}
    if TREND in arrays:
        num_trend = num_features * (num_features + 3) // 2
        wanted[TREND] = (num_trend,)
        num_inputs += num_trend
    wanted[COEFFICIENTS] = (horizon, num_blocks, 1 + num_inputs)
    if MARGIN in arrays:
        wanted[MARGIN] = (*wanted[COEFFICIENTS], 1 + num_inputs)
    if BEHAVIOUR in arrays:
        wanted[BEHAVIOUR] = (num_blocks, 1 + num_features)
    return wanted


def sizes_of(arrays: Arrays, name: str, ndim: int) -> tuple[int, ...]:
    """Shape of an array with `ndim` axes.

    Raises
    ------
    PolicyError
        There is no such array.
    """
    array = arrays.get(name)
    if array is None or array.ndim != ndim:
        what = "missing" if array is None else f"of shape {list(array.shape)}"
        raise PolicyError(f"array {name!r} is {what}; it must have {ndim} axes: learn the policy again")
    return array.shape


def check_shapes(arrays: Arrays, wanted: Mapping[str, tuple[int, ...]], dtype: type) -> None:
    """Refuse arrays of other shapes, or with values that are not finite numbers.

    Raises
    ------
    PolicyError
        An array is wrong; it is named, with what it is and what it should be.
    """
    for name in sorted({*wanted, *arrays}):
        if name not in arrays or name not in wanted:
            trouble = "unknown" if name in arrays else "missing"
            raise PolicyError(f"array {name!r} is {trouble}; learn the policy again")
        array = arrays[name]
        if array.shape != wanted[name] or array.dtype != dtype:
            raise PolicyError(
                f"array {name!r} is {array.dtype} of shape {list(array.shape)}, but the schema needs "
                f"{np.dtype(dtype)} of shape {list(wanted[name])}; learn the policy again"
            )
        _check_numbers(name, array)


def _check_numbers(name: str, array: np.ndarray) -> None:
    if name.endswith(GRASP):
        wrong, rule = ~((array >= 0) & (array <= 1)), "a probability must lie in [0, 1]"
    elif name in ("kernel.scale", "kernel.gamma"):
        # A feature that never varied has an infinite scale.
        wrong, rule = ~(array > 0) | (np.isinf(array) & (name == "kernel.gamma")), "it must be positive"
    else:
        wrong, rule = ~(np.abs(array) <= LARGEST), f"it must be finite and at most {LARGEST:g}"
    if wrong.any():
        at = tuple(np.argwhere(wrong)[0].tolist())
        raise PolicyError(f"array {name!r} holds {array[at]} at {list(at)}; {rule}: learn the policy again")


class DiscreteSchema(Struct):
    """Covariates, categories and replacements of missing values; actions, and those possible at each stage."""

    horizon: Horizon
    covariates: list[str]
    actions: list[int | str]
    possible: list[Annotated[list[int | str], Meta(min_length=1)]]
    categories: dict[str, list[str]] = {}
    behaviour_weight: Annotated[float, Meta(ge=0.0, le=LARGEST)] = 0.0
    missing: Filling | None = None

    def __post_init__(self) -> None:
        if not {*self.categories} <= {*self.covariates}:
            raise ValueError(f"categories are of {', '.join(self.categories)}; each must be of a covariate")
        for name, each in {"actions": self.actions, "covariates": self.covariates, **self.categories}.items():
            if len(set(each)) < len(each):
                raise ValueError(f"{name} is {each}; names must differ")
        if len(self.possible) != self.horizon or not all({*each} <= {*self.actions} for each in self.possible):
            raise ValueError(
                f"possible is {self.possible}; it must list some of the actions for each of the {self.horizon} stages"
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
