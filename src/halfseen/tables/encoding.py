"""Encoding of logs of tables as dense arrays for the learner, and as covariates of cuts."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from halfseen.arrays import mapped
from halfseen.errors import ArgumentError, LogError, did_you_mean
from halfseen.learning.named_task import action_indicators
from halfseen.learning.rows import stage_places
from halfseen.learning.task import ACTION, Encoded
from halfseen.logs import Logs
from halfseen.logs.columns import refuse, shown, value_at
from halfseen.shapes import Bool, Int
from halfseen.tables.features import table_features, team_features
from halfseen.world.actions import FINISH, TARGETED, VERB_NAMES, WAIT, ActionSpace, Verb, wait_of, worthwhile_actions
from halfseen.world.log_checks import TABLE, checked_tables, robots_in
from halfseen.world.log_rows import begun_objects
from halfseen.world.logs import spread, states_of
from halfseen.world.policy import GraspModel
from halfseen.world.state import Layout, TableState

TABLE_COVARIATES = ("num_objects", "mean_occlusion", ACTION, "target_occlusion")
"""All covariates; the first two are known at the beginning of a trajectory."""
NUM_AT_BEGIN = 2
_CONTRASTED = tuple(verb.name for verb in Verb)[:-1]


def encoded_states(
    states: TableState,
    action: Int[np.ndarray, "n T"],
    is_state: Bool[np.ndarray, "n T"],
    grasp: GraspModel | None = None,
) -> Encoded:
    """Encode tables and their actions.

    States may have more trajectories than `action`; the first are encoded. Where there is no table, features are 0,
    and only FINISH is possible. `grasp` models the probability of a grasp; None for the rule of succession.
    """
    num_trajectories, at = len(is_state), np.nonzero(is_state)
    return encoded_at(at, mapped(lambda leaf: leaf[:num_trajectories][at], states), action, grasp)


def encoded_at(
    at: tuple[np.ndarray, ...],
    there: TableState,
    action: Int[np.ndarray, "n T"],
    grasp: GraspModel | None = None,
    choices: Callable[[TableState], np.ndarray] = worthwhile_actions,
) -> Encoded:
    """Encode the tables of some stages, (trajectory, stage) from 0, of one robot or several.

    `choices` returns the actions that may be chosen; without a table that is FINISH alone.
    """
    of_action = (table_features if there.robots is None else team_features)(there, grasp)
    is_possible = spread(choices(there), at, action.shape)
    is_possible[~is_possible.any(axis=-1), FINISH] = True
    return Encoded(spread(of_action.astype(np.float64), at, action.shape), is_possible, action)


def states_alone(logs: Logs, horizon: int) -> TableState:
    """Rebuild S_t of every stage of a log of one robot, axes (n, T), as states of a single robot.

    Raises
    ------
    LogError
        Several robots decided, or the log breaks a rule of tables.
    """
    robots = logs.stages["robot"].nunique() if "robot" in logs.stages.columns else 1
    if robots > 1:
        raise LogError(
            f"stages: the log has {robots} robots, but a table policy decides for one; learn with "
            "CensoredQLearner.for_team, or from the view of one robot, halfseen.tables.agent_view(logs, robot)"
        )
    return replace(states_of(logs, horizon), robots=None, workspace=None, decider=None)


def team_states(logs: Logs, horizon: int, num_robots: int | None = None) -> TableState:
    """Rebuild S_t of every stage of a log of several robots, axes (n, T).

    `horizon` is T, the decisions of all robots together. The log must have `num_robots` robots, None for any number.

    Raises
    ------
    LogError
        The log has another number of robots, or breaks a rule of tables or of robots.
    """
    check_team(logs, num_robots)
    return states_of(logs, horizon)


def check_team(logs: Logs, num_robots: int | None = None) -> None:
    """Check that a log is of a team with the given number of robots.

    Raises
    ------
    LogError
        The log is of one robot, or of another number of robots.
    """
    found = robots_in(logs)
    if not found:
        # This reports the missing columns of robots.
        checked_tables(logs, is_team=True)
    if num_robots not in (None, found):
        raise LogError(f"the log has {found} robots, but num_robots is {num_robots}; give the number of the log")


def logged_actions(logs: Logs, horizon: int, num_objects: int, *, is_team: bool = False) -> Int[np.ndarray, "n T"]:
    """Action number of every stage; FINISH where the log has no stage, or no action.

    `is_team` is True for several robots, which may also WAIT.

    Raises
    ------
    LogError
        An action is unknown to a table, or to a team.
    """
    stages, known = logs.stages, VERB_NAMES[: None if is_team else -1]
    verb = pd.Index(known).get_indexer(stages["action"])
    has_object, is_given = stages["object"].notna().to_numpy(), stages["action"].notna().to_numpy()
    has_target = is_given & np.isin(verb, TARGETED)
    wrong = is_given & ((verb < 0) | (has_target & ~has_object) | (is_team & ~has_target & has_object))

    def unknown(row: int) -> str:
        said, target = (shown(value_at(stages, column, row)) for column in ("action", "object"))
        who = "a team" if is_team else "a table"
        return f"action {said} of object {target} is unknown to {who}; give {_in_words(is_team)}"

    refuse(stages, wrong, unknown)
    action = np.full((logs.num_trajectories, horizon), FINISH, dtype=np.int64)
    codes = ActionSpace(num_objects).encode(verb, np.maximum(begun_objects(logs), 0))
    action[stage_places(logs)] = np.select([has_target, verb == WAIT], [codes, wait_of(num_objects)], FINISH)
    return action


def _in_words(is_team: bool) -> str:
    *first, last = [verb.name for verb in TARGETED]
    return f"{', '.join(first)} or {last} with an object, {'WAIT or FINISH without one' if is_team else 'or FINISH'}"


def table_covariates(logs: Logs, columns: Sequence[str]) -> pd.DataFrame:
    """Covariates of cuts at a table, one row for each stage.

    Parameters
    ----------
    logs
        A log of tables.
    columns
        Among `TABLE_COVARIATES`: ``num_objects`` and ``mean_occlusion`` of the objects on the table, ``action`` the
        verb, and ``target_occlusion`` the occlusion of its target, 0 if none.

    Raises
    ------
    ArgumentError
        A column is not among these.
    """
    unknown = [name for name in columns if name not in TABLE_COVARIATES]
    if unknown:
        known = ", ".join(TABLE_COVARIATES) + did_you_mean(unknown[0], TABLE_COVARIATES)
        raise ArgumentError(f"censoring covariate {unknown[0]!r} is not one of a table's: {known}")
    assert logs.objects is not None
    keys = ["trajectory", "stage"]
    there = logs.objects[logs.objects["location"] == TABLE]
    each = there.groupby(keys)["occlusion"]
    of_table = pd.DataFrame({"num_objects": each.size().astype(float), "mean_occlusion": each.mean()}).reset_index()
    stages = logs.stages[[*keys, "object"]]
    known = stages.merge(of_table, on=keys, how="left")
    objects: Any = logs.objects
    targets = objects[[*keys, "object", "occlusion"]].rename(columns={"occlusion": "target_occlusion"})
    known = known.merge(targets, on=[*keys, "object"], how="left").drop(columns=[*keys, "object"]).fillna(0.0)
    taken = logs.stages[ACTION]
    parts = [action_indicators(taken, _CONTRASTED) if name == ACTION else known[[name]] for name in columns]
    return pd.concat([known[[]], *parts], axis=1)


def layouts_of(states: TableState) -> Layout:
    """Initial tables of the trajectories, from states with axes (n, T)."""
    workspace = states.workspace
    if workspace is not None:
        workspace = type(workspace)(workspace.is_in_reach[:, 0], workspace.is_near[:, 0])
    return Layout(states.hides[:, 0], states.is_object[:, 0], states.grip[:, 0], workspace)
