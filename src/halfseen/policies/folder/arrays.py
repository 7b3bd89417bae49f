"""Policies as named arrays, and back; every shape and every number is checked on the way."""

from collections.abc import Collection, Container, Mapping
from typing import Any, NamedTuple

import numpy as np

from halfseen.errors import ArgumentError, PolicyError
from halfseen.learning.q_space import KernelMap

Arrays = Mapping[str, np.ndarray]

COEFFICIENTS, MARGIN, BEHAVIOUR = "coefficients", "margin", "behaviour"
GRASP, PER_GRIP = "grasp.chances", "grasp.per_grip"
KERNEL_NAMES = ("centre", "scale", "landmarks", "projection", "gamma")
TREND = "kernel.trend"
LARGEST = 1e30
"""Beyond it products of features and coefficients are no numbers in single precision."""


class Shape(NamedTuple):
    """Sizes that the numbers of a policy must have."""

    horizon: int
    num_blocks: int
    """Blocks of coefficients: one an action, or one a verb."""
    num_features: int
    """What Q, or its kernel, looks at."""
    dtype: type
    """Of every number: double precision for flat actions, single for tables, as they decide."""


def policy_arrays(policy: Any) -> dict[str, np.ndarray]:
    """Name the arrays of a policy and of its kernel, each in the order of its memory.

    Raises
    ------
    ArgumentError
        It is a batch of policies.
    """
    coefficients = np.asarray(policy.coefficients)
    if coefficients.ndim != 3:
        raise ArgumentError(f"coefficients have shape {coefficients.shape}, a batch of policies; write them one by one")
    arrays = {COEFFICIENTS: coefficients}
    kernel_map = getattr(policy, "kernel_map", None)
    if kernel_map is not None:
        arrays |= {f"kernel.{name}": np.asarray(getattr(kernel_map, name)) for name in KERNEL_NAMES}
        if kernel_map.trend is not None:
            arrays[TREND] = np.asarray(kernel_map.trend)
    if policy.margin is not None:
        arrays[MARGIN] = np.asarray(policy.margin)
    if policy.behaviour is not None:
        arrays[BEHAVIOUR] = np.asarray(policy.behaviour)
    return arrays


def column_major(arrays: Arrays) -> list[str]:
    """Which arrays lie in memory column by column: a product rounds by that, and so may differ in its last bit."""
    return sorted(name for name, array in arrays.items() if array.flags.f_contiguous and not array.flags.c_contiguous)


def laid_out(arrays: Arrays, by_column: Container[str]) -> dict[str, np.ndarray]:
    """Copy arrays row by row, but those that are named column by column."""
    return {name: np.array(array, order="F" if name in by_column else "C") for name, array in arrays.items()}


def check_arrays(arrays: Arrays, shape: Shape, *, may_grasp: bool = False, others: Collection[str] = ()) -> None:
    """Refuse arrays that are no policy of these sizes; those of `others` that are none of the usual may have any.

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
    if TREND in arrays:
        num_trend = shape.num_features * (shape.num_features + 3) // 2
        wanted[TREND] = (num_trend,)
        num_inputs += num_trend
    if GRASP in arrays and may_grasp:
        levels, most, _ = _sizes(arrays, GRASP, 3)
        wanted[GRASP] = (max(levels, 2), max(most, 1), max(most, 1))
        # Older folders lack it.
        wanted |= {PER_GRIP: ()} if PER_GRIP in arrays else {}
    wanted[COEFFICIENTS] = (shape.horizon, shape.num_blocks, 1 + num_inputs)
    if MARGIN in arrays:
        wanted[MARGIN] = (*wanted[COEFFICIENTS], 1 + num_inputs)
    if BEHAVIOUR in arrays:
        wanted[BEHAVIOUR] = (shape.num_blocks, 1 + shape.num_features)
    check_shapes(arrays, wanted, shape.dtype, others)


def check_shapes(
    arrays: Arrays, wanted: Mapping[str, tuple[int, ...]], dtype: type, others: Collection[str] = ()
) -> None:
    """Refuse arrays that have not these shapes, or hold what is no number; `others` may have any shape.

    Raises
    ------
    PolicyError
        The array, what it is and what it should be are named.
    """
    for name in sorted({*wanted, *arrays} - ({*others} - {*wanted})):
        _check_shape(name, arrays.get(name), wanted.get(name), dtype)
    for name, array in arrays.items():
        _check_numbers(name, array)


def sizes_of(arrays: Arrays, name: str, ndim: int) -> tuple[int, ...]:
    """Shape of an array with so many axes.

    Raises
    ------
    PolicyError
        There is none.
    """
    return _sizes(arrays, name, ndim)


def kernel_map_of(arrays: Any) -> KernelMap | None:
    """Put the kernel of a policy together again, if it has one."""
    if "kernel.centre" not in arrays:
        return None
    kernel = {name: arrays[f"kernel.{name}"] for name in KERNEL_NAMES}
    return KernelMap(**kernel, trend=arrays.get(TREND))


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
    if name == GRASP:
        wrong, rule = ~((array >= 0) & (array <= 1)), "a probability lies in [0, 1]"
    elif name in ("kernel.scale", "kernel.gamma"):
        # A feature that never varied has an infinite scale.
        wrong, rule = ~(array > 0) | (np.isinf(array) & (name == "kernel.gamma")), "it is positive"
    else:
        wrong, rule = ~(np.abs(array) <= LARGEST), f"it is finite, and {LARGEST:g} at most"
    if wrong.any():
        at = tuple(np.argwhere(wrong)[0].tolist())
        raise PolicyError(f"array {name!r} holds {array[at]} at {list(at)}; {rule}: learn the policy anew")
