"""Rows of numbers that are too many for the memory: written one after another to a file that nobody else sees."""

from tempfile import TemporaryFile
from typing import Any

import numpy as np
from jaxtyping import Float


class StoredRows:
    """Float64 rows on disk, written in a ``with`` block; the file is gone with the last array that shows it.

    Parameters
    ----------
    shape
        Of all rows together.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape, self._file = shape, TemporaryFile(prefix="halfseen-")  # noqa: SIM115 - closed by __exit__

    def __enter__(self) -> "StoredRows":
        """Begin."""
        return self

    def __exit__(self, *told: Any) -> None:
        """Close the file; what shows it goes on to do so."""
        self._file.close()

    def add(self, rows: Float[np.ndarray, "k T"]) -> None:
        """Write the next rows."""
        self._file.write(np.ascontiguousarray(rows, dtype=np.float64).tobytes())

    def read(self) -> Float[np.ndarray, "n T"]:
        """Show all rows; only those that are looked at take memory."""
        self._file.flush()
        return np.memmap(self._file, dtype=np.float64, mode="r", shape=self._shape)
