"""Covariates that foretell the reward of their own stage far better than all that was known before it.

Of what the other covariates, the action, and the covariate itself in the stage before leave unexplained, one that was
written down after the stage explains most: it repeats the outcome. What was known before may do so, too, where rewards
have little noise. But the outcome depends on the action, and what was known before does not: with the logged
probabilities p the mean of 1{A = a} / p is the same whatever its value. Both must speak against a covariate; where a
log has no probabilities, it must foretell nearly everything.
"""

from collections.abc import Collection, Iterator
from typing import Any

import numpy as np
import pandas as pd

from halfseen.arrays import RowMask
from halfseen.logs.inspection.groups import Grouped, grouped_covariates
from halfseen.logs.inspection.probabilities import imbalance_p
from halfseen.logs.logs import Logs
from halfseen.shapes import Float

FEWEST = 100
MOST = 2000
MOST_EXPLAINED, NEARLY_ALL = 0.5, 0.95
"""Share of what is left that a covariate may explain, if it depends on the action, too; and if nobody can tell."""
LEVEL = 0.01
COMMON = 0.2
"""Mean of p from which on an action tells whether a covariate depends on it: 1/p of rare ones is too heavy-tailed."""


def outcomes_among_covariates(logs: Logs, of: Collection[str] | None = None) -> Iterator[str]:
    """Tell of covariates that repeat the outcome of their stage.

    Parameters
    ----------
    logs
        The log.
    of
        Names of covariates; None for all.
    """
    stages = logs.stages[logs.stages["reward"].notna() & logs.stages["action"].notna()]
    if len(stages) < FEWEST or not logs.stage_covariates or logs.has_objects:
        return
    stages = stages.iloc[:MOST]
    reward = stages["reward"].to_numpy(dtype=np.float64)
    if not np.ptp(reward) > 0.0:
        return
    action = pd.factorize(stages["action"].astype(str))[0]
    known = list(grouped_covariates(logs, stages))
    blocks = [_indicators(action), _indicators(stages["stage"].to_numpy())]
    blocks += [_indicators(each.group) for each in known]
    blocks += [_before(stages, each) for each in known]
    blocks += [_by(action, each.group, each.num_groups) for each in known]
    block = np.repeat(np.arange(len(blocks)), [each.shape[1] for each in blocks])
    columns = np.hstack(blocks)
    gram, pull, total = columns.T @ columns, columns.T @ reward, float(reward @ reward)

    def left(used: RowMask) -> float:
        """Variance of the reward about its regression on some columns, by the degrees of freedom that are left."""
        values, axes = np.linalg.eigh(gram[np.ix_(used, used)])
        kept = values > 1e-9 * values[-1]
        explained = ((axes[:, kept].T @ pull[used]) ** 2 / values[kept]).sum()
        return max(total - float(explained), 0.0) / max(len(reward) - int(kept.sum()), 1)

    for k, each in enumerate(known):
        if of is not None and each.name not in of:
            continue
        is_other = (block < 2 + 2 * len(known)) & (block != 2 + k)
        by_others = left(is_other)
        if by_others <= 1e-9 * np.var(reward):
            continue
        explained = 1.0 - left(is_other | (block == 2 + 2 * len(known) + k)) / by_others
        if explained > MOST_EXPLAINED and _is_after(stages, each, explained):
            yield (
                f"covariate {each.name} foretells the reward of its own stage: it explains {explained:.0%} of what all "
                "that was known before leaves open; if it was written down after the action, leave it out"
            )


def _is_after(stages: Any, each: Grouped, explained: float) -> bool:
    """Whether a covariate that foretells so much depends on the action of its stage."""
    if "probability" not in stages.columns or stages["probability"].isna().any():
        return explained > NEARLY_ALL
    probability, actions = stages["probability"].to_numpy(dtype=np.float64), stages["action"].astype(str).to_numpy()
    took = [actions == name for name in np.unique(actions)] + [probability > MOST_EXPLAINED]
    common = [rows for rows in took if rows.any() and probability[rows].mean() > COMMON]
    each_p = [imbalance_p(rows, probability, each.group, each.num_groups) for rows in common]
    return len(common) * min(each_p, default=1.0) < LEVEL


def _by(action: Any, group: Any, num_groups: int) -> Float[np.ndarray, "m k"]:
    """One column for each action and group."""
    return _indicators(action * num_groups + group)


def _indicators(code: Any) -> Float[np.ndarray, "m k"]:
    return (code[:, None] == np.unique(code)).astype(np.float64)


def _before(stages: Any, each: Grouped) -> Float[np.ndarray, "m k"]:
    """The covariate's group in the stage before; none of them in the first."""
    trajectory, group = stages["trajectory"].to_numpy(), each.group
    was = np.where(np.append(False, trajectory[1:] == trajectory[:-1]), np.append(0, group[:-1]), -1)
    return (was[:, None] == np.arange(each.num_groups)).astype(np.float64)
