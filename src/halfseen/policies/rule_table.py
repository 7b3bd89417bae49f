"""Rules of thumb as a table: rows of conditions and an action, of which the first that matches wins."""

import operator
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from halfseen.arrays import in_rows_of
from halfseen.errors import ArgumentError, LogError
from halfseen.logs.columns import STAGE_COLUMNS
from halfseen.shapes import Bool, Float

STAGE, ACTION = "stage", "action"
COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "!=": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
    "=": operator.eq,
}


@dataclass(frozen=True)
class Condition:
    """A condition on one column.

    Parameters
    ----------
    column
        A covariate, or ``stage``.
    sign
        ``<``, ``<=``, ``>``, ``>=``, ``=`` or ``!=``.
    value
        The value to compare with; a number, or a text for ``=`` and ``!=``.
    written
        A number as it is written, which a column of text is compared with; "" if unknown.
    """

    column: str
    sign: str
    value: float | str
    written: str = ""

    @property
    def text(self) -> str | None:
        """What a column of text is compared with, also if it looks like a number; None if text has no such order."""
        if isinstance(self.value, str):
            return self.value
        return self.written if self.written and self.sign in ("=", "!=") else None

    def holds(self, frame: pd.DataFrame, stage: int) -> Bool[np.ndarray, " m"]:
        """Whether the condition holds, for each row of covariates.

        Raises
        ------
        ArgumentError
            The column is missing, is no covariate (the reward of an action is not known before it), or holds text where
            numbers are needed, or the reverse.
        LogError
            A covariate is null.
        """
        given = pd.Series(stage, index=frame.index) if self.column == STAGE else self._column(frame)
        value = self.value if is_numeric_dtype(given.dtype) else self.text
        return np.asarray(COMPARISONS[self.sign](given, value), dtype=bool)

    def holds_in(self, values: Mapping[str, Any], stage: int) -> bool:
        """Whether the condition holds in one state, given by covariate name; faster than `holds`.

        Raises
        ------
        ArgumentError
            The covariate is missing or NaN, or is text where a number is needed, or the reverse.
        """
        given = stage if self.column == STAGE else values.get(self.column)
        value = self.text if isinstance(given, str) else self.value
        if given is None or given != given or value is None or isinstance(given, str) != isinstance(value, str):
            raise ArgumentError(
                f"the rule asks for {self.column} {self.sign} {self.value}, but {self.column} is {given}"
            )
        return bool(COMPARISONS[self.sign](given, value))

    def _column(self, frame: pd.DataFrame) -> Any:
        if self.column in STAGE_COLUMNS:
            raise ArgumentError(
                f"the rule asks for {self.column!r}, which is unknown when deciding; ask for covariates, or the stage"
            )
        if self.column not in frame.columns:
            known = ", ".join(str(name) for name in frame.columns if name == STAGE or name not in STAGE_COLUMNS)
            raise ArgumentError(
                f"the rule asks for {self.column!r}, but the log has no such column; give one of {known}"
            )
        given: Any = frame[self.column]
        is_number = is_numeric_dtype(given.dtype)
        if isinstance(self.value, str) if is_number else self.text is None:
            condition = f"{self.column} {self.sign} {self.value}"
            raise ArgumentError(
                f"the rule asks for {condition}, but {self.column} holds {'' if is_number else 'no '}numbers"
            )
        if given.isna().any():
            row: Any = frame[given.isna()].iloc[0]
            where = ", ".join(f"{name} {row[name]}" for name in ("trajectory", STAGE) if name in frame.columns)
            raise LogError(f"{where or 'a row'}: {self.column!r} is null, but the rule asks for it; fill it in")
        return given if is_number else given.astype(str)


@dataclass(frozen=True)
class RuleRow:
    """An action, and the conditions for it.

    Parameters
    ----------
    conditions
        The conditions, all of which must hold; none for a row that always matches.
    action
        Name of the action.
    """

    conditions: tuple[Condition, ...]
    action: Hashable

    def matches_state(self, values: Mapping[str, Any], stage: int) -> bool:
        """Whether all conditions hold in one state."""
        return all(condition.holds_in(values, stage) for condition in self.conditions)

    def matches(self, frame: pd.DataFrame, stage: int) -> Bool[np.ndarray, " m"]:
        """Whether all conditions hold, for each row of covariates."""
        held = [condition.holds(frame, stage) for condition in self.conditions]
        return np.all([np.ones(len(frame), dtype=bool), *held], axis=0)


