"""What a fit to attempts accepts: tables in, checked float64 and bool out, bad values named; and folds of them."""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from halfseen.arrays import RowIds, RowMask, Rows
from halfseen.censoring import (
    CensoringModel,
    WeightDiagnostics,
    censoring_weights,
    named_model,
    uses_covariates,
    warn_if_few,
    weight_diagnostics,
)
from halfseen.errors import ArgumentError, LogError
from halfseen.logs.columns import require_columns
from halfseen.logs.frames import FrameLike, as_frame
from halfseen.shapes import Bool, Float, Int
from halfseen.tables.grasp.grasp_table import History

NAME = "attempts"


class Decided(NamedTuple):
    """Attempts that came to their own end, weighted for those that did not."""

    history: History
    succeeded: RowMask
    weight: Rows
    """1/Ĝ(time_s⁻); 1 where nothing says that anything was cut."""
    group: Int[np.ndarray, " n"]
    """Number of the object; attempts of one object are never split."""
    diagnostics: WeightDiagnostics
    row: Int[np.ndarray, " n"]
    """Of the table that was given."""

    def among(self, kept: RowMask | Int[np.ndarray, " k"]) -> "Decided":
        """Keep some, by mask or by number, with the weights and the diagnostics that they had among all."""
        history = History(*(values[kept] for values in self.history))
        succeeded, weight, group, row = (each[kept] for each in (self.succeeded, self.weight, self.group, self.row))
        return Decided(history, succeeded, weight, group, self.diagnostics, row)


def kinds(*columns: Float[np.ndarray, " n"] | Bool[np.ndarray, " n"]) -> tuple[Int[np.ndarray, " k"], RowIds]:
    """Number the rows of which all columns are alike: a fit needs to look at one of each kind alone.

    Returns
    -------
    first : Int[ndarray, "k"]
        A row of each kind.
    kind : Int[ndarray, "n"]
        Of each row.
    """
    code = np.zeros(len(columns[0]), dtype=np.int64)
    for column in columns:
        values, number = np.unique(column, return_inverse=True)
        code = code * len(values) + number
    _, first, kind = np.unique(code, return_index=True, return_inverse=True)
    return first, kind


def checked_history(data: FrameLike) -> History:
    """Read the columns that a prediction needs.

    Raises
    ------
    ArgumentError
        A column is missing, an occlusion lies outside [0, 1], a count is negative, or a value is NaN.
    """
    return _history(_frame(data))


def checked_covariates(data: FrameLike, names: Sequence[str]) -> Float[np.ndarray, "rows k"]:
    """Read what else is seen of each attempt, one column a name.

    Raises
    ------
    ArgumentError
        A column is missing, or a value is no finite number.
    """
    frame = _frame(data, names)
    return np.array([_numbers(frame, name) for name in names]).reshape(len(names), len(frame)).T


def checked_attempts(
    data: FrameLike,
    censoring: str | CensoringModel = "kaplan-meier",
    truncate_at: float | int | None = None,
) -> Decided:
    """Read attempts and weigh those that were decided.

    Parameters
    ----------
    data
        Columns occlusion, successes, failures and succeeded; optionally time_s and is_finished, and object.
    censoring, truncate_at
        As in `BetaGrasp`.

    Raises
    ------
    ArgumentError
        A column or value is none that attempts can have, or none was decided.
    PositivityError
        A weight is not identified.
    """
    frame = _frame(data, (*History._fields, "succeeded"))
    history = _history(frame)
    weight, is_decided = _weights(frame, history, censoring, truncate_at)
    succeeded = _flags(frame, "succeeded", is_decided)
    diagnostics = weight_diagnostics(weight, truncate_at)
    warn_if_few(diagnostics, stacklevel=4)
    group = pd.factorize(frame["object"])[0] if "object" in frame.columns else np.arange(len(frame))
    all_of_them = Decided(history, succeeded, weight, group.astype(np.int64), diagnostics, np.arange(len(frame)))
    return all_of_them.among(is_decided)


def _frame(data: FrameLike, needed: Iterable[str] = History._fields) -> pd.DataFrame:
    try:
        frame = as_frame(NAME, data)
        require_columns(NAME, frame, needed)
        return frame
    except LogError as error:
        raise ArgumentError(str(error)) from error


def _history(frame: pd.DataFrame) -> History:
    return History(*(_numbers(frame, column) for column in History._fields))


