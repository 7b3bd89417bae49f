"""Fitted Q iteration with trees [Ernst and others, 2005], on completed stages, as if there had been no cuts.

The state is the covariates and the stage, so as many iterations as there are stages reach the fixed point.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from peers.completed import begun, possible_of
from sklearn.ensemble import ExtraTreesRegressor, HistGradientBoostingRegressor
from worlds.world import Chances, World

from halfseen.logs import Logs

REGRESSORS: dict[str, Callable[[], Any]] = {
    "boosting": lambda: HistGradientBoostingRegressor(random_state=0),
    "trees": lambda: ExtraTreesRegressor(100, min_samples_leaf=5, random_state=0),
}


def iterated(regressor: str, world: World, logs: Logs) -> Chances:
    """Learn Q by one of `REGRESSORS`."""
    rows = begun(logs, world)
    # A completed stage that is its trajectory's last one, of a trajectory that was cut just then, has an unknown
    # sequel: left out.
    is_finished = dict(zip(logs.trajectory_ids, logs.is_finished, strict=True))
    ends = rows.is_last & np.array([is_finished[trajectory] for trajectory in rows.trajectory])
    is_used = np.flatnonzero(rows.is_completed & (ends | ~rows.is_last))
    goes_on = ~ends[is_used]
    after = is_used[goes_on] + 1
    num_actions = len(world.actions)

    def inputs(state: np.ndarray, stage: np.ndarray, action: np.ndarray) -> np.ndarray:
        return np.column_stack([state, stage, np.eye(num_actions)[action]])

    def q_values(model: Any, state: np.ndarray, stage: np.ndarray) -> np.ndarray:
        each = [model.predict(inputs(state, stage, np.full(len(state), a))) for a in range(num_actions)]
        return np.where(possible_of(stage, world), np.stack(each, axis=1), -np.inf)

    used = inputs(rows.state[is_used], rows.stage[is_used], rows.action[is_used])
    target = rows.reward[is_used].copy()
    model = REGRESSORS[regressor]().fit(used, target)
    for _ in range(len(world.actions_by_stage) - 1):
        later = q_values(model, rows.state[after], rows.stage[after]).max(axis=1)
        target[goes_on] = rows.reward[is_used][goes_on] + later
        model = REGRESSORS[regressor]().fit(used, target)

    def chances(frame: pd.DataFrame, stage: int) -> np.ndarray:
        state = frame[list(world.covariates)].to_numpy(dtype=np.float64)
        return np.eye(num_actions)[q_values(model, state, np.full(len(state), stage)).argmax(axis=1)]

    return chances
