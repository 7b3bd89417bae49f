"""What a learner of a team reads of its log: the state of every stage, and what was begun in it."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Int

from halfseen.errors import LogError
from halfseen.learning.path_arrays import stage_places
from halfseen.logs import Logs
from halfseen.logs.refusal import refuse, shown, value_at
from halfseen.team.actions import WAIT, wait_of
from halfseen.team.log_checks import begun_objects
from halfseen.team.recording import TEAM_VERBS, states_of
from halfseen.team.state import TeamState
from halfseen.world.action_space import TARGETED, ActionSpace

_VERBS_IN_WORDS = "WASH or LIFT with an object, WAIT or FINISH without one"


class ReadLog(NamedTuple):
    """States of a log, and what was begun in each; n paths of T stages."""

    states: TeamState
    verb: Int[np.ndarray, "n T"]
    target: Int[np.ndarray, "n T"]
    action: Int[np.ndarray, "n T"]


def read_log(logs: Logs, horizon: int, num_robots: int | None = None) -> ReadLog:
    """Read a log of a team.

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
        It is of another number of robots, or an action is none of a team's.
    """
    states, at = states_of(logs, horizon), stage_places(logs)
    if num_robots not in (None, states.robots.num_robots):
        raise LogError(
            f"the log is of {states.robots.num_robots} robots, and it is to be learned for {num_robots}; give "
            "the number of the log"
        )
    space = ActionSpace(states.table.num_objects)
    action = np.zeros((logs.num_paths, horizon), dtype=np.int64)
    action[at] = _actions(logs, space)
    return ReadLog(states, np.asarray(space.verb(action)), np.asarray(space.target(action)), action)


def _actions(logs: Logs, space: ActionSpace) -> Int[np.ndarray, " rows"]:
    stages = logs.stages
    verbs = pd.Index(TEAM_VERBS).get_indexer(stages["action"])
    has_object, is_given = stages["object"].notna().to_numpy(), stages["action"].notna().to_numpy()
    wrong = is_given & ((verbs < 0) | (np.isin(verbs, TARGETED) != has_object))

    def unknown(row: int) -> str:
        verb, target = (shown(value_at(stages, column, row)) for column in ("action", "object"))
        return f"action {verb} of object {target} is none that a team knows; give {_VERBS_IN_WORDS}"

    refuse(stages, wrong, unknown)
    target = np.maximum(begun_objects(logs), 0)
    codes = space.encode(np.maximum(verbs, 0), target)
    return np.select([np.isin(verbs, TARGETED), verbs == WAIT], [codes, wait_of(space.num_objects)], 0)
