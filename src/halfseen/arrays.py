"""Axis letters, array types and records of arrays, defined once.

Axis letters, as they stand in shapes all over the package:

========  ==========================================================================================================
``*B``    any number of axes in front, for members of a batch; none for a single one
``N``     objects of a scene, padded to the largest scene of a batch; padding is masked and may hold anything
``K``     robots at one table
``T``     stages of a trajectory (a trajectory, an episode), at most; the horizon
``A``     actions of a table
``n``     rows: trajectories or observations
``m``     rows asked about: query times, states to decide
``F``     features of one verb
``H W``   rows and columns of a depth image [px]
========  ==========================================================================================================

Shapes are executed: the test run checks every annotated signature (`jaxtyping` with `beartype`).

What the world, the planners and the features of tables compute is written once, against the library of the arrays that
come in: NumPy, or JAX where somebody hands in arrays of JAX (the extra ``jax``). Nothing is written in place.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeAlias, TypeVar, dataclass_transform

import numpy as np

from halfseen.shapes import Bool, Float, Int

Rows: TypeAlias = Float[np.ndarray, " n"]
RowMask: TypeAlias = Bool[np.ndarray, " n"]
RowIds: TypeAlias = Int[np.ndarray, " n"]
Points: TypeAlias = Float[np.ndarray, "n 3"]
Image: TypeAlias = Float[np.ndarray, "H W"]
Intrinsics: TypeAlias = Float[np.ndarray, "3 3"]
Hides: TypeAlias = Float[np.ndarray, "N N"]
PerObject: TypeAlias = Float[np.ndarray, " N"]
ObjectMask: TypeAlias = Bool[np.ndarray, " N"]
Array: TypeAlias = Any
"""An array of NumPy's, or of JAX's; a scalar of NumPy's where there is no axis."""
Number: TypeAlias = float | int | Any
"""A plain number, or what JAX makes of it inside a compiled call."""
Which: TypeAlias = Int[Array, "*B"]
"""Number of a verb, an object or a robot, for each table of a batch."""
Flags: TypeAlias = Bool[Array, "*B"]
Amounts: TypeAlias = Float[Array, "*B"]

Tree = TypeVar("Tree")


def library_of(*values: Any) -> Any:
    """Where the functions for some arrays are: ``jax.numpy`` if one of them is JAX's, ``numpy`` for others.

    JAX takes half a second to load, so this does not: without it there are no arrays of its own.
    """
    jax = sys.modules.get("jax")
    if jax is None or not any(isinstance(value, jax.Array) for value in values):
        return np
    return jax.numpy


_RECORDS: list[type] = []


@dataclass_transform(frozen_default=True)
def record(cls: type[Tree]) -> type[Tree]:
    """Make a class a frozen dataclass whose fields are arrays, numbers or other records.

    To JAX, once it is asked for (`known_to_jax`), it is a pytree; fields with the metadata ``static`` are not traced.
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
    """Load JAX, tell it of all records, and give it."""
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
        # Not by calling it: what JAX puts in place of arrays, None among it, is nothing to be checked.
        one = object.__new__(cls)
        for name, value in zip((*names, *static), (*parts, *of_static), strict=True):
            object.__setattr__(one, name, value)
        return one

    jax.tree_util.register_pytree_node(cls, parts_of, remade)


def mapped(change: Callable[..., Any], tree: Tree, *others: Any) -> Tree:
    """Change each array of a record, a tuple or a dict of such, by those at its place in others; None stays None."""
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
    """Take each member of a batch from one of two records."""
    xp = library_of(is_new)

    def choose(one: Any, other: Any) -> Any:
        if one is other:
            return one
        return xp.where(_up_to(is_new, xp.ndim(one)), one, other)

    return mapped(choose, new, old)


def _up_to(values: Any, num_axes: int) -> Any:
    """The same with axes of length 1 behind, up to a number of axes."""
    values = library_of(values).asarray(values)
    return values.reshape(values.shape + (1,) * max(num_axes - values.ndim, 0))


def at(values: Any, index: Any) -> Any:
    """``values[..., index]`` for each member of a batch, an index each."""
    xp = library_of(values, index)
    if values.ndim == 2 and np.ndim(index) == 1:
        return values[np.arange(len(values)), index]
    index = xp.broadcast_to(index, values.shape[:-1])
    return xp.take_along_axis(values, index[..., None], axis=-1)[..., 0]


def first_last(values: Any) -> Any:
    """The first axis behind all others; no number is moved in memory."""
    return values.transpose(*range(1, values.ndim), 0)


def stacked(trees: list[Tree], axis: int = 0) -> Tree:
    """Stack records of one kind."""
    return mapped(lambda *leaves: library_of(*leaves).stack(leaves, axis=axis), *trees)


def expit(log_odds: Float[Any, "*S"]) -> Float[Any, "*S"]:
    """1 / (1 + e⁻ˣ), which overflows nowhere."""
    return 0.5 + 0.5 * library_of(log_odds).tanh(0.5 * log_odds)


def softmax(log_weights: Float[Any, "*S G"]) -> Float[Any, "*S G"]:
    """Weights that sum to 1 over the last axis."""
    xp = library_of(log_weights)
    weights = xp.exp(log_weights - xp.max(log_weights, axis=-1, keepdims=True))
    return weights / xp.sum(weights, axis=-1, keepdims=True)
