"""Which actions to try, where, and in which share of the decisions: a rule table with a column ``probability``.

Each row that matches has its say, so several actions may be tried in one state; an empty cell asks nothing::

    stage,clutter,action,probability
    <= 1.5,<= 0.5,look,0.39
    <= 1.5,,shake,0.19
"""

import csv
import io
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError
from halfseen.policies.rule_files import Rows, csv_rows, named_in
from halfseen.policies.rule_table import ACTION, RuleRow
from halfseen.reading import reason_of

PROBABILITY = "probability"
MOST_EXPLORED = 0.9
"""Share of the decisions of a state that may be drawn; the rest is left to the policy."""


@dataclass(frozen=True)
class ExplorationTable:
    """Tries actions by chance where its rows match.

    Parameters
    ----------
    rows
        Conditions and actions.
    probability
        With which each row's action is drawn.
    """

    rows: tuple[RuleRow, ...]
    probability: tuple[float, ...]

    def shares(self, covariates: Mapping[str, Any], stage: int) -> dict[str, float]:
        """Probability with which each action is drawn in a state; the policy decides in the rest."""
        frame, drawn = pd.DataFrame([dict(covariates)]), dict[str, float]()
        for row, share in zip(self.rows, self.probability, strict=True):
            if str(row.action) not in drawn and bool(row.matches(frame, stage)[0]):
                drawn[str(row.action)] = share
        total = sum(drawn.values())
        return {name: share * min(1.0, MOST_EXPLORED / total) for name, share in drawn.items()}


def read_exploration(
    path: str | Path, actions: Sequence[Any], columns: Sequence[str], texts: Collection[str] = ()
) -> ExplorationTable:
    """Read a table from a CSV file.

    Parameters
    ----------
    path
        The file.
    actions, columns
        That the policy may take, and that it looks at.
    texts
        Those of the columns that hold text.

    Raises
    ------
    ArgumentError
        The file cannot be read or is no such table, names an action or a column that the policy does not know, or a
        probability is none; file and row are named.
    """
    path = Path(path)
    try:
        found = csv_rows(path, also=PROBABILITY)
        _check(found, actions, columns, texts)
        shares = tuple(_share(k, text) for k, text in enumerate(found.also, start=1))
        return ExplorationTable(found.rows, shares)
    except ArgumentError as error:
        raise ArgumentError(f"{path}: {error}") from error
    except (OSError, ValueError, csv.Error) as error:
        raise ArgumentError(f"{path}: it cannot be read as a table of what to try ({reason_of(error)})") from error


def _check(found: Rows, actions: Sequence[Any], columns: Sequence[str], texts: Collection[str]) -> None:
    known = [*columns, "stage"]
    for number, row in enumerate(found.rows, start=1):
        if str(row.action) not in map(str, actions):
            raise ArgumentError(f"row {number}: {named_in('action', row.action, actions)}")
        unknown = next((one.column for one in row.conditions if one.column not in known), None)
        if unknown is not None:
            raise ArgumentError(f"row {number}: {named_in('column', unknown, known)}")
        for one in row.conditions:
            if isinstance(one.value, str) != (one.column in texts):
                holds = "text" if one.column in texts else "numbers"
                raise ArgumentError(f"row {number}: {one.column} is {one.value!r}, and the policy knows {holds} of it")


def _share(number: int, text: str) -> float:
    try:
        share = float(text)
    except ValueError:
        share = np.nan
    if not 0.0 < share < 1.0:
        raise ArgumentError(f"row {number}: {PROBABILITY} is {text!r}; give a number between 0 and 1")
    return share


def as_csv(conditions: Sequence[Mapping[str, str]], actions: Sequence[str], shares: Sequence[float]) -> str:
    """Write rows down as `read_exploration` reads them."""
    columns = list(dict.fromkeys(name for one in conditions for name in one))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*columns, ACTION, PROBABILITY])
    for one, action, share in zip(conditions, actions, shares, strict=True):
        writer.writerow([*(one.get(name, "") for name in columns), action, f"{share:.2g}"])
    return text.getvalue()
