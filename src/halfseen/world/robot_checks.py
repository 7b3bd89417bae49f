"""What must hold for a log of several robots, on top of what every log of tables must hold."""

from collections.abc import Callable
from itertools import combinations

import numpy as np
import pandas as pd
from jaxtyping import Bool, Int

from halfseen.errors import LogError
from halfseen.logs import Logs, LogStream
from halfseen.logs.checks.robots import robots_that_may_drop_out
from halfseen.logs.columns import as_floats
from halfseen.logs.refusal import refuse, shown, value_at
from halfseen.world.actions import TARGETED
from halfseen.world.log_checks import Lists, lists_in, object_numbers

_ROW = ("path", "stage", "object")
ATTEMPT_BY = "attempt_by"
"""Column of the robots that made the past attempts at an object; older logs have none."""
NOTHING = -1
"""Object of who is at none."""


def robots_in(logs: Logs | LogStream) -> int:
    """Number of robots that a log tells of: 0_does, 1_does and so on; 0 for a log of one robot."""
    there = logs.stage_covariates
    return sum(f"{r}_does" in there for r in range(len(there)))


def most_decisions(logs: Logs | LogStream, num_robots: int) -> int:
    """Most decisions that a robot of a log has to go, which is where a path begins.

    Raises
    ------
    LogError
        A robot does not tell how many it has to go, or none has any.
    """
    columns = [f"{r}_decisions_to_go" for r in range(num_robots)]
    for column in columns:
        if column not in logs.stage_covariates:
            raise LogError(f"stages: there is no column {column!r}; add it: the decisions that the robot has left")
    frames = [logs.stages] if isinstance(logs, Logs) else logs.stage_columns(*columns)
    most = max(float(as_floats("stages", frame, column).max()) for frame in frames for column in columns)
    if not most >= 1:
        raise LogError(f"stages: {', '.join(columns)} are {most:g} at most, yet robots decide; give what each has left")
    return int(most)


def check_drop_outs(paths: pd.DataFrame, num_robots: int) -> None:
    """Refuse drop-outs of a robot that there is none of.

    Raises
    ------
    LogError
        The column is named.
    """
    for robot in robots_that_may_drop_out(paths):
        if robot >= num_robots:
            raise LogError(
                f"paths: column '{robot}_out_s' is of a robot that there is none of; the stages tell of robots 0 to "
                f"{num_robots - 1}: rename it, or leave it out"
            )


def begun_objects(logs: Logs) -> Int[np.ndarray, " rows"]:
    """Number of the object that each stage's action is done to, −1 where it has none."""
    assert logs.objects is not None
    row = _rows_of_begun(logs)
    return np.where(row >= 0, object_numbers(logs.objects)[row], NOTHING)


def _rows_of_begun(logs: Logs) -> Int[np.ndarray, " rows"]:
    """Row, among the objects, of the one that each stage's action is done to; −1 where it has none."""
    assert logs.objects is not None
    keys = list(_ROW)
    # Where nothing was begun in any stage, the column of its objects has another type than theirs.
    stages, objects = (frame[keys].astype({"object": object}) for frame in (logs.stages, logs.objects))
    rows = objects.assign(row=np.arange(len(objects)))
    return stages.merge(rows, on=keys, how="left")["row"].fillna(-1).to_numpy(dtype=np.int64)


def check_doings(logs: Logs, decider: Int[np.ndarray, " rows"], does: Int[np.ndarray, "rows K 2"], free: int) -> None:
    """Refuse a robot that decides while it is at something, and two robots at one object.

    Parameters
    ----------
    logs
        The log.
    decider
        Which robot decides in each stage.
    does
        Verb and object of what each robot is at; verbs below 0 are none.
    free
        That of a robot that is free.

    Raises
    ------
    LogError
        The path, the stage and the robots are named.
    """
    assert logs.objects is not None
    stages, rows, num_objects = logs.stages, np.arange(len(does)), int(object_numbers(logs.objects).max()) + 1
    is_at_object = np.isin(does[..., 0], TARGETED)
    target = np.where(is_at_object, does[..., 1], NOTHING)
    for r in range(does.shape[1]):
        beyond = target[:, r] >= num_objects
        refuse(stages, beyond, _told(stages, f"{r}_does", f"and no path has more than {num_objects} objects, from 0"))
        is_busy = (decider == r) & (does[:, r, 0] != free)
        refuse(stages, is_busy, _told(stages, f"{r}_does", f"yet robot {r} decides; it decides when it is FREE"))
    for r, s in combinations(range(does.shape[1]), 2):
        at_once = is_at_object[:, r] & (target[:, r] == target[:, s])
        refuse(stages, at_once, _told(stages, f"{r}_does", f"and {s}_does the same object; mend one of them"))
    begun = begun_objects(logs)
    is_taken = (target == begun[:, None]) & is_at_object
    is_taken[rows, decider] = False

    def taken(row: int) -> str:
        other = int(np.argmax(is_taken[row]))
        what = f"robot {decider[row]} begins with object {shown(value_at(stages, 'object', row))}"
        return f"{what}, which robot {other} is at by {other}_does; mend one of them"

    refuse(stages, is_taken.any(axis=1), taken)


