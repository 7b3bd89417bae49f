"""Checks of a log of tables, of one robot or several, in addition to those of every log.

For the columns see `halfseen.world.logs`.
"""

import warnings
from collections.abc import Callable

import numpy as np
import pandas as pd

from halfseen.errors import HalfseenWarning, LogError
from halfseen.logs import Logs, LogStream
from halfseen.logs.columns import (
    ROBOT,
    as_floats,
    place,
    refuse,
    require_columns,
    robots_that_may_drop_out,
    shown,
    value_at,
)
from halfseen.shapes import Bool, Float
from halfseen.world.actions import TARGETED, Verb
from halfseen.world.log_rows import FREE, IDLE, NOTHING, OF_OBJECT, TableLog

TABLE, DISHWASHER, LOST = LOCATIONS = ("TABLE", "DISHWASHER", "LOST")
"""Where an object is; LOST if it is no longer on the table and was not washed."""
OPTIONAL_COLUMNS = ("grip", "seen")
"""Read as 0 if a log lacks them."""
HISTORY_COLUMNS = ("successes", "failures")
"""Optional counts of past attempts at an object; laws of grasping are learned from them."""
PLACE_COLUMNS = ("x_m", "y_m", "z_m")
"""Last observed place of an object: to the right, away from the camera, and height above the table, from perception
[m]. A log has all of them or none."""
ATTEMPT_BY = "attempt_by"
"""Column of the robots that made the past attempts at an object; older logs lack it."""
CLOCK_TOLERANCE = 1e-3
"""Tolerance of times that are the same up to rounding [s], and relative."""
CLEARLY_HIDDEN, MOST_ODD, ENOUGH_ROWS = 0.1, 0.5, 20
"""Hidden shares that differ by this contradict each other; memories of a robot may, in up to this share of the rows."""
_LISTS = ("hidden_by", "attempt_occlusions", "attempt_succeeded")
_NEEDED = ("location", "occlusion", "log_odds", "lifts", *_LISTS)
_NEEDED_OF_ROBOT = ("does", "since_s", "decisions_to_go")
Values = Float[np.ndarray, " k"]
Wrong = Bool[np.ndarray, " k"]


def _is_no_share(values: Values) -> Wrong:
    return ~((values >= 0) & (values <= 1))


def _is_not_finite(values: Values) -> Wrong:
    return ~np.isfinite(values)


def _is_no_count(values: Values) -> Wrong:
    return ~((values >= 0) & (values == np.floor(values)))


def _is_no_truth(values: Values) -> Wrong:
    return ~((values == 0) | (values == 1))


_OF_NUMBERS: tuple[tuple[str, Callable[[Values], Wrong], str], ...] = (
    ("occlusion", _is_no_share, "is outside [0, 1]; give a share, not percent"),
    ("log_odds", _is_not_finite, "is not a finite number; give the log-odds of DIRTY"),
    ("seen", _is_no_share, "is outside [0, 1]; give a share, not percent"),
    ("grip", _is_not_finite, "is not a finite number; give the mean of its grip offset, 0 where unknown"),
    ("lifts", _is_no_count, "is not a count; give the number of past lifts"),
)
_OF_ENTRIES: tuple[tuple[str, Callable[[Values], Wrong], str], ...] = (
    ("hidden_by", _is_no_share, "holds a value outside [0, 1]; give shares, not percent"),
    ("attempt_occlusions", _is_no_share, "holds a value outside [0, 1]; give shares, not percent"),
    ("attempt_succeeded", _is_no_truth, "holds values other than true and false; say whether each attempt held"),
)


def robots_in(logs: Logs | LogStream) -> int:
    """Number of robots with columns in a log: 0_does, 1_does and so on; 0 for a log of one robot."""
    there = logs.stage_covariates
    return sum(f"{r}_does" in there for r in range(len(there)))


