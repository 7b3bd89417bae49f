"""What a parameter of the world may be."""

from collections.abc import Callable
from math import isfinite
from typing import Any, TypeAlias, TypeGuard

import numpy as np

Number: TypeAlias = float | int | Any
"""A plain number, or what JAX makes of it inside a compiled call."""
PlainNumber: TypeAlias = int | float | np.integer | np.floating


def is_number(value: object) -> TypeGuard[PlainNumber]:
    """Whether a value is a plain number, NumPy's included; a truth value is none."""
    return isinstance(value, PlainNumber) and not isinstance(value, bool)


def is_wrong(value: object, is_right: Callable[[Any], bool]) -> bool:
    """Whether a parameter is text, or a plain number that is not finite or not right.

    What JAX makes of a number inside a compiled call is not looked at.
    """
    return isinstance(value, str) or (is_number(value) and not (is_finite(value) and is_right(value)))


def is_finite(value: PlainNumber) -> bool:
    """Whether a number is one in double precision, too: an integer may be larger than any."""
    try:
        return isfinite(value)
    except OverflowError:
        return False
