"""Attempts to grasp in the log of a table, cut ones included; input checks of fits to them; cross-validation folds."""

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
from halfseen.learning.rows import stage_places
from halfseen.logs import Logs
from halfseen.logs.columns import as_floats, refuse, require_columns, shown
from halfseen.logs.frames import FrameLike, as_frame
from halfseen.shapes import Bool, Float, Int
from halfseen.tables.grasp_table import History
from halfseen.world.actions import TARGETED, Verb
from halfseen.world.log_checks import checked_tables, robots_in
from halfseen.world.log_rows import FREE, OUT, PARKED

NAME = "attempts"
_KEY = ["trajectory", "stage", "object"]
_HISTORY = ["occlusion", "successes", "failures"]
_COLUMNS = [*_KEY, "occlusion", "grip", "successes", "failures", "succeeded", "time_s", "is_finished"]


def attempts(logs: Logs, horizon: int | None = None) -> pd.DataFrame:
    """List every attempt to WASH or LIFT (any verb with a target) whose end, or cut, was observed.

    An attempt lasts until its robot decides again, or is free to. The object's counts then show whether it succeeded.
    There are no counts after the last stage of a trajectory. A WASH that ends a trajectory before the horizon has
    cleared the table, so it succeeded. The outcome of an attempt in stage `horizon`, or in the last decision of one of
    several robots, is not recorded. Such attempts are left out, cut ones too; this depends only on the number of the
    decision, so it causes no bias. An attempt that was cut as it began is left out as well: it was watched for 0 s. An
    attempt under way when its robot dropped out counts as cut.

    Parameters
    ----------
    logs
        A log with objects: columns occlusion, successes, failures, and optionally grip.
    horizon
        Stages after which a trajectory of one robot ends by itself; by default the stages of the longest trajectory.

    Returns
    -------
    DataFrame
        One row for each attempt, sorted by trajectory and stage: trajectory, stage, object (a number for each object of
        each trajectory), occlusion, grip (0 if the log has none), successes and failures (before the attempt),
        succeeded (null where cut), time_s (duration watched, transport included [s]) and is_finished (False where cut);
        and robot if there are several.

    Raises
    ------
    LogError
        The log has no objects or lacks one of their columns, or the outcome of an attempt is unknown.
    """
    objects, stages = _checked_objects(logs), logs.stages
    if robots_in(logs):
        checked_tables(logs, is_team=True)
    ends, is_clear = _ends(logs), logs.is_finished[stage_places(logs)[0]] & (stages["action"] == Verb.WASH.name)
    rows = stages.assign(time_s=ends.after_s, next=ends.stage, is_last=_is_last(logs, horizon), is_clear=is_clear)
    rows = pd.DataFrame(rows[stages["action"].isin([verb.name for verb in TARGETED])])
    _refuse(rows, rows["object"].isna().to_numpy(), "the object of the attempt is null; name it in the column object")
    rows = rows.astype({"object": objects["object"].dtype})
    rows = rows.merge(objects, on=_KEY, how="left", validate="one_to_one")
    _refuse(rows, rows["occlusion"].isna().to_numpy(), "the object is not listed in this stage; list it in objects")
    rows = pd.DataFrame(rows[~rows["is_last"] & (rows["time_s"] > 0)]).reset_index(drop=True)
    at_end = rows[_KEY].assign(stage=rows["next"]).merge(objects, on=_KEY, how="left")
    succeeded = (_of_team if robots_in(logs) else _of_one)(rows, at_end[_HISTORY[1:]].to_numpy(dtype=np.float64))
    codes = rows.groupby(["trajectory", "object"], sort=False).ngroup()
    table = rows.assign(succeeded=succeeded, is_finished=succeeded.notna(), object=codes)
    return pd.DataFrame(table[[*_COLUMNS, *(["robot"] if robots_in(logs) else [])]])


def rows_of_attempts(logs: Logs, tried: pd.DataFrame) -> Int[np.ndarray, " k"]:
    """Rows of the stages in which the attempts began."""
    rows, begun = (pd.MultiIndex.from_frame(pd.DataFrame(each[_KEY[:2]])) for each in (logs.stages, tried))
    return rows.get_indexer(begun)