def check_numbers(
    stages: pd.DataFrame, decider: Int[np.ndarray, " rows"], num_robots: int, horizon: int | None
) -> None:
    """Refuse times below 0, what counts no decisions, more than a path may have, and a robot that decides without one.

    Raises
    ------
    LogError
        The path, the stage and the value are named.
    """
    for r in range(num_robots):
        names = f"{r}_since_s", f"{r}_decisions_to_go"
        since_s, to_go = (as_floats("stages", stages, name).to_numpy() for name in names)
        refuse(stages, since_s < 0, _told(stages, f"{r}_since_s", "below 0; give the seconds that it has been at it"))
        wrong = (to_go < 0) | (to_go != np.floor(to_go))
        refuse(stages, wrong, _told(stages, f"{r}_decisions_to_go", "no count; give the decisions that it has left"))
        if horizon is not None:
            trouble = f"more than horizon={horizon} decisions of all robots together; raise horizon, or mend it"
            refuse(stages, to_go > horizon, _told(stages, f"{r}_decisions_to_go", trouble))
        spent = (decider == r) & (to_go == 0)
        refuse(stages, spent, _told(stages, f"{r}_decisions_to_go", f"yet robot {r} decides; count this decision, too"))


def check_lists(objects: pd.DataFrame, reach: Lists, near: Lists, num_robots: int) -> None:
    """Refuse robots and objects that there are none of, in the lists reached_by and near.

    Raises
    ------
    LogError
        The path, the stage, the object and the value are named.
    """
    _check_robots_named(objects, "reached_by", reach, num_robots)
    in_stage = objects.groupby(["path", "stage"])["object"].transform("size").to_numpy()
    no_object = near.rows_with(_is_none_of(near, in_stage))
    remedy = "names an object that the stage has not; objects go by their place in it, from 0"
    refuse(objects, no_object, _told(objects, "near", remedy), _ROW)


def check_attempts(objects: pd.DataFrame, num_robots: int) -> None:
    """Refuse attempts of which attempt_by, where there is one, names no robot, or one that there is none of.

    Raises
    ------
    LogError
        The path, the stage, the object and the value are named.
    """
    if ATTEMPT_BY not in objects.columns:
        return
    by, tried = lists_in(objects, ATTEMPT_BY), lists_in(objects, "attempt_occlusions")
    trouble = "attempt_by and attempt_occlusions differ in length; give the robot of each past attempt, or leave it out"
    refuse(objects, by.lengths != tried.lengths, trouble, _ROW)
    _check_robots_named(objects, ATTEMPT_BY, by, num_robots)


def _check_robots_named(objects: pd.DataFrame, column: str, lists: Lists, num_robots: int) -> None:
    wrong = lists.rows_with(_is_none_of(lists, np.full(len(objects), num_robots)))
    remedy = f"names a robot that there is none of; the stages tell of robots 0 to {num_robots - 1}"
    refuse(objects, wrong, _told(objects, column, remedy), _ROW)


def check_reached(logs: Logs, decider: Int[np.ndarray, " rows"], is_reached: Bool[np.ndarray, "objects K"]) -> None:
    """Refuse an action on what the robot that decides does not reach.

    Raises
    ------
    LogError
        The path, the stage, the robot and the object are named.
    """
    stages, row = logs.stages, _rows_of_begun(logs)
    wrong = (row >= 0) & ~is_reached[row, decider]

    def told(row: int) -> str:
        what = f"robot {decider[row]} begins with object {shown(value_at(stages, 'object', row))}"
        return f"{what}, which it does not reach by reached_by; mend one of them"

    refuse(stages, wrong, told)


def _is_none_of(lists: Lists, sizes: Int[np.ndarray, " rows"]) -> Bool[np.ndarray, " entries"]:
    values = lists.values
    return ~((values >= 0) & (values < sizes[lists.row]) & (values == np.floor(values)))


def _told(frame: pd.DataFrame, column: str, trouble: str) -> Callable[[int], str]:
    return lambda row: f"{column} is {shown(value_at(frame, column, row))}, {trouble}"
