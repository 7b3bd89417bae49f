"""What must hold for a log of several robots: no two of them are at one object at once, and who dropped out is gone.

A stage belongs to the robot that decided at its beginning, and what a robot began is over, at the latest, by the clock
at which it decides again; what it began last may end at any time. Where stages tell in r_does what robot r is at as
they begin ("WASH 3", "FREE"), that is believed: of two robots that are free at once, the first may take what the second
has let go of, although that decides a moment later. A robot r that dropped out alone has the clock of that in r_out_s
of its trajectory.
"""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from halfseen.logs.columns import as_floats, as_labels, is_own_reward
from halfseen.logs.refusal import refuse, shown, value_at
from halfseen.shapes import Bool, Float, Int

ROBOT = "robot"
"""Column of the robot that decides in a stage; a log without it is of one robot."""

_OUT_S = re.compile(r"(\d+)_out_s")
_OUT_CAUSE = re.compile(r"(\d+)_out_cause")


def is_of_one_robot(column: str) -> bool:
    """Whether a column tells of one robot of several what it brought, or when or why it dropped out."""
    return is_own_reward(column) or any(each.fullmatch(column) for each in (_OUT_S, _OUT_CAUSE))


def robots_that_may_drop_out(trajectories: pd.DataFrame) -> list[int]:
    """Numbers of the robots of which the trajectories tell whether they dropped out."""
    found = (_OUT_S.fullmatch(str(column)) for column in trajectories.columns)
    return sorted(int(each[1]) for each in found if each is not None)


def with_drop_outs(trajectories: pd.DataFrame) -> pd.DataFrame:
    """Trajectories with the clocks and the causes of drop-outs in their types.

    Parameters
    ----------
    trajectories
        Columns trajectory, end_s [s], ending, and for each robot r that may drop out r_out_s [s] and r_out_cause.

    Raises
    ------
    LogError
        A drop-out lies outside its trajectory, or a cause has no clock.
    """
    end_s = trajectories["end_s"].to_numpy()
    for found in filter(None, (_OUT_CAUSE.fullmatch(str(column)) for column in trajectories.columns)):
        robot, column = found[1], found[0]
        trajectories[column] = as_labels("trajectories", trajectories, column, is_null_allowed=True)
        has_clock = trajectories[f"{robot}_out_s"].notna() if f"{robot}_out_s" in trajectories.columns else False
        trouble = f"{column} is given, yet {robot}_out_s is not; give the clock at which robot {robot} dropped out"
        refuse(trajectories, (trajectories[column].notna() & ~has_clock).to_numpy(dtype=bool), trouble, ("trajectory",))
    for robot in robots_that_may_drop_out(trajectories):
        column = f"{robot}_out_s"
        out_s = as_floats("trajectories", trajectories, column).to_numpy()
        trajectories[column] = out_s
        wrong = ~np.isnan(out_s) & ~((out_s > 0) & (out_s <= end_s))
        refuse(trajectories, wrong, _outside(column, out_s, end_s), ("trajectory",))
    return trajectories


def _outside(column: str, out_s: Float[np.ndarray, " n"], end_s: Float[np.ndarray, " n"]) -> Callable[[int], str]:
    remedy = "null where the robot did not drop out before it"
    return lambda row: (
        f"{column} {out_s[row]} lies outside the trajectory, which ends at {end_s[row]} s; fix it, {remedy}"
    )


def check_own_rewards(stages: pd.DataFrame, is_completed: Bool[np.ndarray, " rows"]) -> None:
    """Refuse what one robot brought where it is null in a completed stage, or given in one that was not.

    Raises
    ------
    LogError
        As above; the trajectory, the stage and the value are named.
    """
    for column in filter(is_own_reward, stages.columns):
        value = stages[column].to_numpy(dtype=np.float64)
        wrong = np.where(is_completed, ~np.isfinite(value), ~np.isnan(value))
        refuse(stages, wrong, _no_own_reward(stages, column))


def _no_own_reward(stages: pd.DataFrame, column: str) -> Callable[[int], str]:
    remedy = "give a finite number for each completed stage, and null for one that was not, or leave it out"
    return lambda row: f"{column} is {shown(value_at(stages, column, row))}; {remedy}"


def check_robots(stages: pd.DataFrame, trajectories: pd.DataFrame, trajectory_row: Int[np.ndarray, " rows"]) -> None:
    """Refuse two robots at one object, and one that decides after it dropped out.

    Stages without robots are left alone.

    Parameters
    ----------
    stages
        Sorted by trajectory and stage.
    trajectories
        Checked trajectories.
    trajectory_row
        Trajectory of each row.

    Raises
    ------
    LogError
        A robot began something with an object that another robot was at, or after it dropped out.
    """
    if ROBOT not in stages.columns:
        return
    begin_s: Any = stages["elapsed_s"].groupby(trajectory_row).shift(fill_value=0.0)
    _check_two_at_one(stages, begin_s, trajectory_row)
    for robot in robots_that_may_drop_out(trajectories):
        out_s = trajectories[f"{robot}_out_s"].to_numpy()[trajectory_row]
        late = stages[ROBOT].eq(robot).to_numpy(dtype=bool) & (begin_s.to_numpy() > out_s)
        refuse(stages, late, _late(robot, begin_s.to_numpy(), out_s))


def _late(robot: int, begin_s: Float[np.ndarray, " rows"], out_s: Float[np.ndarray, " rows"]) -> Callable[[int], str]:
    remedy = f"fix {robot}_out_s or the stage's robot"
    return lambda row: f"robot {robot} decides at {begin_s[row]} s, yet dropped out at {out_s[row]} s; {remedy}"


def _check_two_at_one(stages: pd.DataFrame, begin_s: pd.Series, trajectory_row: Int[np.ndarray, " rows"]) -> None:
    row = pd.Series(np.arange(len(stages)), index=stages.index)
    decides_again_s = begin_s.groupby([trajectory_row, stages[ROBOT]]).shift(-1).to_numpy()
    earlier = row.groupby([trajectory_row, stages["object"]]).shift(1)
    there = earlier.notna().to_numpy()
    before = earlier.fillna(0).to_numpy(dtype=np.int64)
    robots = stages[ROBOT].to_numpy()
    is_still_there = decides_again_s[before] > begin_s.to_numpy()
    at_once = there & (robots[before] != robots) & is_still_there
    for at in np.flatnonzero(at_once):
        at_once[at] = not _has_let_go(stages, robots[before[at]], int(at))

    def told(at: int) -> str:
        target, other = shown(value_at(stages, "object", at)), shown(robots[before[at]])
        return (
            f"robot {shown(robots[at])} begins with object {target}, which robot {other} is at since stage "
            f"{value_at(stages, 'stage', int(before[at]))}; mend robot or object, or leave {ROBOT!r} out if one robot "
            "made all stages"
        )

    refuse(stages, at_once, told)


def _has_let_go(stages: pd.DataFrame, robot: Any, at: int) -> bool:
    """Whether a stage tells that a robot is at something else than the object of that stage, or at nothing."""
    column = f"{robot}_does"
    does = value_at(stages, column, at) if column in stages.columns else None
    return isinstance(does, str) and not does.endswith(f" {value_at(stages, 'object', at)}")
