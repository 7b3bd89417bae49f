"""What the columns of other people's steps hold: observations, actions, rewards, ends of episodes and times.

A column has one row a step. What is observed may be whole arrays, of which columns are made; all else is one value a
step.
"""

import warnings
from collections.abc import Iterable, Mapping
from math import prod

import numpy as np

from halfseen.errors import ArgumentError, HalfseenWarning, LogError
from halfseen.logs.columns import shown
from halfseen.shapes import Bool, Float, Shaped

MOST_NUMBERS = 1000
"""Of one observation; what has more is an image or the like, of which no columns are made."""
Columns = Mapping[str, Shaped[np.ndarray, "N ..."]]
"""What a dataset holds, by name: one row a step."""


def columns_of(name: str, values: Shaped[np.ndarray, "N ..."]) -> dict[str, Shaped[np.ndarray, " N"]]:
    """Take an array with a row a step apart into columns: NAME, or NAME_0, NAME_1, … where it has more than one."""
    if values.ndim == 1:
        return {name: values}
    flat = values.reshape(len(values), prod(values.shape[1:]))
    return {f"{name}_{k}": flat[:, k] for k in range(flat.shape[1])}


def observed_columns(place: str, columns: Columns) -> dict[str, Shaped[np.ndarray, " N"]]:
    """Make columns of observations; what is neither numbers nor text, or too long, is passed over with a warning.

    Parameters
    ----------
    place
        What to call the dataset in messages.
    columns
        The observations.

    Raises
    ------
    LogError
        Two observations make the same column.
    """
    observed: dict[str, np.ndarray] = {}
    passed_over = []
    for name, values in columns.items():
        if values.dtype.kind not in "biufO" or values[:1].size > MOST_NUMBERS or _is_strange(values):
            passed_over.append(f"{name} ({values.dtype} of shape {values.shape[1:]})")
            continue
        for column, entries in columns_of(name, values).items():
            if column in observed:
                raise LogError(f"{place}: two observations make a column {column!r}; rename one")
            observed[column] = entries
    if passed_over:
        warn(place, f"{', '.join(passed_over)}: no columns of a stage hold it, so it is left out")
    return observed


def _is_strange(values: np.ndarray) -> bool:
    """Whether objects are anything but text and null."""
    return values.dtype == object and not all(value is None or isinstance(value, str) for value in values.flat)


def actions_of(place: str, name: str, values: Shaped[np.ndarray, "N ..."]) -> Shaped[np.ndarray, " N"]:
    """Bring actions into whole numbers (null as None) or text.

    Raises
    ------
    ArgumentError
        They are not one of finitely many each.
    """
    flat = values.reshape(len(values)) if values.ndim > 1 and values[:1].size == 1 else values
    if flat.ndim == 1 and flat.dtype.kind in "biu":
        return flat.astype(np.int64)
    if flat.ndim == 1 and flat.dtype == object and not _is_strange(flat):
        return flat
    if flat.ndim == 1 and flat.dtype.kind == "f":
        is_null = np.isnan(flat)
        if (is_null | (np.isfinite(flat) & (flat == np.floor(flat)) & (np.abs(flat) < 2**53))).all():
            whole = np.where(is_null, 0, flat).astype(np.int64)
            return _with_null(whole, is_null) if is_null.any() else whole
    raise ArgumentError(
        f"{place}: {name} holds {values.dtype} of shape {values.shape[1:]}, and the action of a stage is one of "
        "finitely many; discretise it (say, with numpy.digitize), or name another column, of whole numbers or text, as "
        "action"
    )


def _with_null(values: np.ndarray, is_null: np.ndarray) -> np.ndarray:
    told = values.astype(object)
    told[is_null] = None
    return told


def rewards_of(place: str, name: str, values: Shaped[np.ndarray, "N ..."]) -> Float[np.ndarray, " N"]:
    """Bring rewards into numbers; true counts 1.

    Raises
    ------
    ArgumentError
        They are no single numbers.
    """
    return _single(place, name, values, "reward", "a number").astype(np.float64)


def flags_of(place: str, name: str, values: Shaped[np.ndarray, "N ..."]) -> Bool[np.ndarray, " N"]:
    """Bring a column into true and false; 1 and 0 are such.

    Raises
    ------
    ArgumentError
        It holds anything else.
    """
    flat = _single(place, name, values, "done", "true or false")
    wrong = ~((flat == 0) | (flat == 1))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise LogError(f"{place}, row {row}: {name} is {shown(flat[row])}, neither true nor false; mend it")
    return flat.astype(bool)


def times_of(place: str, name: str, values: Shaped[np.ndarray, "N ..."]) -> Float[np.ndarray, " N"]:
    """Bring a clock into seconds.

    Raises
    ------
    ArgumentError
        It holds no numbers.
    """
    return _single(place, name, values, "clock", "a time [s]").astype(np.float64)


def require(place: str, names: Iterable[str], wanted: str, role: str, remedy: str | None = None) -> None:
    """Refuse a dataset that lacks a column.

    Parameters
    ----------
    place
        What to call the dataset in messages.
    names
        Its columns.
    wanted
        The one that is needed.
    role
        What it tells.
    remedy
        What to do; by default another column is to be named for that role.

    Raises
    ------
    ArgumentError
        It does; those that are there are named.
    """
    there = list(names)
    if wanted not in there:
        raise ArgumentError(
            f"{place}: there is no {wanted!r} for the {role} among {', '.join(there[:40]) or 'none'}; "
            f"{remedy or f'name another as {role}'}"
        )


def warn(place: str, trouble: str) -> None:
    """Tell what is read otherwise than somebody may think."""
    warnings.warn(f"{place}: {trouble}", HalfseenWarning, stacklevel=4)


def _single(place: str, name: str, values: np.ndarray, role: str, meant: str) -> Shaped[np.ndarray, " N"]:
    """A column of numbers or truth values, one each step."""
    flat = values.reshape(len(values)) if values.ndim > 1 and values[:1].size == 1 else values
    if flat.ndim != 1 or flat.dtype.kind not in "biuf":
        raise ArgumentError(
            f"{place}: {name} holds {values.dtype} of shape {values.shape[1:]}, and not {meant} for each step; name "
            f"another column as {role}"
        )
    return flat
