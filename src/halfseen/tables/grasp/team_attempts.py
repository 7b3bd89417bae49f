"""From the log of a team to its attempts to grasp, the cut ones included."""

import numpy as np
import pandas as pd
from jaxtyping import Int

from halfseen.arrays import at
from halfseen.learning.rows import stage_places
from halfseen.logs import Logs
from halfseen.tables.grasp.attempts import COLUMNS
from halfseen.world.actions import TARGETED, Verb
from halfseen.world.state import TableState, attempt_counts, occlusion


def team_attempts(
    logs: Logs, states: TableState, verb: Int[np.ndarray, "n T"], target: Int[np.ndarray, "n T"]
) -> pd.DataFrame:
    """List every attempt to WASH or LIFT whose end, or cut, was seen, and the robot that made it.

    The rest is as `halfseen.tables.grasp.attempts` has it. An attempt of a robot lasts until that robot is free. Those
    of a robot's last decision are left out, as nobody wrote down what became of most of them; that depends on the
    number of the decision alone.

    Parameters
    ----------
    logs
        Of a team.
    states
        S_t of its stages.
    verb, target
        What was begun in each.
    """
    robots, decider = states.robots, states.decider
    assert robots is not None
    assert decider is not None
    hidden_share, (successes, failures) = occlusion(states), attempt_counts(states)
    is_stage = np.zeros(verb.shape, dtype=bool)
    is_stage[stage_places(logs)] = True
    begun_s = _begun_s(logs, verb.shape)
    last_of_robot = at(robots.decisions_to_go, decider) <= 1
    path, stage = np.nonzero(is_stage & np.isin(verb, TARGETED) & ~last_of_robot)
    robot, tried_at = decider[path, stage], target[path, stage]
    # The first later stage in which this robot is free.
    later = np.arange(verb.shape[1]) > stage[:, None]
    is_free = later & is_stage[path] & ~robots.is_busy[path, :, robot]
    was_seen, end = is_free.any(axis=1), is_free.argmax(axis=1)
    gained = successes[path, end, tried_at] - successes[path, stage, tried_at]
    # A robot that drops out abandons what it is at: that attempt was cut.
    is_out = np.zeros_like(was_seen) if robots.is_out is None else robots.is_out[path, end, robot]
    was_dropped = was_seen & is_out
    was_seen &= ~is_out
    # A table that is clear ends a path while a WASH is under way, and no other end does.
    is_clear = ~was_seen & ~was_dropped & logs.is_finished[path] & (verb[path, stage] == Verb.WASH)
    is_finished = was_seen | is_clear
    succeeded = pd.Series(np.where(was_seen, gained > 0, is_clear), dtype="boolean").mask(pd.Series(~is_finished))
    end_s = np.where(was_seen, begun_s[path, end], logs.end_s[path])
    end_s = np.where(was_dropped, _out_s(logs, robots.num_robots)[path, robot], end_s)
    number = path * target.max(initial=0) + path + tried_at
    columns = (
        logs.path_ids[path],
        stage + 1,
        pd.factorize(number)[0],
        hidden_share[path, stage, tried_at].astype(np.float64),
        states.grip[path, stage, tried_at].astype(np.float64),
        successes[path, stage, tried_at],
        failures[path, stage, tried_at],
        succeeded,
        end_s - begun_s[path, stage],
        is_finished,
    )
    tried = pd.DataFrame(dict(zip(COLUMNS, columns, strict=True))).assign(robot=robot)
    return pd.DataFrame(tried[tried["time_s"] > 0]).reset_index(drop=True)


def _out_s(logs: Logs, num_robots: int) -> np.ndarray:
    """When each robot dropped out of each path; NaN where it did not [s]."""
    names = [f"{robot}_out_s" for robot in range(num_robots)]
    found = logs.paths.reindex(columns=names)
    return found.to_numpy(dtype=np.float64, na_value=np.nan)


def _begun_s(logs: Logs, shape: tuple[int, ...]) -> np.ndarray:
    """Clock as each stage began [s]."""
    elapsed_s = np.zeros(shape)
    elapsed_s[stage_places(logs)] = logs.stages["elapsed_s"].to_numpy(dtype=np.float64, na_value=np.nan)
    return np.pad(elapsed_s[:, :-1], ((0, 0), (1, 0)))