def most_decisions(logs: Logs | LogStream, num_robots: int) -> int:
    """Largest number of decisions to go of any robot in a log, reached where a trajectory begins.

    Raises
    ------
    LogError
        The column of a robot is missing, or no robot has decisions to go.
    """
    columns = [f"{r}_decisions_to_go" for r in range(num_robots)]
    for column in columns:
        if column not in logs.stage_covariates:
            raise LogError(f"stages: column {column!r} is missing; add it: the decisions that the robot has left")
    frames = [logs.stages] if isinstance(logs, Logs) else logs.stage_columns(*columns)
    most = max(float(as_floats("stages", frame, column).max()) for frame in frames for column in columns)
    if not most >= 1:
        raise LogError(
            f"stages: {', '.join(columns)} are at most {most:g}, yet robots decide; give the decisions that each "
            "robot has left"
        )
    return int(most)


def check_log(logs: Logs) -> None:
    """Check a log of several robots, as a learner does; a `LogRecorder` can run it at each stage, as its `check`.

    Raises
    ------
    LogError
        The log breaks a rule of tables or of robots; see `checked_tables`.
    """
    checked_tables(logs, is_team=True)


def checked_tables(logs: Logs, horizon: int | None = None, *, is_team: bool | None = None) -> TableLog:
    """Check a log of tables, and return its rows.

    `horizon` is T, the number of decisions over all robots; None if it is unknown. If `is_team`, the log must have
    columns of robots, and these are checked; if it is None, they are checked if present.

    Raises
    ------
    LogError
        A rule is broken; the message names the trajectory, stage, object or robot, the value and the remedy.
    """
    if logs.objects is None:
        raise LogError("objects: the log has no objects table, which learning a table needs; add it")
    require_columns("objects", logs.objects, _NEEDED)
    if horizon is not None and logs.horizon > horizon:
        raise LogError(f"stages: a trajectory has {logs.horizon} stages, more than horizon={horizon}; raise horizon")
    log = TableLog(logs, logs.objects, robots_in(logs))
    _check_stages(log)
    _check_whereabouts(log)
    _check_objects(log)
    _warn_of_hiders(log)
    if is_team or (is_team is None and log.num_robots):
        _check_robots_there(log)
        _check_doings(log, horizon)
        _check_workspace(log)
    return log


def _check_stages(log: TableLog) -> None:
    """Check that FINISH ends a trajectory, or the part of one robot of a team, and that targets are on the table."""
    # A list equals no text, and cannot be looked up either.
    stages, location = log.logs.stages, log.objects["location"].astype(str)
    is_gone = (location != TABLE).to_numpy(dtype=bool)
    is_finish, who = stages["action"].eq(Verb.FINISH.name), ["trajectory", *({ROBOT} & set(stages.columns))]
    late = is_finish.groupby([stages[name] for name in who]).shift(fill_value=False).to_numpy(dtype=bool)
    ends = "parks its robot permanently" if ROBOT in stages.columns else "ends a trajectory"
    refuse(stages, late, f"it comes after FINISH, which {ends}; drop the stage, or start a new trajectory with it")
    is_known = location.isin(LOCATIONS)
    log.refuse_objects("location", ~is_known, f"is not one of {', '.join(LOCATIONS)}; say where the object is")

    def gone(row: int) -> str:
        what = f"{value_at(stages, 'action', row)} of object {shown(value_at(stages, 'object', row))}"
        return f"{what}, which is not on the table; fix the action's object or the object's location"

    refuse(stages, (log.begun >= 0) & is_gone[log.begun], gone)


def _check_whereabouts(log: TableLog) -> None:
    """Check that an object, once listed, is listed to the end, and that none leaves the dishwasher."""
    frame, number = log.objects, log.target
    trajectory_of_stage = frame["trajectory"].to_numpy()[log.first == np.arange(len(frame))]
    goes_on = np.append(trajectory_of_stage[1:] == trajectory_of_stage[:-1], False)[log.of_stage]
    is_next = np.isin((log.of_stage + 1) * log.num_objects + number, log.of_stage * log.num_objects + number)

    def lost(row: int) -> str:
        after = int(value_at(frame, "stage", row)) + 1
        return f"stage {after} no longer lists it; list an object from its first view to the end, washed or not"

    refuse(frame, goes_on & ~is_next, lost, OF_OBJECT)
    is_washed = frame["location"].eq(DISHWASHER)
    was_washed = is_washed.astype(np.int8).groupby([frame["trajectory"], number]).shift(fill_value=0).astype(bool)
    remedy = f"follows {DISHWASHER}, which no object leaves; fix one of them, or start a new trajectory"
    log.refuse_objects("location", was_washed & ~is_washed, remedy)


