"""Learners on the same trials: what their policies are worth, next to the optimum."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Int
from threadpoolctl import threadpool_limits
from tqdm import tqdm
from trial_optimum import optimum, policy_value
from trial_patients import ACTIONS, COVARIATES, HORIZON, TREATMENTS, Decision, trial

from halfseen.learning import CensoredQLearner, DoublyRobust
from halfseen.logs import Logs

CUT_SHARES = (0.0, 0.3, 0.5)


def learner(**parameters: Any) -> CensoredQLearner:
    """Make a learner of eq. 3 for this trial; all that is not said stays as in the paper."""
    return CensoredQLearner.of_paper(HORIZON, ACTIONS, COVARIATES, **parameters)


def uncut_only(logs: Logs) -> Logs:
    """Keep patients who were followed to their end, as if nobody else had entered."""
    return logs.select(logs.trajectory_ids[logs.is_finished])


# All but the default are eq. 3.
METHODS: dict[str, Callable[[Logs], CensoredQLearner]] = {
    "default": lambda logs: CensoredQLearner(HORIZON, ACTIONS, COVARIATES).fit(logs),
    "kernel": lambda logs: learner(q_function="kernel").fit(logs),
    "linear": lambda logs: learner(q_function="linear").fit(logs),
    "doubly robust": lambda logs: learner(q_function="kernel", censoring=DoublyRobust()).fit(logs),
    "uncut only": lambda logs: learner(q_function="kernel").fit(uncut_only(logs)),
}


def decision_of(fitted: CensoredQLearner) -> Decision:
    """Turn a learned policy into indices of treatments."""

    def decide(covariates: pd.DataFrame, stage: int) -> Int[np.ndarray, " m"]:
        return pd.Index(TREATMENTS).get_indexer(fitted.decide(covariates, stage))

    return decide


def compare(
    num_patients: int,
    num_trials: int,
    seed: int = 0,
    cut_shares: Sequence[float] = CUT_SHARES,
    methods: Sequence[str] = tuple(METHODS),
) -> pd.DataFrame:
    """Learn from trials with each method.

    Parameters
    ----------
    num_patients
        Of each trial.
    num_trials
        Trials; the r-th has the same patients under all shares of cuts.
    seed
        Trial r draws from `seed` + r.
    cut_shares, methods
        What is compared.

    Returns
    -------
    DataFrame
        One row a trial, share and method: ``trial``, ``cut_share``, ``method``, ``ratio`` (expected survival under the
        learned policy over the largest possible) and ``measured_share``, of patients cut.
    """
    best, _ = optimum()
    tasks = [(r, share) for r in range(num_trials) for share in cut_shares]
    rows = []
    for r, share in tqdm(tasks, desc="trials", delay=2, disable=None, leave=False):
        logs = trial(num_patients, share, seed + r)
        found = {"trial": r, "cut_share": share, "measured_share": logs.cut_share}
        for method in methods:
            # The matrices are small: more threads than one wait for one another.
            with threadpool_limits(1):
                fitted = METHODS[method](logs)
            rows.append(found | {"method": method, "ratio": policy_value(decision_of(fitted)) / best})
    return pd.DataFrame(rows)
