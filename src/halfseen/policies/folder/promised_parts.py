"""What a policy keeps of how its cell behaved: rewards and durations of each action, so that both are watched.

Of each action, reward and log duration are a ridge regression on the covariates, and, where there are ten stages for
each, on their products; the covariance of the coefficients is kept, and the distribution of what is left of them, the
residuals. The range of what a trajectory can bring is added up backwards over stages, as no trajectory was seen to do
better: M_t = max(most after which one had ended, M_{t+1} + most of the others). Covariates that never changed within a
trajectory, as a part's weight, are named.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from halfseen.learning.covariates import Covariates
from halfseen.learning.discrete_policy import NamedActionPolicy
from halfseen.learning.rows import stage_places
from halfseen.logs import Logs
from halfseen.policies.folder.log_facts import distribution_of
from halfseen.shapes import Bool, Float, Int

RIDGE = 1.0
"""On standardised covariates, beside as many ones as there are states."""
MOST_STATES = 200
"""First states that are kept."""
STATES_PER_TERM = 10
FEWEST = 10
"""Stages without which an action is not described."""
MOST_FEATURES = 200
"""Where there are more, as of a state that is one of many names, no action is."""
WHATS = ("reward", "duration")
DECIMALS = 9
FEWEST_STEPS = 50
"""From a stage to the next, in which something never changed."""


def promised_parts(logs: Logs, policy: Any) -> dict[str, Any]:
    """Describe how the cell of a log behaved.

    Parameters
    ----------
    logs
        The log.
    policy
        What was learned from it; of one that takes no named actions, only what a trajectory brings is described.

    Returns
    -------
    dict
        ``brings``: the least and the most that a trajectory brings; ``parts``: for each action and of ``WHATS`` its
        model; ``first_states``: states that trajectories began with, one a row, as numbers; ``unmoved``: covariates
        that never changed within a trajectory, and in how many steps.
    """
    least, most = (-_most(logs, -1.0), _most(logs, 1.0))
    if not (isinstance(policy, NamedActionPolicy) and hasattr(policy, "decide")):
        return {"brings": [least, most]}
    named: Any = policy
    looks_at = Covariates(tuple(named.covariates), named.categories)
    rows, parts = outcome_rows(logs), []
    for action, some in rows.groupby("action", observed=True, sort=True):
        if len(some) >= FEWEST and looks_at.num_features <= MOST_FEATURES:
            features = looks_at.encode(some)
            parts += [part_of(str(action), what, features, some[what].to_numpy(float)) for what in WHATS]
    first: Any = logs.stages[logs.stages["stage"] == 1]
    kept = first.iloc[np.unique(np.linspace(0, len(first) - 1, min(MOST_STATES, len(first))).astype(int))]
    states = {"first_states": looks_at.encode(kept).tolist(), "unmoved": _unmoved(logs, looks_at.columns)}
    return {"brings": [least, most], "parts": parts, **states}


def moves(logs: Logs, name: str) -> tuple[Int[np.ndarray, " m"], Bool[np.ndarray, " m"]]:
    """Of each step from a stage to the next, the place of its trajectory, and whether a covariate changed."""
    place, values = stage_places(logs)[0], logs.stages[name].to_numpy()
    is_later = place[1:] == place[:-1]
    return place[1:][is_later], np.asarray(values[1:] != values[:-1], dtype=bool)[is_later]


def _unmoved(logs: Logs, names: Sequence[str]) -> dict[str, Any]:
    has_moved = {name: moves(logs, name)[1] for name in names}
    num = min((len(each) for each in has_moved.values()), default=0)
    return {"names": [name for name, each in has_moved.items() if num >= FEWEST_STEPS and not each.any()], "num": num}


def outcome_rows(logs: Logs) -> Any:
    """Completed stages with a known action; ``duration`` is the logarithm of theirs [log s]."""
    rows: Any = logs.stages.assign(duration=np.log(np.maximum(logs.durations_s(), 1e-9)))
    return rows[rows["elapsed_s"].notna() & rows["action"].notna()].reset_index(drop=True)


def expanded(features: Float[np.ndarray, "m F"], most: int) -> Float[np.ndarray, "m P"]:
    """Add the products of each two features, unless that makes more than `most`."""
    one, other = np.triu_indices(features.shape[1])
    if len(one) + features.shape[1] > most:
        return features
    return np.concatenate([features, features[:, one] * features[:, other]], axis=1)


def expanded_as(part: Any, features: Float[np.ndarray, "m F"]) -> Float[np.ndarray, "m P"]:
    """Features as the model of a part takes them."""
    return expanded(features, len(part["coefficients"]) - 1)


def own_stages(policy: Any, rows: Any) -> Bool[np.ndarray, " m"]:
    """In which stages, rows of a log, the policy would have done the same; in none beyond its horizon."""
    is_own, stages = np.zeros(len(rows), dtype=bool), rows["stage"].to_numpy()
    for stage in np.unique(stages[stages <= policy.horizon]).tolist():
        at = np.flatnonzero(stages == stage)
        some = rows.iloc[at]
        is_own[at] = np.asarray(policy.decide(some, stage)) == some["action"].to_numpy()
    return is_own


def residuals(
    part: Any, features: Float[np.ndarray, "m F"], values: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " m"]:
    """What the model of a part leaves of values, rounded, so that equal ones stay equal."""
    coefficients, features = np.asarray(part["coefficients"]), expanded_as(part, features)
    return np.round(values - coefficients[0] - features @ coefficients[1:], DECIMALS)


def part_of(
    action: str, what: str, features: Float[np.ndarray, "m F"], values: Float[np.ndarray, " m"]
) -> dict[str, Any]:
    """Describe a part: regress values on features, and keep what is left of them, which `residuals` gives again."""
    features = expanded(features, len(features) // STATES_PER_TERM)
    mean, spread = features.mean(axis=0), features.std(axis=0)
    scale = 1.0 / np.where(spread > 0, spread, 1.0)
    scaled = (features - mean) * scale
    inverse = np.linalg.inv(scaled.T @ scaled + RIDGE * np.eye(scaled.shape[1])) * np.outer(scale, scale)
    slope = inverse @ ((features - mean).T @ (values - values.mean()))
    part = {
        "action": action,
        "what": what,
        "num_states": len(values),
        "coefficients": [float(values.mean() - mean @ slope), *slope.tolist()],
    }
    left = np.round(values - part["coefficients"][0] - features @ slope, DECIMALS)
    corner = 1.0 / len(values) + mean @ inverse @ mean
    covariance = np.block([[np.array([[corner]]), -(mean @ inverse)[None]], [-(inverse @ mean)[:, None], inverse]])
    return part | {
        "deviation": float(left.std()),
        "covariance": (float(left.var()) * covariance).tolist(),
        "residuals": distribution_of(pd.Series(left)),
    }


def _most(logs: Logs, sign: float) -> float:
    """M_1 of the rewards times a sign."""
    done: Any = logs.stages[logs.stages["reward"].notna()]
    ends = pd.Series(logs.is_finished, index=pd.Index(logs.trajectory_ids))
    is_last = ~done.duplicated("trajectory", keep="last") & done["trajectory"].map(ends).to_numpy(dtype=bool)
    reward, later = sign * done["reward"].to_numpy(dtype=np.float64), 0.0
    for stage in sorted(done["stage"].unique(), reverse=True):
        here = (done["stage"] == stage).to_numpy()
        ways = ((here & is_last.to_numpy(), 0.0), (here & ~is_last.to_numpy(), later))
        later = max((after + float(reward[which].max()) for which, after in ways if which.any()), default=later)
    return later
