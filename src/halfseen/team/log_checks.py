"""What must hold for a log of a team, on top of what every log of tables must hold."""

from collections.abc import Callable
from itertools import combinations

import numpy as np
import pandas as pd
from jaxtyping import Bool, Int

from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.logs.refusal import refuse, shown, value_at
from halfseen.team.config import TeamConfig
from halfseen.world.action_space import TARGETED
from halfseen.world.table_checks import Lists, object_numbers

_ROW = ("path", "stage", "object")
NOTHING = -1
"""Object of who is at none."""


def robots_in(logs: Logs) -> int:
    """Number of robots that a log tells of: 0_does, 1_does and so on."""
    stages = logs.stages
    return sum(f"{r}_does" in stages.columns for r in range(stages.shape[1]))


def check_same_robots(logs: Logs, config: TeamConfig) -> None:
    """Refuse a log of another number of robots than a team has.

    Raises
    ------
    LogError
        As above.
    """
    found, wanted = robots_in(logs), config.num_robots
    if found != wanted:
        names = f"{found} robots" + (f", 0_does to {found - 1}_does" if found else ": it has no column 0_does")
        raise LogError(f"the log tells of {names}, and the team has {wanted}; name the team that made the log")


def begun_objects(logs: Logs) -> Int[np.ndarray, " rows"]:
    """Number of the object that each stage's action is done to, −1 where it has none."""
    assert logs.objects is not None
    keys = ["path", "stage", "object"]
    numbered = logs.objects[keys].assign(number=object_numbers(logs.objects))
    merged = logs.stages[keys].merge(numbered, on=keys, how="left")
    return merged["number"].fillna(NOTHING).to_numpy(dtype=np.int64)


def check_doings(
    logs: Logs, decider: Int[np.ndarray, " rows"], does: Int[np.ndarray, "rows K 2"], free: int, num_objects: int
) -> None:
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
    num_objects
        N, the most objects that a path has.

    Raises
    ------
    LogError
        The path, the stage and the robots are named.
    """
    stages, rows = logs.stages, np.arange(len(does))
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


def check_numbers(stages: pd.DataFrame, decider: Int[np.ndarray, " rows"], num_robots: int) -> None:
    """Refuse times and counts of decisions below 0, and a robot that decides with none to go.

    Raises
    ------
    LogError
        The path, the stage and the value are named.
    """
    for r in range(num_robots):
        since_s, to_go = (stages[f"{r}_{what}"].to_numpy(dtype=np.float64) for what in ("since_s", "decisions_to_go"))
        refuse(stages, since_s < 0, _told(stages, f"{r}_since_s", "below 0; give the seconds that it has been at it"))
        wrong = (to_go < 0) | (to_go != np.floor(to_go))
        refuse(stages, wrong, _told(stages, f"{r}_decisions_to_go", "no count; give the decisions that it has left"))
        spent = (decider == r) & (to_go == 0)
        refuse(stages, spent, _told(stages, f"{r}_decisions_to_go", f"yet robot {r} decides; count this decision, too"))


def check_lists(objects: pd.DataFrame, reach: Lists, near: Lists, num_robots: int) -> None:
    """Refuse robots and objects that there are none of, in the lists reached_by and near.

    Raises
    ------
    LogError
        The path, the stage, the object and the value are named.
    """
    no_robot = reach.rows_with(_is_none_of(reach, np.full(len(objects), num_robots)))
    remedy = f"names a robot that there is none of; the stages tell of robots 0 to {num_robots - 1}"
    refuse(objects, no_robot, _told(objects, "reached_by", remedy), _ROW)
    in_stage = objects.groupby(["path", "stage"])["object"].transform("size").to_numpy()
    no_object = near.rows_with(_is_none_of(near, in_stage))
    remedy = "names an object that the stage has not; objects go by their place in it, from 0"
    refuse(objects, no_object, _told(objects, "near", remedy), _ROW)


def check_reached(logs: Logs, decider: Int[np.ndarray, " rows"], is_reached: Bool[np.ndarray, "rows N"]) -> None:
    """Refuse an action on what the robot that decides does not reach.

    Raises
    ------
    LogError
        The path, the stage, the robot and the object are named.
    """
    stages, begun = logs.stages, begun_objects(logs)
    wrong = (begun >= 0) & ~is_reached[np.arange(len(begun)), np.maximum(begun, 0)]

    def told(row: int) -> str:
        what = f"robot {decider[row]} begins with object {shown(value_at(stages, 'object', row))}"
        return f"{what}, which it does not reach by reached_by; mend one of them"

    refuse(stages, wrong, told)


def _is_none_of(lists: Lists, sizes: Int[np.ndarray, " rows"]) -> Bool[np.ndarray, " entries"]:
    values = lists.values
    return ~((values >= 0) & (values < sizes[lists.row]) & (values == np.floor(values)))


def _told(frame: pd.DataFrame, column: str, trouble: str) -> Callable[[int], str]:
    return lambda row: f"{column} is {shown(value_at(frame, column, row))}, {trouble}"
