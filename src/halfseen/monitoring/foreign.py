"""What a log holds that the policy in service does not know, in words.

Where a category stands that the log never showed, the policy steps back. No model says anything of such a state, so
that nothing is held against one there; how often it comes is watched as that of any other category.
"""

from typing import Any

import numpy as np

from halfseen.learning.covariates import Covariates
from halfseen.logs import Logs
from halfseen.shapes import Bool
from halfseen.wording import counted


def has_known_states(looks_at: Covariates, logs: Logs) -> Bool[np.ndarray, " n"]:
    """Which trajectories show no category but those that are known."""
    strange: Any = logs.stages.loc[~looks_at.knows(logs.stages), "trajectory"]
    return ~np.isin(logs.trajectory_ids, strange.to_numpy())


def unknown_categories(looks_at: Covariates, logs: Logs) -> tuple[str, ...]:
    """Name each category that the log never showed, and how often it is there."""
    found = []
    for name in looks_at.columns:
        if name not in looks_at.categories:
            continue
        values: Any = logs.stages[name].astype(object).map(str)
        counts = values[~values.isin(looks_at.categories[name])].value_counts()
        found += [
            f"Covariate {name} is {category!r} in {counted(int(count), 'stage')}, which the log that was learned from "
            "never showed: the policy steps back there, and such trajectories say nothing of what it earns."
            for category, count in counts.items()
        ]
    return tuple(found)
