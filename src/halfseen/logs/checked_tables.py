"""The tables of a log, converted to their types, sorted, and checked against every rule."""

from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd

from halfseen.errors import LogError
from halfseen.logs import checks
from halfseen.logs.columns import (
    COLUMNS,
    CUT,
    FINISHED,
    NEEDED,
    NUMBERS,
    OBJECT_COLUMNS,
    ROBOT,
    UNKNOWN_CAUSE,
    as_counts,
    as_floats,
    as_labels,
    check_covariates,
    is_of_one_robot,
    is_own_reward,
    is_stage_covariate,
    refuse,
    refuse_misnamed,
    require_columns,
    robots_that_may_drop_out,
    shown,
    type_of,
    value_at,
)
from halfseen.logs.missing import KEEP, Filling, Missing, learned_filling
from halfseen.shapes import Int

_TYPES: dict[str, Callable[[str, pd.DataFrame, str], pd.Series]] = {
    "count": as_counts,
    "number": as_floats,
    "name": lambda name, frame, column: as_labels(name, frame, column, is_null_allowed=False),
    "name or null": lambda name, frame, column: as_labels(name, frame, column, is_null_allowed=True),
}


def checked_trajectories(frame: pd.DataFrame) -> pd.DataFrame:
    """Sort the trajectories and check them.

    Parameters
    ----------
    frame
        Columns trajectory, end_s [s], ending and, if any trajectory has one, cause; for each robot r that may drop
        out, r_out_s [s] and r_out_cause.

    Returns
    -------
    DataFrame
        Sorted by trajectory; a cut without a cause has the cause "unknown".

    Raises
    ------
    LogError
        A column is missing, a trajectory is duplicated, or its end is invalid.
    """
    trajectories = _typed("trajectories", frame, "cause")
    if len(frame) == 0:
        raise LogError("trajectories: the table has no rows; a log has at least one trajectory")
    trajectories = trajectories.sort_values("trajectory", kind="stable", ignore_index=True)
    # Comparing a list in a cell with a string would be element-wise.
    words = trajectories["ending"].map(lambda ending: ending if isinstance(ending, str) else "").astype(object)
    is_cut, is_finished = (words.eq(word).to_numpy(dtype=bool) for word in (CUT, FINISHED))
    values = _values(trajectories, is_cut=is_cut, is_finished=is_finished)
    causes = [column for column in trajectories.columns if is_of_one_robot(column) and column.endswith("_cause")]
    rules = [
        *checks.TRAJECTORY_RULES,
        *map(checks.out_cause_rule, causes),
        *(checks.drop_out_rules(k)[0] for k in robots_that_may_drop_out(trajectories)),
    ]
    _enforce(trajectories, values, rules, ("trajectory",))
    causes = trajectories["cause"].astype(object)
    trajectories["cause"] = causes.mask(causes.isna() & is_cut, UNKNOWN_CAUSE)
    return trajectories


def checked_stages(frame: pd.DataFrame, trajectories: pd.DataFrame) -> pd.DataFrame:
    """Sort the stages and check them against their trajectories.

    Returns
    -------
    DataFrame
        Sorted by trajectory and stage.

    Raises
    ------
    LogError
        An invariant is violated; the message names the trajectory, the stage, the value and the remedy.
    """
    stages = _typed("stages", frame, "object")
    trajectory_row = pd.Index(trajectories["trajectory"]).get_indexer(pd.Index(stages["trajectory"]))
    what = "trajectories does not list this trajectory; add its row to trajectories, or drop its stages"
    refuse(stages, trajectory_row < 0, what)
    order = np.lexsort((stages["stage"].to_numpy(), trajectory_row))
    stages, trajectory_row = _in_order(stages, order, trajectory_row)
    num_stages = np.bincount(trajectory_row, minlength=len(trajectories))
    if not num_stages.all():
        trajectory = trajectories["trajectory"].iloc[int(np.argmin(num_stages))]
        raise LogError(
            f"trajectory {shown(trajectory)}: it has no stage; even a trajectory cut in its first stage has one, not "
            "completed"
        )
    values = _stage_values(stages, trajectories, trajectory_row, num_stages)
    rules = [*map(checks.own_reward_rule, filter(is_own_reward, stages.columns)), *checks.COMPLETION_RULES]
    if values.may_stand:
        rules[:0] = [
            checks.ROBOT_RULE,
            *(checks.drop_out_rules(robot)[1] for robot in robots_that_may_drop_out(trajectories)),
        ]
    _enforce(stages, values, checks.ORDER_RULES)
    if values.may_stand:
        _find_two_at_one(stages, values, trajectory_row)
    _enforce(stages, values, rules)
    return stages


