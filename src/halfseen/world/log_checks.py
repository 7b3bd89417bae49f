"""What must hold for a log of tables, on top of what every log must hold.

What must hold for a log of several robots, on top of what every log of tables must hold.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
import pyarrow as pa
from jaxtyping import Bool, Float, Int

from halfseen.errors import LogError
from halfseen.logs import Logs, LogStream
from halfseen.logs.checks.robots import ROBOT, robots_that_may_drop_out
from halfseen.logs.columns import as_floats, require_columns
from halfseen.logs.refusal import refuse, shown, value_at
from halfseen.world.actions import TARGETED, Verb

TABLE, DISHWASHER, LOST = LOCATIONS = ("TABLE", "DISHWASHER", "LOST")
"""Where an object is; lost where it is no longer on the table and was not washed."""
LIST_COLUMNS = ("hidden_by", "attempt_occlusions", "attempt_succeeded")
OBJECT_COLUMNS = ("location", "occlusion", "log_odds", "lifts", *LIST_COLUMNS)
OPTIONAL_COLUMNS = ("grip", "seen")
"""Read as 0 where a log has none of them."""
PLACE_COLUMNS = ("x_m", "y_m", "z_m")
"""Where an object was seen last: right, away from the camera, and height over the table, as perception has it [m]. A
log may have all of them or none."""
_ROW = ("path", "stage", "object")


def checked_objects(logs: Logs, horizon: int) -> "tuple[pd.DataFrame, dict[str, Lists]]":
    """Check a log of tables and give its objects, and the entries of their `LIST_COLUMNS`.

    Raises
    ------
    LogError
        A rule is broken; the path, the stage, the object, the value and the remedy are named.
    """
    if logs.objects is None:
        raise LogError("objects: the log has none; a table is learned from logs with an objects table")
    require_columns("objects", logs.objects, OBJECT_COLUMNS)
    if logs.horizon > horizon:
        raise LogError(f"stages: a path has {logs.horizon} stages, more than horizon={horizon}; raise horizon")
    frame = logs.objects
    _check_after_finish(logs.stages)
    in_stage = frame.groupby(["path", "stage"])
    counts, rank = in_stage["object"].transform("size").to_numpy(), in_stage.cumcount().to_numpy()
    _check_locations(frame)
    number = object_numbers(frame)
    _check_none_is_lost(frame, number, rank)
    _check_acted_on(logs.stages, frame, rank)
    _check_return(frame, number)
    _check_numbers(frame)
    lists = {column: lists_in(frame, column) for column in LIST_COLUMNS}
    _check_hidden_by(frame, lists["hidden_by"], counts, rank)
    _check_attempts(frame, lists)
    return frame, lists


def object_numbers(objects: pd.DataFrame) -> Int[np.ndarray, " rows"]:
    """Number of each row's object among all that its path ever lists, from 0, in the order of their names.

    A path lists what came into view so far, so that the same object may be another row of a later stage.

    Parameters
    ----------
    objects
        Columns path and object.
    """
    path, name = (pd.factorize(objects[column], sort=True)[0].astype(np.int64) for column in ("path", "object"))
    each, place = np.unique(path * (name.max(initial=0) + 1) + name, return_inverse=True)
    first = np.searchsorted(each, path * (name.max(initial=0) + 1))
    return place - first


@dataclass(frozen=True)
class Lists:
    """The entries of a list column one after the other, the row of each, and the length of each row's list."""

    row: Int[np.ndarray, " entries"]
    values: Float[np.ndarray, " entries"]
    lengths: Int[np.ndarray, " rows"]

    @property
    def place(self) -> Int[np.ndarray, " entries"]:
        """Of each entry in the list of its row, from 0."""
        return np.arange(len(self.row)) - np.repeat(np.cumsum(self.lengths) - self.lengths, self.lengths)

    def rows_with(self, wrong: Bool[np.ndarray, " entries"]) -> Bool[np.ndarray, " rows"]:
        """Rows that have a wrong entry."""
        return np.bincount(self.row[wrong], minlength=len(self.lengths)) > 0


def lists_in(frame: pd.DataFrame, column: str) -> Lists:
    """Entries of a column of lists of numbers; null is refused."""
    lists = pa.array(frame[column], from_pandas=True)
    if not (pa.types.is_list(lists.type) and _is_number(lists.type.value_type)):
        raise LogError(f"objects: column {column!r} holds {lists.type}, not lists of numbers; give each object a list")
    row, flat = np.array(lists.value_parent_indices(), dtype=np.int64), lists.flatten()
    missing = np.array(lists.is_null(), dtype=bool)
    missing[row[np.array(flat.is_null(), dtype=bool)]] = True
    _refuse(frame, missing, column, "is null or holds one; give each object a list, empty where there is nothing")
    return Lists(row, np.array(flat, dtype=np.float64), np.bincount(row, minlength=len(frame)))


def _is_number(kind: pa.DataType) -> bool:
    tests = (pa.types.is_floating, pa.types.is_integer, pa.types.is_boolean, pa.types.is_null)
    return any(test(kind) for test in tests)


def _check_after_finish(stages: pd.DataFrame) -> None:
    """FINISH ends a path; of several robots, it ends what that robot does."""
    who = ["path", *({ROBOT} & set(stages.columns))]
    is_finish = stages["action"].eq(Verb.FINISH.name)
    late = is_finish.groupby([stages[name] for name in who]).shift(fill_value=False).to_numpy(dtype=bool)
    ends = "parks its robot for good" if ROBOT in stages.columns else "ends a path"
    refuse(stages, late, f"it comes after FINISH, which {ends}; drop the stage, or begin a new path with it")