@dataclass(frozen=True)
class RuleTable:
    """Takes the action of the first row whose conditions hold (a `NamedActionPolicy`).

    Parameters
    ----------
    rows
        Rows in the order in which they are tried; the last, and no other, has no conditions.
    horizon
        Number T of stages.

    Raises
    ------
    ArgumentError
        There are no rows, the last one has conditions, or another has none.

    Examples
    --------
    >>> heavy = RuleRow((Condition("weight_kg", ">", 1.5),), "parallel")
    >>> rule = RuleTable((heavy, RuleRow((), "soft")), horizon=1)
    >>> rule.actions, rule.probabilities(pd.DataFrame({"weight_kg": [2.0, 1.0]}), stage=1)
    (('parallel', 'soft'), array([[1., 0.],
           [0., 1.]]))
    """

    rows: tuple[RuleRow, ...]
    horizon: int

    def __post_init__(self) -> None:
        if not self.rows:
            raise ArgumentError("the rule has no rows; give at least one, with an action")
        if self.rows[-1].conditions:
            raise ArgumentError(
                "the last row has conditions, so a state may match no row; end with a row without conditions"
            )
        always = next(k for k, row in enumerate(self.rows, start=1) if not row.conditions)
        if always < len(self.rows):
            raise ArgumentError(f"row {always} has no conditions, so rows below it are never tried; put it last")

    @property
    def actions(self) -> tuple[Hashable, ...]:
        """Names, in order of first appearance."""
        return tuple(dict.fromkeys(row.action for row in self.rows))

    @property
    def columns(self) -> tuple[str, ...]:
        """Covariates that it asks for, in order of first appearance."""
        asked = (one.column for row in self.rows for one in row.conditions)
        return tuple(dict.fromkeys(name for name in asked if name != STAGE))

    def action(self, values: Mapping[str, Any], stage: int) -> Hashable:
        """The action of the first row that matches one state.

        Raises
        ------
        ArgumentError
            As for `Condition.holds_in`.
        """
        return next(row.action for row in self.rows if row.matches_state(values, stage))

    def probabilities(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "m A"]:
        """1 for the action of the first row that matches."""
        matches = [row.matches(frame, stage) for row in self.rows]
        code = np.array([self.actions.index(row.action) for row in self.rows])[np.argmax(matches, axis=0)]
        return (code[:, None] == np.arange(len(self.actions))).astype(np.float64)


Decide = Callable[[pd.DataFrame, int], Any]
"""(covariates, stage from 1) → name of an action for each row."""


@dataclass(frozen=True)
class Rule:
    """Takes the action returned by a function (a `NamedActionPolicy`).

    Parameters
    ----------
    decide
        Returns the name of an action for each row, given the covariates of states, one per row, and their stage, from
        1.
    actions
        Names that it may return.
    horizon
        Number T of stages.

    Examples
    --------
    >>> def by_weight(parts, stage):
    ...     return np.where(parts["weight_kg"] > 1.5, "parallel", "soft")
    >>> rule = Rule(by_weight, ("parallel", "soft"), horizon=1)
    >>> rule.probabilities(pd.DataFrame({"weight_kg": [2.0, 1.0]}), stage=1)
    array([[1., 0.],
           [0., 1.]])
    """

    decide: Decide
    actions: tuple[Hashable, ...]
    horizon: int

    def probabilities(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "m A"]:
        """1 for the action returned by the function.

        Raises
        ------
        ArgumentError
            The function does not return one of the actions for each row.
        """
        taken = np.asarray(in_rows_of(frame, self.decide(frame, stage)), dtype=object)
        if taken.shape != (len(frame),):
            raise ArgumentError(
                f"the rule gave shape {taken.shape} for {len(frame)} rows; give one action for each row"
            )
        code = pd.Index(self.actions, dtype=object).get_indexer(taken)
        if (code < 0).any():
            listed = ", ".join(map(repr, self.actions))
            raise ArgumentError(f"the rule took {taken[code < 0][0]!r}, which is not one of its actions {listed}")
        return (code[:, None] == np.arange(len(self.actions))).astype(np.float64)
