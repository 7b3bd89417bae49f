"""What a form of logs cannot hold, told before anything is written.

What is not named here comes back equal, to the last type and bit.
"""

from dataclasses import dataclass
from typing import Any

import pandas as pd

from halfseen.errors import ArgumentError, LogError
from halfseen.logs.formats.column_types import column_type
from halfseen.logs.formats.minari_steps import schema_of
from halfseen.logs.logs import Logs

PARQUET, CSV, MINARI = "parquet", "csv", "minari"


@dataclass(frozen=True)
class Loss:
    """Something that does not come back as it is.

    Parameters
    ----------
    table
        Where it is.
    column
        Which column; None for the whole table.
    trouble
        What becomes of it.
    is_refused
        Whether the log is not written because of it; if not, the values come back and something else is lost.
    """

    table: str
    column: str | None
    trouble: str
    is_refused: bool

    def __str__(self) -> str:
        return f"{self.table}: {'' if self.column is None else f'column {self.column!r} '}{self.trouble}"


def losses(logs: Logs, form: str) -> list[Loss]:
    """Find out what of a log does not come back from a form.

    Parameters
    ----------
    logs
        What would be written.
    form
        "parquet", "csv" or "minari".

    Raises
    ------
    ArgumentError
        The form is unknown.
    """
    if form not in (PARQUET, CSV, MINARI):
        raise ArgumentError(f"form {form!r}: it is none of {PARQUET}, {CSV}, {MINARI}; choose one")
    if form == PARQUET:
        return []
    told = (_as_text(table, logs.tables[table], column) for table, column in _columns(logs))
    found = [loss for loss in told if loss is not None]
    if form == CSV:
        found += [_of_name(table, column) for table, column in _columns(logs) if _is_broken(column)]
    if form == MINARI and not logs.stages["elapsed_s"].notna().to_numpy().any():
        trouble = "none was completed, so that Minari would have no step; record longer, or write Parquet"
        found.append(Loss("stages", None, trouble, is_refused=True))
    return found


def refuse_lost(logs: Logs, form: str) -> None:
    """Refuse a log of which something cannot be written in a form; all of it is named.

    Raises
    ------
    LogError
        There is such.
    """
    found = [str(loss) for loss in losses(logs, form) if loss.is_refused]
    if found:
        raise LogError("; ".join(found))


def seen_by_halfseen_alone(logs: Logs) -> list[str]:
    """Name what Minari keeps only as notes that no other program reads."""
    schema = schema_of(logs)
    steps = {"trajectory", "stage", "elapsed_s", "action", "reward", *schema.observations}
    found = {"stages": steps, "trajectories": {"trajectory", "ending", "end_s"}}
    told = [
        f"{table}.{column}"
        for table, column in _columns(logs)
        if table in found and column not in found[table] and len(logs.tables[table][column].dropna())
    ]
    return told + (["objects"] if logs.objects is not None else [])


def _columns(logs: Logs) -> list[tuple[str, str]]:
    return [(table, column) for table, frame in logs.tables.items() for column in frame.columns]


def _as_text(table: str, frame: pd.DataFrame, column: str) -> Loss | None:
    try:
        column_type(table, frame, column)
    except LogError as error:
        return Loss(table, column, str(error).partition(f"column {column!r} ")[2], is_refused=True)
    dtype: Any = frame[column].dtype
    if isinstance(dtype, pd.ArrowDtype):
        return Loss(table, column, f"comes back as pandas keeps such values, not as {dtype}", is_refused=False)
    return None


def _is_broken(column: str) -> bool:
    return len(column.splitlines()) != 1


def _of_name(table: str, column: str) -> Loss:
    return Loss(table, column, "has a name that is not one line; rename it", is_refused=True)