def _check_locations(frame: pd.DataFrame) -> None:
    wrong = ~frame["location"].isin(LOCATIONS).to_numpy(dtype=bool)
    _refuse(frame, wrong, "location", f"is none of {', '.join(LOCATIONS)}; say in which of them the object is")


def _check_none_is_lost(frame: pd.DataFrame, number: Int[np.ndarray, " rows"], rank: Int[np.ndarray, " rows"]) -> None:
    """Objects may come into view late, but what was listed once is listed to the end."""
    stage_row, most = np.cumsum(rank == 0) - 1, int(number.max(initial=0)) + 1
    path_of_stage = frame["path"].to_numpy()[rank == 0]
    goes_on = np.append(path_of_stage[1:] == path_of_stage[:-1], False)[stage_row]
    is_next = np.isin((stage_row + 1) * most + number, stage_row * most + number)

    def lost(row: int) -> str:
        after = int(value_at(frame, "stage", row)) + 1
        return f"stage {after} lists it no more; list an object from where it came into view to the end, washed or not"

    refuse(frame, goes_on & ~is_next, lost, _ROW)


def _check_acted_on(stages: pd.DataFrame, frame: pd.DataFrame, rank: Int[np.ndarray, " rows"]) -> None:
    stage_row = np.cumsum(rank == 0) - 1
    acted_on = stages["object"].to_numpy(dtype=object, na_value=None)[stage_row]
    is_acted_on = np.asarray(frame["object"].to_numpy(dtype=object) == acted_on, dtype=bool)
    gone = is_acted_on & (frame["location"] != TABLE).to_numpy(dtype=bool)
    wrong = np.bincount(stage_row[gone], minlength=len(stages)) > 0

    def gone_before(row: int) -> str:
        what = f"{value_at(stages, 'action', row)} of object {shown(value_at(stages, 'object', row))}"
        return f"{what}, which is not on the table; fix the action's object or the object's location"

    refuse(stages, wrong, gone_before)


def _check_return(frame: pd.DataFrame, number: Int[np.ndarray, " rows"]) -> None:
    was_washed = frame["location"].eq(DISHWASHER).astype(np.int8).groupby([frame["path"], number]).shift(fill_value=0)
    back = was_washed.to_numpy(dtype=bool) & frame["location"].ne(DISHWASHER).to_numpy(dtype=bool)
    _refuse(frame, back, "location", f"follows {DISHWASHER}, from where nothing returns; fix one, or begin a new path")


def _check_numbers(frame: pd.DataFrame) -> None:
    names = ("occlusion", "log_odds", "lifts", *(name for name in OPTIONAL_COLUMNS if name in frame.columns))
    numbers = {name: as_floats("objects", frame, name).to_numpy() for name in names}
    for name in ("occlusion", "seen"):
        wrong = _is_no_share(numbers.get(name, np.zeros(len(frame))))
        _refuse(frame, wrong, name, "is outside [0, 1]; give a share, not percent")
    wrong = ~np.isfinite(numbers.get("grip", np.zeros(len(frame))))
    _refuse(frame, wrong, "grip", "is no finite number; give the mean of its grip offset, 0 where nothing is known")
    lifts = numbers["lifts"]
    _refuse(frame, (lifts < 0) | (lifts != np.floor(lifts)), "lifts", "is no count; give the number of past lifts")


def _check_hidden_by(
    frame: pd.DataFrame, hidden_by: Lists, counts: Int[np.ndarray, " rows"], rank: Int[np.ndarray, " rows"]
) -> None:
    wrong = hidden_by.lengths != counts
    _refuse(frame, wrong, "hidden_by", "does not give one share for each object of the scene; give one, 0 for itself")
    wrong = hidden_by.rows_with(_is_no_share(hidden_by.values))
    _refuse(frame, wrong, "hidden_by", "leaves [0, 1]; give shares, not percent")
    own = np.cumsum(counts) - counts + rank
    wrong = hidden_by.values[own] != 0
    _refuse(frame, wrong, "hidden_by", "lets the object hide itself; its own entry is 0")


def _check_attempts(frame: pd.DataFrame, lists: Mapping[str, Lists]) -> None:
    occluded, succeeded = lists["attempt_occlusions"], lists["attempt_succeeded"]
    trouble = "attempt_occlusions and attempt_succeeded differ in length; give one of each per attempt"
    refuse(frame, occluded.lengths != succeeded.lengths, trouble, _ROW)
    wrong = occluded.rows_with(_is_no_share(occluded.values))
    _refuse(frame, wrong, "attempt_occlusions", "leaves [0, 1]; give shares, not percent")
    wrong = succeeded.rows_with((succeeded.values != 0) & (succeeded.values != 1))
    _refuse(frame, wrong, "attempt_succeeded", "holds other than true and false; say of each attempt whether it held")


def _is_no_share(values: Float[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
    return ~((values >= 0) & (values <= 1))


def _refuse(frame: pd.DataFrame, wrong: Bool[np.ndarray, " rows"], column: str, trouble: str) -> None:
    """Refuse the first row that is wrong, and show what its column holds."""
    refuse(frame, wrong, lambda row: f"{column} {trouble} (it is {shown(value_at(frame, column, row))})", _ROW)


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
