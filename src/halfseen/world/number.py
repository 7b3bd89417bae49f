"""What a parameter of the world may be."""

from typing import TypeAlias

from jax import Array

Number: TypeAlias = float | int | Array
"""A plain number, or what JAX makes of it inside a compiled call."""