def _checked_objects(logs: Logs) -> pd.DataFrame:
    if logs.objects is None:
        raise LogError("objects: the log has no objects table, which reading attempts needs; add it")
    require_columns("objects", logs.objects, _HISTORY)
    known = logs.objects if "grip" in logs.objects.columns else logs.objects.assign(grip=0.0)
    known = pd.DataFrame(known[[*_KEY, *_HISTORY, "grip"]])
    numbers = {column: as_floats("objects", known, column) for column in (*_HISTORY, "grip")}
    return known.assign(**{column: of for column, of in numbers.items() if known[column].dtype == object})


class _Ends(NamedTuple):
    """End of the action begun in each stage."""

    stage: Int[np.ndarray, " rows"]
    """First later stage in which the robot is free; 0 if there is none, −1 if it had dropped out by then."""
    after_s: Float[np.ndarray, " rows"]
    """Time from the start of the stage until then, or until the trajectory ended or the robot dropped out [s]."""


def _ends(logs: Logs) -> _Ends:
    stages, (trajectory, stage) = logs.stages, stage_places(logs)
    row, elapsed_s = np.arange(len(stages)), stages["elapsed_s"].to_numpy(dtype=np.float64, na_value=np.nan)
    begun_s = np.where(stage == 0, 0.0, np.roll(elapsed_s, 1))
    end, robot = row + 1, stages["robot"].to_numpy() if robots_in(logs) else np.zeros(len(row))
    until_s = np.where(np.isnan(elapsed_s), logs.end_s[trajectory], elapsed_s)[
        np.searchsorted(trajectory, trajectory, side="right") - 1
    ]
    is_out = np.zeros(len(row), dtype=bool)
    for k in range(robots_in(logs)):
        is_idle = np.append(stages[f"{k}_does"].isin([FREE, PARKED, OUT]).to_numpy(), True)
        next_idle = np.flatnonzero(is_idle)[np.searchsorted(np.flatnonzero(is_idle), row, side="right")]
        end = np.where(robot == k, next_idle, end)
        if f"{k}_out_s" in logs.trajectories.columns:
            was_out = (robot == k) & (np.append(stages[f"{k}_does"] == OUT, False)[end])
            out_s = logs.trajectories[f"{k}_out_s"].to_numpy(dtype=np.float64, na_value=np.nan)
            until_s, is_out = np.where(was_out, out_s[trajectory], until_s), is_out | was_out
    is_in_trajectory = (np.append(trajectory, -1)[end] == trajectory) & ~is_out
    end = np.where(is_in_trajectory, end, 0)
    next_stage = np.where(is_in_trajectory, stage[end] + 1, np.where(is_out, -1, 0))
    return _Ends(next_stage, np.where(is_in_trajectory, begun_s[end], until_s) - begun_s)


def _is_last(logs: Logs, horizon: int | None) -> Bool[np.ndarray, " rows"]:
    """Whether a log cannot hold the outcome of an action begun in a stage."""
    stages = logs.stages
    if not robots_in(logs):
        return (stages["stage"] >= (logs.horizon if horizon is None else horizon)).to_numpy()
    each = [(stages["robot"] == k) & (stages[f"{k}_decisions_to_go"] <= 1) for k in range(robots_in(logs))]
    return np.any(each, axis=0)


