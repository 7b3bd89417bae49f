"""Memory that others leave behind."""

import ctypes
import sys


def give_back() -> None:
    """Hand what was freed back to the system: what Arrow has read, and what the allocator keeps."""
    arrow = sys.modules.get("pyarrow")
    if arrow is not None:
        arrow.default_memory_pool().release_unused()
    if sys.platform == "linux":
        # Other libraries of C do so by themselves, or cannot be told to.
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
