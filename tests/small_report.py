"""A small log whose names try to break a page, the policy that was learned from it, and a value of the mind."""

import numpy as np
import pytest

from halfseen.evaluation import Estimate, Evaluation
from halfseen.logs import Logs
from halfseen.view import findings
from small_logs import flat_log

ACTIONS = ["<b>grip</b>", "$push$ 抓取"]
COVARIATES = ["x<1>", "y_$2$"]
CAUSE = '<script>alert("cut")</script> $\\frac{$'


def hostile_log(num_trajectories=40, seed=0, cut_after_s=6.0):
    logs = flat_log(num_trajectories, seed=seed, cut_after_s=cut_after_s)
    named = {"x1": COVARIATES[0], "x2": COVARIATES[1]}
    actions = dict(zip("ABC", [*ACTIONS, ACTIONS[1]], strict=True))
    stages = logs.stages.drop(columns="colour").rename(columns=named).replace({"action": actions})
    trajectories = logs.trajectories.assign(cause=np.where(logs.is_finished, None, CAUSE))
    labels = [rows["trajectory"].map("trajectory <{}> $^$".format) for rows in (stages, trajectories)]
    return Logs(stages.assign(probability=0.5, trajectory=labels[0]), trajectories.assign(trajectory=labels[1]))


def estimate(value, reach, size=40.0):
    return Estimate(value, value - reach, value + reach, reach / 2.0, size)


def evaluation(verdict="better", **changed):
    values = {
        "importance_sampling": estimate(2.0, 9.0),
        "fitted_q": estimate(1.4, 0.2),
        "doubly_robust": estimate(1.5, 0.3),
        "logging": estimate(1.0, 0.2),
        "difference": estimate(0.5, 0.25),
        **changed,
    }
    reason = "it earns <this> much"
    return Evaluation(**values, verdict=verdict, reason=reason, support=(0.5, 0.5), num_trajectories=40, level=0.95)


def found(stored, logs, num_replicates=2, seed=0, **changed):
    """Findings about a policy, with a value that was made up."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(findings, "evaluate", lambda *_, **__: evaluation(**changed))
        return findings.find(stored, logs, num_replicates=num_replicates, seed=seed)
