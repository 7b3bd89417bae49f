"""A small log whose names try to break a page, the policy that was learned from it, and a value of the mind."""

import numpy as np
import pandas as pd

from halfseen.evaluation import Estimate, Evaluation
from halfseen.logs import Logs

ACTIONS = ["<b>grip</b>", "$push$ 抓取"]
COVARIATES = ["x<1>", "y_$2$"]
CAUSE = '<script>alert("cut")</script> $\\frac{$'


def hostile_log(num_paths=40, seed=0, cut_after_s=6.0):
    rng = np.random.default_rng(seed)
    stages, paths = [], []
    for path in range(num_paths):
        clock, cut_s = 0.0, rng.exponential(cut_after_s) + 0.1
        for stage in (1, 2):
            x, y = rng.normal(), rng.uniform()
            action = ACTIONS[rng.integers(2)]
            clock += rng.uniform(0.5, 2.0)
            is_seen = clock <= cut_s
            reward = (x if action == ACTIONS[0] else -x) + 0.1 * rng.normal()
            stages.append(
                {
                    "path": f"path <{path}> $^$",
                    "stage": stage,
                    "elapsed_s": clock if is_seen else None,
                    "action": action,
                    "reward": reward if is_seen else None,
                    "probability": 0.5,
                    COVARIATES[0]: x,
                    COVARIATES[1]: y,
                }
            )
            if not is_seen:
                break
        cause = None if is_seen else CAUSE
        ending = "finished" if is_seen else "cut"
        paths.append({"path": f"path <{path}> $^$", "end_s": min(clock, cut_s), "ending": ending, "cause": cause})
    return Logs(pd.DataFrame(stages), pd.DataFrame(paths))


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
    return Evaluation(**values, verdict=verdict, reason=reason, support=(0.5, 0.5), num_paths=40, level=0.95)