def complete_stages(stages: pd.DataFrame, missing: Missing) -> tuple[pd.DataFrame, Filling | None]:
    """Fill in null covariates of checked stages, and check all covariates.

    Raises
    ------
    ArgumentError
        A rule in `missing` is unknown, or its column is not a covariate.
    LogError
        A covariate cannot be filled in, is null although null is refused, or is not a finite number.
    """
    covariates, is_kept = [name for name in stages.columns if is_stage_covariate(name)], missing == KEEP
    filling = None if is_kept else learned_filling(missing, covariates, lambda name: [stages[name]], len(stages))
    stages = stages if filling is None else filling.of_log(stages)
    known = [name for name in stages.columns if not is_stage_covariate(name)]
    check_covariates("stages", stages, known, may_be_null=is_kept)
    return stages, filling


def checked_objects(frame: pd.DataFrame, stages: pd.DataFrame, trajectories: pd.DataFrame) -> pd.DataFrame:
    """Sort the objects and check them against their stages.

    Returns
    -------
    DataFrame
        Sorted by trajectory, stage and object.

    Raises
    ------
    LogError
        An invariant is violated; the message names the trajectory, the stage, the object and the remedy.
    """
    objects = _typed("objects", frame)
    first_row = np.flatnonzero(stages["stage"].to_numpy() == 1)
    last = np.diff(np.append(first_row, len(stages)))
    trajectory_row = pd.Index(trajectories["trajectory"]).get_indexer(pd.Index(objects["trajectory"]))
    stage = objects["stage"].to_numpy()
    values = _values(objects, stage=stage, trajectory_row=trajectory_row, last=last[trajectory_row])
    _enforce(objects, values, checks.OBJECT_RULES, OBJECT_COLUMNS)
    stage_row = first_row[trajectory_row] + stage - 1
    names = pd.Index(objects["object"]).unique().sort_values()
    name = names.get_indexer(pd.Index(objects["object"]))
    objects, there = _in_order(objects, np.lexsort((name, stage_row)), stage_row * len(names) + name)
    trouble = "the object is listed twice; give each object of a stage one row"
    refuse(objects, np.append(False, there[1:] == there[:-1]), trouble, OBJECT_COLUMNS)
    is_empty = np.bincount(stage_row, minlength=len(stages)) == 0
    remedy = "list the objects of that stage, or leave out the whole objects table"
    refuse(stages, is_empty, f"it has no row in objects; {remedy}")
    acted_on = stages["object"].notna().to_numpy()
    acted_name = np.full(len(stages), -1)
    acted_name[acted_on] = names.get_indexer(pd.Index(stages["object"][acted_on]))
    is_there = (acted_name >= 0) & np.isin(np.arange(len(stages)) * len(names) + acted_name, there)

    def absent(row: int) -> str:
        others = ", ".join(shown(names[k]) for k in there[there // len(names) == row] % len(names))
        what = f"object {shown(value_at(stages, 'object', row))} of the action is not among the objects of that stage"
        return f"{what} ({others}); add its row, or fix the action's object"

    refuse(stages, acted_on & ~is_there, absent)
    check_covariates("objects", objects, OBJECT_COLUMNS)
    return objects


def _typed(name: str, frame: pd.DataFrame, optional: str | None = None) -> pd.DataFrame:
    """A copy with all required columns, converted to their types; the column `optional` is added if missing."""
    require_columns(name, frame, NEEDED[name])
    refuse_misnamed(name, frame)
    table = frame.copy(deep=False)
    if optional is not None and optional not in table.columns:
        table[optional] = pd.Series(None, index=table.index, dtype=object)
    kinds = {column: type_of(name, column) for column in (*COLUMNS[name], *table.columns)}
    for column, kind in kinds.items():
        if kind is not None and column in table.columns:
            table[column] = _TYPES[kind](name, table, column)
    return table


def _in_order(table: pd.DataFrame, order: np.ndarray, rows: np.ndarray) -> tuple[pd.DataFrame, np.ndarray]:
    if (order[1:] > order[:-1]).all():
        return table, rows
    return table.iloc[order].reset_index(drop=True), rows[order]


def _values(table: pd.DataFrame, **derived: Any) -> SimpleNamespace:
    """Columns by name, numeric ones as arrays, and the derived values."""
    columns = {str(name): column for name, column in table.items()}
    # Own rewards of robots stay Series, so that messages write NaN as null.
    numbers = {name: each.to_numpy() for name, each in columns.items() if name in NUMBERS or name.endswith("_out_s")}
    return SimpleNamespace(**{**columns, **numbers, **derived})


def _stage_values(stages: pd.DataFrame, trajectories: pd.DataFrame, row: Any, num_stages: Any) -> SimpleNamespace:
    """Columns of sorted stages, and each stage's place in its trajectory; `row` is its row in trajectories."""
    last_row = np.cumsum(num_stages) - 1
    is_last = np.isin(np.arange(len(stages)), last_row)
    is_first = np.append(True, is_last[:-1])
    elapsed_s, number = stages["elapsed_s"].to_numpy(), stages["stage"].to_numpy()
    before_s, end_s = np.append(0.0, elapsed_s[:-1]), trajectories["end_s"].to_numpy()[row]
    clocks = [f"{robot}_out_s" for robot in robots_that_may_drop_out(trajectories)]
    return _values(
        stages if "probability" in stages.columns else stages.assign(probability=1.0),
        **{clock: trajectories[clock].to_numpy()[row] for clock in clocks},
        is_first=is_first,
        is_last=is_last,
        stage=number,
        stage_before=np.append(0, number[:-1]),
        expected=np.arange(len(stages)) - (last_row - num_stages)[row],
        is_completed=~np.isnan(elapsed_s),
        is_cut_stage=is_last & (trajectories["ending"] == CUT).to_numpy(dtype=bool)[row],
        may_stand=ROBOT in stages.columns,
        before_s=before_s,
        begin_s=np.where(is_first, 0.0, before_s),
        end_s=end_s,
        times=checks.thousandfold(end_s, elapsed_s),
    )


def _find_two_at_one(stages: pd.DataFrame, values: Any, trajectory_row: Int[np.ndarray, " rows"]) -> None:
    """Add to `values` where a robot begins with an object that another robot is at, which robot, and since when."""
    begin_s = pd.Series(values.begin_s, index=stages.index)
    decides_again_s = begin_s.groupby([trajectory_row, stages[ROBOT]]).shift(-1).to_numpy()
    row = pd.Series(np.arange(len(stages)), index=stages.index)
    earlier = row.groupby([trajectory_row, stages["object"]]).shift(1)
    before = earlier.fillna(0).to_numpy(dtype=np.int64)
    values.other, values.since = stages[ROBOT].iloc[before], values.stage[before]
    is_other = stages[ROBOT].to_numpy() != values.other.to_numpy()
    values.is_at_same = earlier.notna().to_numpy() & is_other & (decides_again_s[before] > values.begin_s)
    for at in map(int, np.flatnonzero(values.is_at_same)):
        does = f"{values.other.iloc[at]}_does"
        what = value_at(stages, does, at) if does in stages.columns else None
        has_let_go = isinstance(what, str) and not what.endswith(f" {value_at(stages, 'object', at)}")
        values.is_at_same[at] = not has_let_go


def _shown_row(values: SimpleNamespace, row: int) -> dict[str, Any]:
    """Values of a row, for messages: arrays give the number itself, columns the value as shown."""
    columns = {name: values for name, values in vars(values).items() if isinstance(values, pd.Series | np.ndarray)}
    return {n: shown(v.iloc[row]) if isinstance(v, pd.Series) else v[row] for n, v in columns.items()}


def _enforce(
    table: pd.DataFrame,
    values: SimpleNamespace,
    rules: Iterable[checks.Check],
    names: tuple[str, ...] = ("trajectory", "stage"),
) -> None:
    for rule in rules:
        wrong, line = np.asarray(rule.is_wrong(values), dtype=bool), f"{rule.message}; {rule.remedy}"
        refuse(table, wrong, lambda row, line=line: line.format_map(_shown_row(values, row)), names)