def _check_objects(log: TableLog) -> None:
    frame, rows = log.objects, np.arange(len(log.objects))
    known = [name for name in (*(name for name, *_ in _OF_NUMBERS), *HISTORY_COLUMNS) if name in frame.columns]
    numbers = {name: as_floats("objects", frame, name).to_numpy() for name in known}
    for column, is_wrong, trouble in _OF_NUMBERS:
        if column in numbers:
            log.refuse_objects(column, is_wrong(numbers[column]), trouble)
    lists = {column: log.lists(column) for column in _LISTS}
    hidden_by, size = lists["hidden_by"], np.bincount(log.of_stage)[log.of_stage]
    remedy = "does not give one share for each object of the scene; give one, 0 for itself"
    log.refuse_objects("hidden_by", hidden_by.lengths != size, remedy)
    own = np.cumsum(size) - size + rows - log.first
    log.refuse_objects("hidden_by", hidden_by.values[own] > 0, "lets the object hide itself; set its own entry to 0")
    differs = lists["attempt_occlusions"].lengths != lists["attempt_succeeded"].lengths
    trouble = "attempt_occlusions and attempt_succeeded differ in length; give one of each per attempt"
    refuse(frame, differs, trouble, OF_OBJECT)
    for column, is_wrong, trouble in _OF_ENTRIES:
        log.refuse_objects(column, lists[column].rows_with(is_wrong(lists[column].values)), trouble)


def _warn_of_hiders(log: TableLog) -> None:
    """Warn where hidden shares contradict occlusions: what one object alone hides, all hide together."""
    frame, hidden_by = log.objects, log.lists("hidden_by")
    is_there = (frame["location"] == TABLE).to_numpy(dtype=bool)
    alone = np.where(is_there[log.first[hidden_by.row] + hidden_by.place], hidden_by.values, 0.0)
    most = np.maximum.reduceat(alone, np.cumsum(hidden_by.lengths) - hidden_by.lengths) if len(alone) else alone
    is_hidden = is_there & (most > CLEARLY_HIDDEN)
    is_odd = is_hidden & (most > as_floats("objects", frame, "occlusion").to_numpy() + CLEARLY_HIDDEN)
    if is_odd.sum() > MOST_ODD * max(is_hidden.sum(), ENOUGH_ROWS):
        row = int(np.argmax(is_odd))
        warnings.warn(
            f"{place(frame, row, OF_OBJECT)}: one object alone hides {most[row]:.2f} of it by hidden_by, but its "
            f"occlusion is {value_at(frame, 'occlusion', row):.2f}, as in {is_odd.sum()} of {is_hidden.sum()} rows; "
            "hidden_by lists who hides the object, not whom it hides: transpose it, or fix occlusion",
            HalfseenWarning,
            stacklevel=2,
        )


def _check_robots_there(log: TableLog) -> None:
    """Check that stages and objects have the required columns of each robot, and of no other."""
    logs, last = log.logs, log.num_robots - 1
    each = [f"{r}_{what}" for r in range(max(log.num_robots, 1)) for what in _NEEDED_OF_ROBOT]
    require_columns("stages", logs.stages, (ROBOT, *each))
    require_columns("objects", log.objects, ("reached_by", "near"))
    for robot in robots_that_may_drop_out(logs.trajectories):
        if robot > last:
            raise LogError(
                f"trajectories: column '{robot}_out_s' is of an unknown robot; the stages have robots 0 to "
                f"{last}: rename it, or leave it out"
            )
    remedy = f"but the columns are of robots 0 to {last}; use one of these, or add the columns of the robot"
    log.refuse_stages(ROBOT, log.decider < 0, remedy)


