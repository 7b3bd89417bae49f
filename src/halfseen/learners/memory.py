"""Memory that a compiler leaves behind."""

import ctypes
import sys


def give_back() -> None:
    """Hand what was freed back to the system: after XLA has compiled a large program, some hundred megabytes."""
    if sys.platform == "linux":
        # Other libraries of C do so by themselves, or cannot be told to.
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
