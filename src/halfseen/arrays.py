"""Axis letters and array types, defined once.

Axis letters, as they stand in shapes all over the package:

========  ==========================================================================================================
``N``     objects of a scene, padded to the largest scene of a batch; padding is masked and may hold anything
``T``     stages of a path (a trajectory, an episode), at most; the horizon
``n``     rows: paths or observations
``m``     rows asked about: query times, states to decide
``B``     members of a batch that one compiled call handles
``F``     features of one verb
``H W``   rows and columns of a depth image [px]
========  ==========================================================================================================

Shapes are executed: the test run checks every annotated signature (`jaxtyping` with `beartype`).
"""

import sys
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

Rows: TypeAlias = Float[np.ndarray, " n"]
RowMask: TypeAlias = Bool[np.ndarray, " n"]
RowIds: TypeAlias = Int[np.ndarray, " n"]
Points: TypeAlias = Float[np.ndarray, "n 3"]
Image: TypeAlias = Float[np.ndarray, "H W"]
Intrinsics: TypeAlias = Float[np.ndarray, "3 3"]
Hides: TypeAlias = Float[np.ndarray, "N N"]
PerObject: TypeAlias = Float[np.ndarray, " N"]
ObjectMask: TypeAlias = Bool[np.ndarray, " N"]


def library_of(*values: Any) -> Any:
    """Where the functions for some arrays are: ``jax.numpy`` if one of them is JAX's, ``numpy`` for others.

    JAX takes half a second to load, so this does not: without it there are no arrays of its own.
    """
    jax = sys.modules.get("jax")
    if jax is None or not any(isinstance(value, jax.Array) for value in values):
        return np
    return jax.numpy


def on_device(tree: Any) -> Any:
    """Give a copy of NumPy's arrays as JAX's.

    `jnp.asarray` compiles a program for each shape that it meets for the first time; this compiles none.

    Parameters
    ----------
    tree
        An array, or a tree of them.
    """
    import jax

    return jax.device_put(jax.tree.map(np.array, tree))
