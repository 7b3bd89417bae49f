"""One digest for a log: the same trajectories have the same, in memory, in parts and from any form on disk."""

import hashlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from halfseen.logs import Logs


def log_digest(logs: Logs) -> str:
    """Give the SHA-256 of what a log says: names of tables and columns, and every value, row by row."""
    digest = LogDigest()
    digest.add(logs)
    return digest.hexdigest()


class LogDigest:
    """The digest of a log that comes in parts, in the order of its trajectories."""

    def __init__(self) -> None:
        self._columns: dict[str, Any] = {}

    def add(self, part: Logs) -> None:
        """Go on with the next part."""
        for name, table in part.tables.items():
            for column in table.columns:
                for k, told in enumerate(_parts(table[column])):
                    self._columns.setdefault(f"{name}.{column}.{k}", hashlib.sha256()).update(told)

    def hexdigest(self) -> str:
        """Give the SHA-256 of the columns' own."""
        columns = sorted(self._columns.items())
        return hashlib.sha256("".join(f"{name}:{of.hexdigest()}\n" for name, of in columns).encode()).hexdigest()


def _parts(values: Any) -> Iterator[bytes]:
    if pd.api.types.is_numeric_dtype(values.dtype):
        yield _number_bytes(values.to_numpy(dtype=np.float64, na_value=np.nan))
        return
    arrow = pa.array(values, from_pandas=True)
    if pa.types.is_list(arrow.type):
        yield _number_bytes(np.asarray(arrow.value_lengths().fill_null(-1), dtype=np.float64))
        yield from _parts(arrow.flatten().to_pandas())
        return
    texts = values.astype(object).map(lambda value: repr(str(value)), na_action="ignore").fillna("null")
    yield "".join(f"{text}\n" for text in texts).encode()


def _number_bytes(values: np.ndarray) -> bytes:
    # One NaN and one zero, whatever bits they came in.
    return np.where(np.isnan(values), np.nan, values + 0.0).astype("<f8").tobytes()
