"""How a broken log is refused: where, what, the value, the remedy."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from halfseen.errors import LogError

MOST_SHOWN = 200
"""Characters of a value that are told."""


def shown(value: object) -> str:
    """Write a value as it stands in the table: 17, but '17' for text, and null whatever stands for it."""
    if pd.api.types.is_scalar(value) and bool(np.asarray(pd.isna(value))):
        return "null"
    told = " ".join(map(str.strip, repr(value.item() if isinstance(value, np.generic) else value).splitlines()))
    return told if len(told) <= MOST_SHOWN else f"{told[:MOST_SHOWN]}…"


def value_at(frame: pd.DataFrame, column: str, row: int) -> Any:
    """Read one value with the type of its column; a whole row would turn its integers to floats."""
    return frame[column].iloc[row]


def place(frame: pd.DataFrame, row: int, columns: tuple[str, ...] = ("trajectory", "stage")) -> str:
    """Name a row: trajectory 17, stage 4."""
    return ", ".join(f"{column} {shown(value_at(frame, column, row))}" for column in columns)


def refuse(
    frame: pd.DataFrame,
    wrong: np.ndarray,
    trouble: str | Callable[[int], str],
    columns: tuple[str, ...] = ("trajectory", "stage"),
) -> None:
    """Raise for the first row that is wrong, if one is; `trouble` may be told from that row."""
    if wrong.any():
        row = int(np.argmax(wrong))
        raise LogError(f"{place(frame, row, columns)}: {trouble if isinstance(trouble, str) else trouble(row)}")
