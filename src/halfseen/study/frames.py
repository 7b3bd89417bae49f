"""Rows of a table that have some values, and rows that every repetition made alike."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd


def where(table: pd.DataFrame, **values: Any) -> pd.DataFrame:
    """Rows that have these values, in their order."""
    kept = table
    for name, value in values.items():
        kept = kept[(kept[name] == value).fillna(False)]
    return pd.DataFrame(kept)


def records(table: pd.DataFrame, **values: Any) -> list[dict[str, Any]]:
    """Rows that have these values, as dictionaries."""
    return [{str(name): value for name, value in row.items()} for row in where(table, **values).to_dict("records")]


def row_of(table: pd.DataFrame, **values: Any) -> dict[str, Any]:
    """The first row that has these values."""
    return records(table, **values)[0]


def stacked(repetitions: Sequence[Mapping[str, Any]], name: str, *measures: str) -> list[dict[str, Any]]:
    """Rows of this name, which all repetitions have alike, with arrays over repetitions for what was measured."""
    return [
        rows[0] | {measure: np.array([row[measure] for row in rows]) for measure in measures}
        for rows in zip(*(piece[name] for piece in repetitions), strict=True)
    ]
