"""Values in the messages of a bag, by path: ``data``, ``pose.position.x``, ``data.2``, or ``position.elbow``.

A message such as JointState has a list of names beside its lists of values. The order of the names may change, and
several programs may each publish some of them on one topic, so only its name tells which entry a value is.
"""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError

_NAMES = ("name", "joint_names")
"""Fields that name the entries of lists beside them."""


class AbsentEntryError(ArgumentError):
    """A message without an entry of the given name, which another message on its topic may have."""


def value_of(message: Any, key: str, path: str | None, where: str, named: dict[str, str]) -> Any:
    """The value at a path of a message.

    Parameters
    ----------
    key, where
        Table of the mapping, and the place for messages.
    path
        Names of fields and numbers or names of entries, joined by points; None for no value.
    named
        By key, the name of the entry that was read by its number before; this one's is added.

    Raises
    ------
    AbsentEntryError
        The entry has a name, and this message lacks it.
    ArgumentError
        There is no such field, its value is not a single one of the right kind, or its number is that of an entry of
        another name than before.
    """
    if path is None:  # a trajectory's beginning without a name
        return None
    steps, value, owner = path.split("."), message, message
    for k, step in enumerate(steps):
        names = _names_beside(owner, value)
        rest = ".".join(steps[k:])
        if names and not step.isdecimal():
            if rest not in names:
                raise AbsentEntryError(f"{where} has no {path!r}; there are {', '.join(names[:40])}")
            value = value[names.index(rest)]
            break
        owner, value = value, _entered(value, step, path, where)
        if names and (was := named.setdefault(key, names[int(step)])) != names[int(step)]:
            by_name = ".".join([*steps[:k], was])
            raise ArgumentError(
                f"{where}, field {path!r} is of {was!r} in one message and of {names[int(step)]!r} in another; name "
                f"the entry: {by_name}"
            )
    value = value.item() if isinstance(value, np.generic) else value
    if not isinstance(value, str | bool | int | float):
        raise ArgumentError(f"{where}, field {path!r} is not a single value; name {_inside(value, path)}")
    _check_kind(value, key, f"{where}, field {path!r} is {value!r}")
    return value


def part(value: Any, name: str) -> Any:
    """A field of a message; None if it has no such field."""
    return value.get(name) if isinstance(value, Mapping) else getattr(value, name, None)


def _names_beside(owner: Any, value: Any) -> list[str]:
    """Names of the entries of a list in a message; none unless the message names each."""
    if not isinstance(value, list | np.ndarray):
        return []
    for names in (part(owner, name) for name in _NAMES):
        is_of_it = isinstance(names, list) and names is not value and len(names) == len(value)
        if is_of_it and all(isinstance(name, str) for name in names):
            return names
    return []


def _entered(value: Any, step: str, path: str, where: str) -> Any:
    if re.fullmatch(r"[0-9]+", step) and isinstance(value, list | np.ndarray):
        if int(step) >= len(value):
            raise ArgumentError(f"{where}, field {path!r}: there are {len(value)} entries, counted from 0; name one")
        return value[int(step)]
    if step not in _fields(value):
        raise ArgumentError(f"{where} has no field {path!r}; name {_inside(value, '')}")
    return part(value, step)


def _fields(value: Any) -> list[str]:
    """Names of the fields of a message or of a part of one."""
    if isinstance(value, Mapping):
        return list(value)
    return [name for name in getattr(value, "__dataclass_fields__", {}) if not name.startswith("_")]


def _inside(value: Any, path: str) -> str:
    """Hint at the fields with which a path could continue."""
    prefix = f"{path}." if path else ""
    if isinstance(value, list | np.ndarray):
        return f"one of its {len(value)} entries, {prefix}0 to {prefix}{len(value) - 1}" if len(value) else "another"
    return ", ".join(prefix + name for name in _fields(value)[:40]) or "a field above it"


def _check_kind(value: Any, key: str, what: str) -> None:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if key in ("reward", "probability") and not is_number:
        raise ArgumentError(f"{what}, not a number; name another field")
    is_name = isinstance(value, str) or (isinstance(value, int) and is_number)
    if key in ("action", "object", "trajectory") and not is_name:
        raise ArgumentError(f"{what}, neither text nor a whole number; name another field")
