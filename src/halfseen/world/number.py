"""What a parameter of the world may be, and what each table of a batch has one of."""

from collections.abc import Callable, Mapping
from math import isfinite
from typing import Any, TypeAlias, TypeGuard

import numpy as np

from halfseen.arrays import Array
from halfseen.errors import ArgumentError
from halfseen.shapes import Bool, Float, Int

Number: TypeAlias = float | int | Any
"""A plain number, or what JAX makes of it inside a compiled call."""
PlainNumber: TypeAlias = int | float | np.integer | np.floating
Which: TypeAlias = Int[Array, "*B"]
"""Number of a verb, an object or a robot, for each table of a batch."""
Flags: TypeAlias = Bool[Array, "*B"]
Amounts: TypeAlias = Float[Array, "*B"]
_PARAMETERS: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    "reach_m": (lambda value: value > 0, "a finite number above 0 [m]"),
    "speed": (lambda value: value > 0, "a finite number above 0"),
    "drop_out_rate": (lambda value: value >= 0, "a finite hazard, 0 or above [1/s]"),
    "clearance_m": (lambda value: value >= 0, "a finite distance, 0 or above [m]"),
    "reward_per_s": (lambda value: value <= 0, "a finite price, 0 or below [1/s]"),
    "random_share": (lambda value: 0 <= value <= 1, "the share of decisions made at random, in [0, 1]"),
}
"""Which finite numbers each parameter can be, and what to give where it is none of them."""


def is_number(value: object) -> TypeGuard[PlainNumber]:
    """Whether a value is a plain number, NumPy's included; a truth value is none."""
    return isinstance(value, PlainNumber) and not isinstance(value, bool)


def is_finite(value: PlainNumber) -> bool:
    """Whether a number is one in double precision, too: an integer may be larger than any."""
    try:
        return isfinite(value)
    except OverflowError:
        return False


def check_number(name: str, value: object, label: str | None = None) -> None:
    """Refuse a parameter that is no number which it can be; arrays, as JAX makes them of numbers, are not looked at.

    Parameters
    ----------
    name
        Of the parameter; one that is not known here may be anything.
    value
        Given for it.
    label
        What it is called in the message.

    Raises
    ------
    ArgumentError
        As above.
    """
    is_array = hasattr(value, "dtype") and not isinstance(value, np.generic)
    if name not in _PARAMETERS or is_array:
        return
    is_right, wanted = _PARAMETERS[name]
    if not (is_number(value) and is_finite(value) and is_right(value)):
        raise ArgumentError(f"{name if label is None else label} is {value!r}; give {wanted}")