def _of_one(rows: pd.DataFrame, counts: Float[np.ndarray, "rows 2"]) -> pd.Series:
    """Whether each attempt of one robot succeeded; null where it was cut."""
    gained = counts - rows[_HISTORY[1:]].to_numpy(dtype=np.float64)
    is_cut, is_observed = rows["elapsed_s"].isna().to_numpy(), ~np.isnan(counts).any(axis=1)
    is_right = (np.sort(gained, axis=1) == [0, 1]).all(axis=1)
    wrong = "successes and failures do not grow by this one attempt until the next stage; fix the counts"
    _refuse(rows, ~is_cut & is_observed & ~is_right, wrong)
    cleared = ~is_cut & (rows["next"] == 0).to_numpy() & (rows["action"] == Verb.WASH.name).to_numpy()
    unknown = "no later stage shows whether the attempt succeeded; give the horizon if it ended the trajectory"
    _refuse(rows, ~is_cut & ~is_observed & ~cleared, unknown)
    return pd.Series((is_observed & (gained[:, 0] == 1)) | cleared, dtype="boolean").mask(pd.Series(is_cut))


def _of_team(rows: pd.DataFrame, counts: Float[np.ndarray, "rows 2"]) -> pd.Series:
    """The same for several robots: only a clear table ends a trajectory while a WASH is under way."""
    was_seen, is_clear = (rows["next"] > 0).to_numpy(), (rows["next"] == 0).to_numpy() & rows["is_clear"].to_numpy()
    held = np.where(was_seen, counts[:, 0] > rows["successes"].to_numpy(), is_clear)
    return pd.Series(held, dtype="boolean").mask(pd.Series(~was_seen & ~is_clear))


def _refuse(rows: pd.DataFrame, wrong: Bool[np.ndarray, " rows"], trouble: str) -> None:
    action, target = rows["action"], rows["object"]
    refuse(rows, wrong, lambda row: f"{action.iloc[row]} of object {shown(target.iloc[row])}: {trouble}")


class DecidedAttempts(NamedTuple):
    """Decided attempts, weighted for the cut ones."""

    history: History
    succeeded: RowMask
    weight: Rows
    """1/Ĝ(time_s⁻); 1 if the data have no column of cuts."""
    group: Int[np.ndarray, " n"]
    """Number of the object; attempts at one object are never split."""
    diagnostics: WeightDiagnostics
    row: Int[np.ndarray, " n"]
    """Row in the given table."""

    def among(self, kept: RowMask | Int[np.ndarray, " k"]) -> "DecidedAttempts":
        """Keep some attempts, by mask or by number; weights and diagnostics do not change."""
        history = History(*(values[kept] for values in self.history))
        each = {name: getattr(self, name)[kept] for name in ("succeeded", "weight", "group", "row")}
        return self._replace(history=history, **each)


def kinds(*columns: Float[np.ndarray, " n"] | Bool[np.ndarray, " n"]) -> tuple[Int[np.ndarray, " k"], RowIds]:
    """Group identical rows: the first row of each kind, all that a fit needs, and the kind of each row."""
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
    """Read further covariates of each attempt, one column for each name.

    Raises
    ------
    ArgumentError
        A column is missing, or a value is not a finite number.
    """
    frame = _frame(data, names)
    return np.array([_numbers(frame, name) for name in names]).reshape(len(names), len(frame)).T