def _weights(
    frame: pd.DataFrame, history: History, censoring: str | CensoringModel, truncate_at: float | int | None
) -> tuple[Rows, RowMask]:
    """Weight of each attempt, and whether it was decided."""
    is_weighted = not (isinstance(censoring, str) and censoring == "none")
    model = named_model(censoring) if is_weighted else None
    for column, other in (("time_s", "is_finished"), ("is_finished", "time_s")):
        if column in frame.columns and other not in frame.columns:
            raise ArgumentError(f"{NAME}: there is {column} without {other}; add {other}, or leave out {column}")
    if len(frame) == 0:
        raise ArgumentError(f"{NAME} has no rows; give at least one decided attempt")
    if "time_s" not in frame.columns:
        return np.ones(len(frame)), np.ones(len(frame), dtype=bool)
    is_finished = _flags(frame, "is_finished", np.ones(len(frame), dtype=bool))
    if not is_finished.any():
        raise ArgumentError(f"{NAME}: all {len(frame)} were cut before they were decided; record until some are")
    if model is None:
        return is_finished.astype(np.float64), is_finished
    covariates = np.column_stack(history) if uses_covariates(model) else None
    time_s = _numbers(frame, "time_s")
    return censoring_weights(time_s, is_finished, model, covariates=covariates, truncate_at=truncate_at), is_finished


def _flags(frame: pd.DataFrame, column: str, is_read: RowMask) -> RowMask:
    is_true, is_false = (frame[column].isin([flag]).to_numpy(dtype=bool) for flag in (True, False))
    _refuse(frame, column, is_read & ~is_true & ~is_false, "give True or False")
    return is_true


_COUNT = (lambda values: (values >= 0) & (values == np.floor(values)), "give a count, 0 or more")
_MAY_BE: dict[str, tuple[Callable[[Rows], RowMask], str]] = {
    "occlusion": (lambda values: (values >= 0) & (values <= 1), "a hidden share lies in [0, 1]"),
    "successes": _COUNT,
    "failures": _COUNT,
    "time_s": (lambda values: values > 0, "give the time that the attempt was watched, > 0 s"),
}


def _numbers(frame: pd.DataFrame, column: str) -> Float[np.ndarray, " rows"]:
    values = frame[column]
    if not pd.api.types.is_numeric_dtype(values.dtype) or pd.api.types.is_complex_dtype(values.dtype):
        raise ArgumentError(f"{NAME}: column {column!r} holds {values.dtype}, not numbers; convert it")
    numbers = values.to_numpy(dtype=np.float64, na_value=np.nan)
    _refuse(frame, column, ~np.isfinite(numbers), "give a finite number")
    if column in _MAY_BE:
        is_right, remedy = _MAY_BE[column]
        _refuse(frame, column, ~is_right(numbers), remedy)
    return numbers


def _refuse(frame: pd.DataFrame, column: str, wrong: Bool[np.ndarray, " rows"], remedy: str) -> None:
    if wrong.any():
        row = int(np.argmax(wrong))
        raise ArgumentError(f"{NAME}, row {row}: {column} is {frame[column].iloc[row]}; {remedy}")


FEWEST_OBJECTS = 2
"""Objects that failed, and that succeeded, without which none can be held out."""


def can_hold_out(attempts: pd.DataFrame) -> bool:
    """Say whether either outcome was seen of enough objects to hold some out, as whoever chooses λ must.

    `attempts` are as `halfseen.tables.grasp.attempts.attempts` gives them.
    """
    decided = attempts[attempts["is_finished"].astype(bool)]
    succeeded = decided["succeeded"].astype(bool)
    return all(decided.loc[rows, "object"].nunique() >= FEWEST_OBJECTS for rows in (succeeded, ~succeeded))


def splits_of(decided: Decided, num_folds: int, random_state: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Deal attempts into folds: for each, which to fit to and which to hold out; an object's attempts stay together.

    Objects are dealt in the order of their success, so that both outcomes are in every fold: at least as many objects
    have either outcome as there are folds, and in this order they are neighbours.

    Parameters
    ----------
    decided
        The attempts.
    num_folds
        Folds, if so many objects failed and so many succeeded; else as many as did.
    random_state
        Seed.

    Raises
    ------
    ArgumentError
        There are fewer than 2 folds, or one outcome was seen of one object alone.
    """
    if num_folds < 2:
        raise ArgumentError(f"num_folds is {num_folds}; cross-validation needs at least 2")
    num_objects = [len(np.unique(decided.group[decided.succeeded == outcome])) for outcome in (False, True)]
    if min(num_objects) < FEWEST_OBJECTS:
        word = "failures" if num_objects[0] < FEWEST_OBJECTS else "successes"
        raise ArgumentError(f"{word} were seen of one object alone, so none can be held out; record more objects")
    num_folds = min(num_folds, *num_objects)
    objects, place = np.unique(decided.group, return_inverse=True)
    share = np.bincount(place, decided.succeeded) / np.bincount(place)
    fold = np.empty(len(objects), dtype=np.int64)
    shuffled = np.random.default_rng(random_state).permutation(len(objects))
    fold[np.lexsort((shuffled, share))] = np.arange(len(objects)) % num_folds
    return [(np.flatnonzero(fold[place] != k), np.flatnonzero(fold[place] == k)) for k in range(num_folds)]
