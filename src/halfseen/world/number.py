"""What a parameter of the world may be, and which library computes with it."""

from types import ModuleType
from typing import Any, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import Array

Number: TypeAlias = float | int | Array
"""A plain number, or what JAX makes of it inside a compiled call."""


def namespace(*values: Any) -> ModuleType:
    """JAX's NumPy where one of the values is an array of JAX, else NumPy."""
    return jnp if any(isinstance(value, Array) for value in values) else np