def _check_doings(log: TableLog, horizon: int | None) -> None:
    """Check that a robot decides only if it is free and has a decision left, and that no two act on one object."""
    stages, num_objects, robots = log.logs.stages, log.num_objects, range(log.num_robots)
    at = np.where(np.isin(log.does[..., 0], TARGETED), log.does[..., 1], NOTHING)
    since_s, to_go = log.of_robots("since_s"), log.of_robots("decisions_to_go")
    begin_s = stages["elapsed_s"].groupby(stages["trajectory"]).shift(fill_value=0.0).to_numpy(dtype=np.float64)
    for r in robots:
        decides, does, decisions = log.decider == r, f"{r}_does", f"{r}_decisions_to_go"
        log.refuse_stages(
            does, at[:, r] >= num_objects, f"but no trajectory has more than {num_objects} objects, counted from 0"
        )
        is_busy = decides & (log.does[:, r, 0] != IDLE[FREE])
        log.refuse_stages(does, is_busy, f"yet robot {r} decides; a robot decides only when it is FREE")
        log.refuse_stages(f"{r}_since_s", since_s[:, r] < 0, "below 0; give the seconds since its action began")
        is_before = since_s[:, r] > begin_s * (1.0 + CLOCK_TOLERANCE) + CLOCK_TOLERANCE
        trouble = (
            "longer than the trajectory by then; give the seconds since its action began, on the clock of elapsed_s"
        )
        log.refuse_stages(f"{r}_since_s", is_before, trouble)
        log.refuse_stages(decisions, _is_no_count(to_go[:, r]), "not a count; give the decisions that it has left")
        trouble = f"more than horizon={horizon} decisions of all robots together; raise horizon, or fix it"
        log.refuse_stages(decisions, to_go[:, r] > (np.inf if horizon is None else horizon), trouble)
        is_spent = decides & (to_go[:, r] == 0)
        log.refuse_stages(decisions, is_spent, f"yet robot {r} decides; count this decision too")
        own = pd.Series(to_go[decides, r], index=np.flatnonzero(decides))
        before = own.groupby(stages["trajectory"].to_numpy()[decides]).shift(fill_value=np.inf)
        is_same = np.isin(np.arange(len(stages)), own.index[own >= before])
        log.refuse_stages(decisions, is_same, "no less than at its decision before; count down with every decision")
        for s in robots[r + 1 :]:
            at_once = (at[:, r] == at[:, s]) & (at[:, r] != NOTHING)
            log.refuse_stages(does, at_once, f"and {s}_does names the same object; fix one of them")
    is_taken = (at == log.target[log.begun][:, None]) & (log.begun >= 0)[:, None]
    is_taken[np.arange(len(stages)), log.decider] = False

    def taken(row: int) -> str:
        other = int(np.argmax(is_taken[row]))
        return f"{_begins(log, row)}, which robot {other} is acting on by {other}_does; fix one of them"

    refuse(stages, is_taken.any(axis=1), taken)


def _check_workspace(log: TableLog) -> None:
    """Check that lists name existing robots and objects, and that robots act on objects in reach."""
    frame, size = log.objects, np.bincount(log.of_stage)[log.of_stage]
    robots = np.full(len(frame), log.num_robots)
    no_robot = f"names an unknown robot; the stages have robots 0 to {log.num_robots - 1}"
    no_object = "names an object that the stage lacks; objects are numbered by their place in the stage, from 0"
    of_lists = [("reached_by", robots, no_robot), ("near", size, no_object), (ATTEMPT_BY, robots, no_robot)]
    for column, num, trouble in of_lists:
        if column not in frame.columns:
            continue
        lists = log.lists(column)
        if column == ATTEMPT_BY:
            differ = "attempt_by and attempt_occlusions differ in length; give the robot of each past attempt, or leave"
            refuse(frame, lists.lengths != log.lists("attempt_occlusions").lengths, f"{differ} it out", OF_OBJECT)
        wrong = _is_no_count(lists.values) | (lists.values >= num[lists.row])
        log.refuse_objects(column, lists.rows_with(wrong), trouble)
    near = log.lists("near")
    is_own = near.values.astype(np.int64) == (np.arange(len(frame)) - log.first)[near.row]
    log.refuse_objects("near", ~near.rows_with(is_own), "lacks the object itself; list it with those too near to it")
    is_beyond = (log.begun >= 0) & ~log.is_reached[log.begun, log.decider]
    trouble = "which reached_by says it cannot reach; fix one of them"
    refuse(log.logs.stages, is_beyond, lambda row: f"{_begins(log, row)}, {trouble}")


def _begins(log: TableLog, row: int) -> str:
    return f"robot {log.decider[row]} starts on object {shown(value_at(log.logs.stages, 'object', row))}"
