"""From logs of tables to the dense arrays that the learner runs on."""

from dataclasses import replace

import numpy as np
import pandas as pd
from jaxtyping import Bool, Int

from halfseen.arrays import mapped
from halfseen.errors import LogError
from halfseen.learning.rows import stage_places
from halfseen.learning.task import Encoded
from halfseen.logs import Logs
from halfseen.logs.refusal import refuse, shown, value_at
from halfseen.tables.features import table_features
from halfseen.world.actions import FINISH, TARGETED, VERB_NAMES, WAIT, ActionSpace, possible_actions, wait_of
from halfseen.world.log_checks import begun_objects, robots_in
from halfseen.world.logs import states_of
from halfseen.world.policy import GraspModel
from halfseen.world.robot_logs import told_by
from halfseen.world.state import TableState


def encoded_states(
    states: TableState,
    action: Int[np.ndarray, "n T"],
    is_state: Bool[np.ndarray, "n T"],
    grasp: GraspModel | None = None,
) -> Encoded:
    """Encode tables, and what was done at each.

    Parameters
    ----------
    states
        Tables, axes (n, T); of more paths than n, the first are encoded.
    action
        What was done.
    is_state
        Where there is a table; elsewhere features are 0, and FINISH alone is possible.
    grasp
        What tells the probability of a grasp in the features; None for the rule of succession.
    """
    num_paths, at = len(is_state), np.nonzero(is_state)
    there = mapped(lambda leaf: leaf[:num_paths][at], states)
    features, is_possible = table_features(there, grasp), possible_actions(there)
    all_features = np.zeros((*is_state.shape, *features.shape[1:]))
    all_possible = np.zeros((*is_state.shape, is_possible.shape[1]), dtype=bool)
    all_possible[..., FINISH] = True
    all_features[at], all_possible[at] = features, is_possible
    return Encoded(all_features, all_possible, action)


def encode_tables(logs: Logs, horizon: int, grasp: GraspModel | None = None) -> Encoded:
    """Encode every stage of a log of tables.

    Parameters
    ----------
    logs
        The log.
    horizon
        T.
    grasp
        What tells the probability of a grasp in the features; None for the rule of succession.

    Raises
    ------
    LogError
        An action is none that a table knows, or is done to an object that is not on the table; several robots decided.
    """
    states = table_states(logs, horizon)
    action = logged_actions(logs, horizon, states.num_objects)
    return encoded_states(states, action, np.any(states.is_on_table, axis=-1), grasp)


def table_states(logs: Logs, horizon: int) -> TableState:
    """Rebuild S_t of every stage of a log of one robot, axes (n, T), as one that works alone.

    Raises
    ------
    LogError
        Several robots decided, or the log breaks a rule of tables.
    """
    robots = logs.stages["robot"].nunique() if "robot" in logs.stages.columns else 1
    if robots > 1:
        raise LogError(
            f"stages: the log is of {robots} robots, and one table's policy decides for one; learn it with "
            "CensoredQLearner.for_team, or the part of one robot, halfseen.tables.agent_view(logs, robot)"
        )
    return replace(states_of(logs, horizon), robots=None, workspace=None, decider=None)


def team_states(logs: Logs, horizon: int, num_robots: int | None = None) -> TableState:
    """Rebuild S_t of every stage of a log of several robots, axes (n, T).

    Parameters
    ----------
    logs
        The log.
    horizon
        T, the decisions of all robots together.
    num_robots
        K, which the log must have; None for any.

    Raises
    ------
    LogError
        It is of another number of robots, or breaks a rule of tables or of robots.
    """
    if not robots_in(logs):
        # It says which of the columns of robots are missing.
        told_by(logs, horizon)
    states = states_of(logs, horizon)
    if num_robots not in (None, states.num_robots):
        raise LogError(
            f"the log is of {states.num_robots} robots, and it is to be learned for {num_robots}; give "
            "the number of the log"
        )
    return states


def logged_actions(logs: Logs, horizon: int, num_objects: int, *, is_team: bool = False) -> Int[np.ndarray, "n T"]:
    """Action number of every stage; FINISH where the log has no stage, or no action.

    Parameters
    ----------
    logs
        The log.
    horizon
        T.
    num_objects
        N.
    is_team
        Whether several robots decided, who WAIT as well.

    Raises
    ------
    LogError
        An action is none that a table, or a team, knows.
    """
    stages, known = logs.stages, VERB_NAMES[: None if is_team else -1]
    verb = pd.Index(known).get_indexer(stages["action"])
    has_object, is_given = stages["object"].notna().to_numpy(), stages["action"].notna().to_numpy()
    has_target = is_given & np.isin(verb, TARGETED)
    wrong = is_given & ((verb < 0) | (has_target & ~has_object) | (is_team & ~has_target & has_object))

    def unknown(row: int) -> str:
        said, target = (shown(value_at(stages, column, row)) for column in ("action", "object"))
        who = "a team knows" if is_team else "a table knows"
        return f"action {said} of object {target} is none that {who}; give {_in_words(is_team)}"

    refuse(stages, wrong, unknown)
    action = np.full((logs.num_paths, horizon), FINISH, dtype=np.int64)
    codes = ActionSpace(num_objects).encode(verb, np.maximum(begun_objects(logs), 0))
    action[stage_places(logs)] = np.select([has_target, verb == WAIT], [codes, wait_of(num_objects)], FINISH)
    return action


def _in_words(is_team: bool) -> str:
    *first, last = [verb.name for verb in TARGETED]
    return f"{', '.join(first)} or {last} with an object, {'WAIT or FINISH without one' if is_team else 'or FINISH'}"
