"""What a parameter of the world may be, and which library computes with it."""

from collections.abc import Callable
from math import isfinite
from types import ModuleType
from typing import Any, TypeAlias, TypeGuard

import jax.numpy as jnp
import numpy as np
from jax import Array

Number: TypeAlias = float | int | Array
"""A plain number, or what JAX makes of it inside a compiled call."""


def namespace(*values: Any) -> ModuleType:
    """JAX's NumPy where one of the values is an array of JAX, else NumPy."""
    return jnp if any(isinstance(value, Array) for value in values) else np


def is_number(value: object) -> TypeGuard[int | float]:
    """Whether a value is a plain number, NumPy's included; a truth value is none."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def is_wrong(value: object, is_right: Callable[[float], bool]) -> bool:
    """Whether a parameter is text, or a plain number that is not finite or not right.

    What else a pytree may hold, such as what JAX makes of a number inside a compiled call, is not looked at.
    """
    return isinstance(value, str) or (is_number(value) and not (isfinite(value) and is_right(value)))
