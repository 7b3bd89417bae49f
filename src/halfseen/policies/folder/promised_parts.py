"""How the cell of a log behaved: rewards and durations of each action, kept in the policy for later monitoring.

For each action, reward and log duration are each a ridge regression on the covariates and, with ten stages for each, on
their products. The covariance of the coefficients and the distribution of the residuals are kept. The range of a
trajectory's return is bounded by backward recursion over stages, as no trajectory was seen to do better:
M_t = max(largest reward of a trajectory's last stage, M_{t+1} + largest reward of other stages). Covariates that never
changed within a trajectory, such as a part's weight, are listed.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from halfseen.learning.behaviour import mean_and_scale
from halfseen.learning.covariates import Covariates
from halfseen.learning.discrete_policy import NamedActionPolicy
from halfseen.learning.rows import stage_places
from halfseen.logs import Logs
from halfseen.shapes import Bool, Float, Int

NUM_KNOTS = 21
"""Largest number of knots of a distribution function."""
RIDGE = 1.0
"""Ridge penalty on standardised covariates, whose sums of squares are the number of states."""
MOST_STATES = 400
"""Largest number of first states that are kept."""
STATES_PER_TERM = 10
FEWEST = 10
"""Fewest stages for which an action is described."""
MOST_FEATURES = 200
"""No action is described with more features, as of a state with a covariate of many names."""
WHATS = ("reward", "duration")
DECIMALS = 9
FEWEST_STEPS = 50
"""Fewest steps between stages for a covariate to count as never changing."""


def promised_states(logs: Logs, covariates: Sequence[str]) -> list[dict[str, Any]]:
    """Describe the covariates of each stage of a log: numbers by a distribution function, names by their shares.

    A server of the policy compares its cell with them.

    Parameters
    ----------
    logs
        The log.
    covariates
        Columns that the policy looks at.

    Returns
    -------
    list of dict
        For each stage its number, the number of states, and by covariate ``values`` with the share of states ``below``
        or at each, or ``names`` with their ``shares``.
    """
    groups: Any = logs.stages.groupby("stage")
    return [
        {
            "stage": int(number),
            "num_states": len(rows),
            "covariates": {name: distribution_of(rows[name]) for name in covariates},
        }
        for number, rows in groups
    ]


def distribution_of(values: Any) -> dict[str, list[Any]]:
    """Describe a column: numbers by a distribution function, names by their shares."""
    if pd.api.types.is_numeric_dtype(values.dtype):
        numbers = np.sort(values.to_numpy(dtype=np.float64))
        knots = np.unique(np.quantile(numbers, np.linspace(0.0, 1.0, NUM_KNOTS), method="lower"))
        return {"values": knots.tolist(), "below": below(numbers, knots).tolist()}
    shares = values.astype(str).value_counts(normalize=True).sort_index()
    return {"names": shares.index.tolist(), "shares": shares.tolist()}


def below(sorted_numbers: Float[np.ndarray, " n"], knots: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Share of the sorted numbers that lie at or below each knot."""
    return np.searchsorted(sorted_numbers, knots, side="right") / len(sorted_numbers)


def comparable(knots: Sequence[float], values: Any) -> tuple[np.ndarray, np.ndarray]:
    """Knots and numbers, in single precision if either may be, since 0.1 is then more than the 0.1 of doubles."""
    places = np.asarray(knots, dtype=np.float64)
    with np.errstate(over="ignore"):
        is_single = values.dtype == np.float32 or bool((places.astype(np.float32) == places).all())
        kind = np.float32 if is_single else np.float64
        return places.astype(kind), values.to_numpy(dtype=np.float64).astype(kind)


def promised_parts(logs: Logs, policy: Any) -> dict[str, Any]:
    """Describe how the cell of a log behaved.

    Parameters
    ----------
    logs
        The log.
    policy
        The learned policy; for one without named actions, only the range of a trajectory's return is described.

    Returns
    -------
    dict
        ``brings``: the range of a trajectory's return; ``parts``: the model of each action and each of ``WHATS``;
        ``first_states``: states at the beginning of trajectories, one a row, as numbers; ``unmoved``: covariates that
        never changed within a trajectory, and in how many steps.
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
    """For each step from a stage to the next, the index of its trajectory, and whether a covariate changed."""
    place, values = stage_places(logs)[0], logs.stages[name].to_numpy()
    is_later = place[1:] == place[:-1]
    return place[1:][is_later], np.asarray(values[1:] != values[:-1], dtype=bool)[is_later]


def _unmoved(logs: Logs, names: Sequence[str]) -> dict[str, Any]:
    has_moved = {name: moves(logs, name)[1] for name in names}
    num = min((len(each) for each in has_moved.values()), default=0)
    return {"names": [name for name, each in has_moved.items() if num >= FEWEST_STEPS and not each.any()], "num": num}


def outcome_rows(logs: Logs) -> Any:
    """Completed stages with a known action; ``duration`` is its logarithm [log s]."""
    rows: Any = logs.stages.assign(duration=np.log(np.maximum(logs.durations_s(), 1e-9)))
    return rows[rows["elapsed_s"].notna() & rows["action"].notna()].reset_index(drop=True)


def expanded(features: Float[np.ndarray, "m F"], most: int) -> Float[np.ndarray, "m P"]:
    """Append the products of all pairs of features, unless that makes more than `most`."""
    one, other = np.triu_indices(features.shape[1])
    if len(one) + features.shape[1] > most:
        return features
    return np.concatenate([features, features[:, one] * features[:, other]], axis=1)


def expanded_as(part: Any, features: Float[np.ndarray, "m F"]) -> Float[np.ndarray, "m P"]:
    """Features in the form that the model of a part takes."""
    return expanded(features, len(part["coefficients"]) - 1)


def residuals(
    part: Any, features: Float[np.ndarray, "m F"], values: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " m"]:
    """Residuals of the model of a part, rounded, so that equal ones stay equal."""
    coefficients, features = np.asarray(part["coefficients"]), expanded_as(part, features)
    return np.round(values - coefficients[0] - features @ coefficients[1:], DECIMALS)


def part_of(
    action: str, what: str, features: Float[np.ndarray, "m F"], values: Float[np.ndarray, " m"]
) -> dict[str, Any]:
    """Describe a part: regress values on features, and keep the distribution of the `residuals`."""
    features = expanded(features, len(features) // STATES_PER_TERM)
    mean, spread = mean_and_scale(features)
    scale = 1.0 / spread
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
