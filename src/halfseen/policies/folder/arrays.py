"""Policies as named arrays, and back; every shape and every number is checked on the way."""

from collections.abc import Container, Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from halfseen.errors import ArgumentError, PolicyError
from halfseen.learners.q_learning.flat_policy import FlatPolicy
from halfseen.learners.q_learning.kernel_map import KernelMap
from halfseen.tables.features import NUM_FEATURES
from halfseen.tables.grasp.grasp_table import GraspTable
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world.action_space import Verb

Arrays = Mapping[str, np.ndarray]

COEFFICIENTS, CHANCES = "coefficients", "grasp.chances"
KERNEL_NAMES = ("centre", "scale", "landmarks", "projection", "gamma")


class Shape(NamedTuple):
    """Sizes that the numbers of a policy must have."""

    horizon: int
    num_blocks: int
    """Blocks of coefficients: one an action, or one a verb."""
    num_features: int
    """What Q, or its kernel, looks at."""
    dtype: type
    """Of every number: double precision for flat actions, single for tables, as they decide."""


def table_shape(horizon: int) -> Shape:
    """Sizes of a policy of tables."""
    return Shape(horizon, len(Verb), NUM_FEATURES, np.float32)


def flat_shape(horizon: int, num_actions: int, num_covariates: int) -> Shape:
    """Sizes of a policy of named actions."""
    return Shape(horizon, num_actions, num_covariates, np.float64)


def arrays_of(policy: FlatPolicy | LinearTablePolicy) -> dict[str, np.ndarray]:
    """Name the arrays of a policy, each in the order in which it lies in memory.

    Raises
    ------
    ArgumentError
        It is a batch of policies, or its probabilities of grasps are no table of numbers.
    """
    coefficients = np.asarray(policy.coefficients)
    if coefficients.ndim != 3:
        raise ArgumentError(f"coefficients have shape {coefficients.shape}, a batch of policies; write them one by one")
    arrays = {COEFFICIENTS: coefficients}
    if policy.kernel_map is not None:
        arrays |= {f"kernel.{name}": np.asarray(getattr(policy.kernel_map, name)) for name in KERNEL_NAMES}
    grasp = policy.grasp if isinstance(policy, LinearTablePolicy) else None
    if isinstance(grasp, GraspTable):
        arrays[CHANCES] = np.asarray(grasp.chances)
    elif grasp is not None:
        raise ArgumentError(
            f"grasp is a {type(grasp).__name__}, whose code a folder cannot hold; learn with BetaGrasp() or SVMGrasp()"
        )
    return arrays


def column_major(arrays: Arrays) -> list[str]:
    """Which arrays lie in memory column by column: a product rounds by that, and so may differ in its last bit."""
    return sorted(name for name, array in arrays.items() if array.flags.f_contiguous and not array.flags.c_contiguous)


def laid_out(arrays: Arrays, by_column: Container[str]) -> dict[str, np.ndarray]:
    """Copy arrays row by row, but those that are named column by column."""
    return {name: np.array(array, order="F" if name in by_column else "C") for name, array in arrays.items()}


def flat_policy_of(
    arrays: Arrays,
    actions: tuple[int | str, ...],
    covariates: tuple[str, ...],
    is_possible: Bool[np.ndarray, "T A"],
) -> FlatPolicy:
    """Put a policy of named actions together again.

    Raises
    ------
    PolicyError
        Arrays are missing, do not fit, or hold a number that none of theirs can be.
    """
    check_arrays(arrays, flat_shape(len(is_possible), len(actions), len(covariates)))
    return FlatPolicy(actions, covariates, is_possible, arrays[COEFFICIENTS], _kernel_map(arrays))


def table_policy_of(arrays: Arrays, horizon: int) -> LinearTablePolicy:
    """Do the same for a policy of tables."""
    check_arrays(arrays, table_shape(horizon))
    on_device: Any = {name: jnp.asarray(array) for name, array in arrays.items()}
    grasp = GraspTable(on_device[CHANCES]) if CHANCES in arrays else None
    return LinearTablePolicy(on_device[COEFFICIENTS], grasp, _kernel_map(on_device))


def check_arrays(arrays: Arrays, shape: Shape) -> None:
    """Refuse arrays that are no policy of these sizes.

    Raises
    ------
    PolicyError
        The array, what it is and what it should be are named.
    """
    wanted: dict[str, tuple[int, ...]] = {}
    num_inputs = shape.num_features
    if any(name.startswith("kernel.") for name in arrays):
        rows, rank = _sizes(arrays, "kernel.projection", 2)
        columns = (shape.num_features,)
        sizes = (columns, columns, (rows, shape.num_features), (rows, rank), ())
        wanted |= {f"kernel.{name}": size for name, size in zip(KERNEL_NAMES, sizes, strict=True)}
        num_inputs = rank
    if CHANCES in arrays and shape == table_shape(shape.horizon):
        levels, most, _ = _sizes(arrays, CHANCES, 3)
        wanted[CHANCES] = (max(levels, 2), max(most, 1), max(most, 1))
    wanted[COEFFICIENTS] = (shape.horizon, shape.num_blocks, 1 + num_inputs)
    for name in sorted({*wanted, *arrays}):
        _check_shape(name, arrays.get(name), wanted.get(name), shape.dtype)
    for name, array in arrays.items():
        _check_numbers(name, array)


def _kernel_map(arrays: Any) -> KernelMap | None:
    if "kernel.centre" not in arrays:
        return None
    return KernelMap(*(arrays[f"kernel.{name}"] for name in KERNEL_NAMES))


def _sizes(arrays: Arrays, name: str, ndim: int) -> tuple[int, ...]:
    array = arrays.get(name)
    if array is None or array.ndim != ndim:
        what = "missing" if array is None else f"of shape {list(array.shape)}"
        raise PolicyError(f"array {name!r} is {what}; it has {ndim} axes: learn the policy anew")
    return array.shape


def _check_shape(name: str, array: np.ndarray | None, wanted: tuple[int, ...] | None, dtype: type) -> None:
    if array is None or wanted is None:
        trouble = "missing" if array is None else "none that a policy has"
        raise PolicyError(f"array {name!r} is {trouble}; learn the policy anew")
    if array.shape != wanted or array.dtype != dtype:
        raise PolicyError(
            f"array {name!r} is {array.dtype} of shape {list(array.shape)}, where the schema asks for "
            f"{np.dtype(dtype)} of shape {list(wanted)}; learn the policy anew"
        )


def _check_numbers(name: str, array: np.ndarray) -> None:
    if name == CHANCES:
        wrong, rule = ~((array >= 0) & (array <= 1)), "a probability lies in [0, 1]"
    elif name in ("kernel.scale", "kernel.gamma"):
        # A feature that never varied has an infinite scale.
        wrong, rule = ~(array > 0) | (np.isinf(array) & (name == "kernel.gamma")), "it is positive"
    else:
        wrong, rule = ~np.isfinite(array), "it is finite"
    if wrong.any():
        at = tuple(np.argwhere(wrong)[0].tolist())
        raise PolicyError(f"array {name!r} holds {array[at]} at {list(at)}; {rule}: learn the policy anew")
