"""Rows of a table that have these values, as tables and as dictionaries."""

from typing import Any

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