def checked_attempts(
    data: FrameLike, censoring: str | CensoringModel = "kaplan-meier", truncate_at: float | int | None = None
) -> DecidedAttempts:
    """Read attempts and weight the decided ones.

    Columns are occlusion, successes, failures and succeeded; optionally time_s and is_finished, and object.
    Weights are as in `BetaGrasp`.

    Raises
    ------
    ArgumentError
        A column or value is invalid, or no attempt was decided.
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
    all_of_them = DecidedAttempts(
        history, succeeded, weight, group.astype(np.int64), diagnostics, np.arange(len(frame))
    )
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
            raise ArgumentError(f"{NAME}: column {column} needs {other}; add {other}, or leave out {column}")
    if len(frame) == 0:
        raise ArgumentError(f"{NAME} has no rows; give at least one decided attempt")
    if "time_s" not in frame.columns:
        return np.ones(len(frame)), np.ones(len(frame), dtype=bool)
    is_finished = _flags(frame, "is_finished", np.ones(len(frame), dtype=bool))
    if not is_finished.any():
        raise ArgumentError(f"{NAME}: all {len(frame)} attempts were cut undecided; record until some are decided")
    if model is None:
        return is_finished.astype(np.float64), is_finished
    covariates = np.column_stack(history) if uses_covariates(model) else None
    time_s = _numbers(frame, "time_s")
    return censoring_weights(time_s, is_finished, model, covariates=covariates, truncate_at=truncate_at), is_finished


def _flags(frame: pd.DataFrame, column: str, is_read: RowMask) -> RowMask:
    is_true, is_false = (frame[column].isin([flag]).to_numpy(dtype=bool) for flag in (True, False))
    _refuse_value(frame, column, is_read & ~is_true & ~is_false, "give True or False")
    return is_true


_COUNT = (lambda values: (values >= 0) & (values == np.floor(values)), "give a count, 0 or more")
_MAY_BE: dict[str, tuple[Callable[[Rows], RowMask], str]] = {
    "occlusion": (lambda values: (values >= 0) & (values <= 1), "give a hidden share in [0, 1]"),
    "successes": _COUNT,
    "failures": _COUNT,
    "time_s": (lambda values: values > 0, "give the time for which the attempt was observed, > 0 s"),
}


def _numbers(frame: pd.DataFrame, column: str) -> Float[np.ndarray, " rows"]:
    values = frame[column]
    if not pd.api.types.is_numeric_dtype(values.dtype) or pd.api.types.is_complex_dtype(values.dtype):
        raise ArgumentError(f"{NAME}: column {column!r} holds {values.dtype}, not numbers; convert it")
    numbers = values.to_numpy(dtype=np.float64, na_value=np.nan)
    _refuse_value(frame, column, ~np.isfinite(numbers), "give a finite number")
    if column in _MAY_BE:
        is_right, remedy = _MAY_BE[column]
        _refuse_value(frame, column, ~is_right(numbers), remedy)
    return numbers


def _refuse_value(frame: pd.DataFrame, column: str, wrong: Bool[np.ndarray, " rows"], remedy: str) -> None:
    if wrong.any():
        row = int(np.argmax(wrong))
        raise ArgumentError(f"{NAME}, row {row}: {column} is {frame[column].iloc[row]}; {remedy}")


FEWEST_OBJECTS = 2
"""Fewest objects with failures, and with successes, for holding some out."""


def can_hold_out(attempts: pd.DataFrame) -> bool:
    """Whether both outcomes occurred with enough objects to hold some out, as the choice of λ requires."""
    decided = attempts[attempts["is_finished"].astype(bool)]
    succeeded = decided["succeeded"].astype(bool)
    return all(decided.loc[rows, "object"].nunique() >= FEWEST_OBJECTS for rows in (succeeded, ~succeeded))


def splits_of(decided: DecidedAttempts, num_folds: int, random_state: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Split attempts into folds, each as fitted and held-out attempts; attempts at one object stay together.

    There are at most `num_folds`, and no more than objects with failures or with successes. Objects are assigned to
    folds in the order of their success rate, so that every fold has both outcomes.

    Raises
    ------
    ArgumentError
        `num_folds` is below 2, or one outcome occurred with a single object only.
    """
    if num_folds < 2:
        raise ArgumentError(f"num_folds is {num_folds}; cross-validation needs at least 2")
    num_objects = [len(np.unique(decided.group[decided.succeeded == outcome])) for outcome in (False, True)]
    if min(num_objects) < FEWEST_OBJECTS:
        word = "failures" if num_objects[0] < FEWEST_OBJECTS else "successes"
        raise ArgumentError(f"{word} were seen for at most one object, so none can be held out; record more objects")
    num_folds = min(num_folds, *num_objects)
    objects, place = np.unique(decided.group, return_inverse=True)
    share = np.bincount(place, decided.succeeded) / np.bincount(place)
    fold = np.empty(len(objects), dtype=np.int64)
    shuffled = np.random.default_rng(random_state).permutation(len(objects))
    fold[np.lexsort((shuffled, share))] = np.arange(len(objects)) % num_folds
    return [(np.flatnonzero(fold[place] != k), np.flatnonzero(fold[place] == k)) for k in range(num_folds)]
