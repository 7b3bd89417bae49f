"""Types of arrays in signatures, with their shapes.

They are jaxtyping's if it is loaded, as in test runs, which check every shape, and for type checkers. Nothing else
needs them, and loading them takes as long as loading NumPy: otherwise ``Float[np.ndarray, "n T"]`` is ``np.ndarray``.
"""

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Float, Int, Shaped, UInt8, UInt32
else:

    class _Unchecked:
        """The type of an array, whatever its shape."""

        def __class_getitem__(cls, type_and_shape: tuple[Any, str]) -> Any:
            return type_and_shape[0]

    Bool = Float = Int = Shaped = UInt8 = UInt32 = _Unchecked

__all__ = ["Bool", "Float", "Int", "Shaped", "UInt8", "UInt32"]
