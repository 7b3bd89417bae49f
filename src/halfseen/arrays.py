"""Axis letters, array types and records of arrays, defined once.

Axis letters in the shapes of all packages:

========  ==========================================================================================================
``*B``    any number of leading batch axes; none for a single member
``N``     objects of a scene, padded to the largest scene of a batch; padding is masked and may hold anything
``K``     robots at one table
``T``     stages of a trajectory (an episode), at most; the horizon
``A``     actions of a table
``n``     rows: trajectories or observations
``m``     query rows: query times, states to decide
``F``     features of one verb
``H W``   rows and columns of a depth image [px]
========  ==========================================================================================================

Shapes are executed: the test run checks every annotated signature (`jaxtyping` with `beartype`).

The world, the planners and the features of tables are written once, for the array library of their inputs: NumPy, or
JAX (the extra ``jax``). Nothing is modified in place.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from typing import Any, TypeAlias, TypeVar, dataclass_transform

import numpy as np

from halfseen.shapes import Bool, Float, Int

Rows: TypeAlias = Float[np.ndarray, " n"]
RowMask: TypeAlias = Bool[np.ndarray, " n"]
RowIds: TypeAlias = Int[np.ndarray, " n"]
Points: TypeAlias = Float[np.ndarray, "n 3"]
Image: TypeAlias = Float[np.ndarray, "H W"]
Intrinsics: TypeAlias = Float[np.ndarray, "3 3"]
Transform: TypeAlias = Float[np.ndarray, "4 4"]
"""Of homogeneous points."""
Hides: TypeAlias = Float[np.ndarray, "N N"]
PerObject: TypeAlias = Float[np.ndarray, " N"]
ObjectMask: TypeAlias = Bool[np.ndarray, " N"]
Array: TypeAlias = Any
"""A NumPy or JAX array; a NumPy scalar where there is no axis."""
Number: TypeAlias = float | int | Any
"""A plain number, or its JAX tracer inside a compiled call."""
Which: TypeAlias = Int[Array, "*B"]
"""Index of a verb, an object or a robot, for each table of a batch."""
Flags: TypeAlias = Bool[Array, "*B"]
Amounts: TypeAlias = Float[Array, "*B"]

Tree = TypeVar("Tree")

LEAST_RANGE = 1e-12
"""Relative to their size; values that differ by less differ by rounding alone."""


def library_of(*values: Any) -> Any:
    """Return the array module for some arrays: ``jax.numpy`` if one of them is a JAX array, otherwise ``numpy``.

    JAX takes half a second to import, so this never imports it: if it is not loaded, no JAX arrays exist.
    """
    jax = sys.modules.get("jax")
    if jax is None or not any(isinstance(value, jax.Array) for value in values):
        return np
    return jax.numpy


_RECORDS: list[type] = []


@dataclass_transform(frozen_default=True)
def record(cls: type[Tree]) -> type[Tree]:
    """Make a class a frozen dataclass whose fields are arrays, numbers or other records.

    Once JAX is loaded (`known_to_jax`), it is a pytree; fields with the metadata ``static`` are not traced.
    """
    found: Any = dataclass(frozen=True)(cls)
    _RECORDS.append(found)
    if _known:
        _register(found)
    return found


STATIC = {"static": True}
"""Metadata of a field that JAX does not trace."""
_known: list[bool] = []


def known_to_jax() -> Any:
    """Load JAX, register all records with it, and return it."""
    import jax

    if not _known:
        _known.append(True)
        for each in _RECORDS:
            _register(each)
    return jax


def _register(cls: Any) -> None:
    import jax

    static = [each.name for each in fields(cls) if each.metadata.get("static")]
    names = [each.name for each in fields(cls) if each.name not in static]

    def parts_of(one: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        return tuple(getattr(one, name) for name in names), tuple(getattr(one, name) for name in static)

    def remade(of_static: tuple[Any, ...], parts: Any) -> Any:
        # Bypass the constructor: the placeholders that JAX puts in place of arrays, such as None, fail its checks.
        one = object.__new__(cls)
        for name, value in zip((*names, *static), (*parts, *of_static), strict=True):
            object.__setattr__(one, name, value)
        return one

    jax.tree_util.register_pytree_node(cls, parts_of, remade)


def mapped(change: Callable[..., Any], tree: Tree, *others: Any) -> Tree:
    """Map each array of a record, tuple or dict, together with the arrays at its place in `others`; None stays None."""
    found: Any = tree
    if tree is None:
        return found
    if is_dataclass(tree):
        traced = [each.name for each in fields(tree) if not each.metadata.get("static")]
        same = {name: mapped(change, *(getattr(each, name) for each in (tree, *others))) for name in traced}
        return replace(found, **same)
    if isinstance(tree, tuple):
        each = [mapped(change, *at) for at in zip(tree, *others, strict=True)]
        return type(found)(*each) if hasattr(tree, "_fields") else type(found)(each)
    if isinstance(tree, dict):
        return type(found)({name: mapped(change, tree[name], *(each[name] for each in others)) for name in tree})
    return change(tree, *others)


def chosen(is_new: Bool[Any, "*B"], new: Tree, old: Tree) -> Tree:
    """Select each member of a batch from one of two records."""
    return mapped(partial(_either, is_new), new, old)


def _either(is_new: Any, one: Any, other: Any) -> Any:
    if one is other:
        return one
    xp = library_of(is_new)
    return xp.where(_up_to(is_new, xp.ndim(one)), one, other)


def _up_to(values: Any, num_axes: int) -> Any:
    """Append axes of length 1, up to a number of axes."""
    values = library_of(values).asarray(values)
    return values.reshape(values.shape + (1,) * max(num_axes - values.ndim, 0))


def at(values: Any, index: Any) -> Any:
    """``values[..., index]`` for each member of a batch, with one index per member."""
    xp = library_of(values, index)
    if values.ndim == 2 and np.ndim(index) == 1:
        return values[np.arange(len(values)), index]
    index = xp.broadcast_to(index, values.shape[:-1])
    return xp.take_along_axis(values, index[..., None], axis=-1)[..., 0]


def first_last(values: Any) -> Any:
    """Move the first axis to the end, as a view."""
    return values.transpose(*range(1, values.ndim), 0)


def stacked(trees: list[Tree], axis: int = 0) -> Tree:
    """Stack records of one type."""
    return mapped(lambda *leaves: library_of(*leaves).stack(leaves, axis=axis), *trees)


def in_rows_of(frame: Any, answer: Any) -> Any:
    """Rows of an answer in the order of those of a pandas table, if it has their labels in another order."""
    labels: Any = getattr(answer, "index", None)
    asked: Any = getattr(frame, "index", None)
    if not hasattr(labels, "is_unique") or asked is None or len(labels) != len(asked) or labels.equals(asked):
        return answer
    return answer.loc[asked] if labels.is_unique and asked.isin(labels).all() else answer


def percentiles(values: Float[np.ndarray, "n ..."], *percents: int | float) -> tuple[Any, ...]:
    """Percentiles of each column, as `numpy.percentile` interpolates them, but by one sort: its checks take longer."""
    ordered = np.sort(values, axis=0)
    places = [percent / 100 * (len(values) - 1) for percent in percents]
    return tuple(
        ordered[int(place)] + place % 1 * (ordered[min(int(place) + 1, len(values) - 1)] - ordered[int(place)])
        for place in places
    )


def expit(log_odds: Float[Any, "*S"]) -> Float[Any, "*S"]:
    """1 / (1 + e⁻ˣ), without overflow."""
    return 0.5 + 0.5 * library_of(log_odds).tanh(0.5 * log_odds)


def softmax(log_weights: Float[Any, "*S G"]) -> Float[Any, "*S G"]:
    """Weights that sum to 1 over the last axis."""
    xp = library_of(log_weights)
    weights = xp.exp(log_weights - xp.max(log_weights, axis=-1, keepdims=True))
    return weights / xp.sum(weights, axis=-1, keepdims=True)
