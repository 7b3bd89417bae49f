"""Learners on the same logs of the cell: what their policies are worth, next to the optimum and to plain rules."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from cell_optimum import policy_value
from cell_parts import ACTIONS, ACTIONS_ALL, COVARIATES, HORIZON, Decision
from cell_trajectories import simulate
from jaxtyping import Int
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from halfseen.censoring import Cox
from halfseen.learning import CensoredQLearner, DoublyRobust, Weighted
from halfseen.logs import Logs


def default_learner() -> CensoredQLearner:
    """Make the learner that takes what it takes by default."""
    return CensoredQLearner(HORIZON, ACTIONS, COVARIATES)


def learner(**parameters: Any) -> CensoredQLearner:
    """Make a learner of eq. 3 for this cell; all that is not said stays as in the paper.

    Nothing in the cell depends on the stage, so stages are pooled: few trajectories have a third one. On five other
    logs pooled stages with a linear Q earned more than separate ones, and more than a kernel.
    """
    return CensoredQLearner.of_paper(HORIZON, ACTIONS, COVARIATES, stages="pooled", **parameters)


# The right model of the cuts: hazards on the gap-time scale, given clutter and action. A stage that stops the cell is
# short and hardly ever cut; where a draw of the log has no such cut, the coefficient of that action would have no end
# without a ridge.
BY_COX, ROBUST_BY_COX = (targets(Cox(ridge=1.0), by="pooled") for targets in (Weighted, DoublyRobust))


def uncut_only(logs: Logs) -> Logs:
    """Keep trajectories that came to their own end, as if there were no others."""
    return logs.select(logs.trajectory_ids[logs.is_finished])


# All but the default are eq. 3.
METHODS: dict[str, Callable[[Logs], CensoredQLearner]] = {
    "default": lambda logs: default_learner().fit(logs),
    "Cox": lambda logs: learner(censoring=BY_COX).fit(logs),
    "Cox, doubly robust": lambda logs: learner(censoring=ROBUST_BY_COX).fit(logs),
    "Kaplan–Meier": lambda logs: learner().fit(logs),
    "uncut only": lambda logs: learner().fit(uncut_only(logs)),
}


def decision_of(fitted: CensoredQLearner) -> Decision:
    """Turn a learned policy into indices of actions."""

    def decide(covariates: pd.DataFrame, stage: int) -> Int[np.ndarray, " m"]:
        return pd.Index(ACTIONS_ALL).get_indexer(fitted.decide(covariates, stage)).astype(np.int64)

    return decide


def compare(
    num_trajectories: int, num_logs: int, seed: int = 0, methods: Sequence[str] = tuple(METHODS)
) -> pd.DataFrame:
    """Learn from logs with each method.

    Parameters
    ----------
    num_trajectories
        Of each log.
    num_logs
        Logs; all methods learn from the same.
    seed
        Log r draws from `seed` + r.
    methods
        What is compared.

    Returns
    -------
    DataFrame
        One row a log and method: ``log``, ``method``, ``value`` (expected reward of a trajectory under the learned
        policy) and ``cut_share``.
    """
    rows = []
    for r in tqdm(range(num_logs), desc="logs", delay=2, disable=None, leave=False):
        logs = simulate(num_trajectories, seed + r)
        for method in methods:
            # The matrices are small: more threads than one wait for one another.
            with threadpool_limits(1):
                fitted = METHODS[method](logs)
            value = policy_value(decision_of(fitted))
            rows.append({"log": r, "method": method, "value": value, "cut_share": logs.cut_share})
    return pd.DataFrame(rows)
