"""What a policy looks at, and what it would do in the states of a log where another one decided."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd

from halfseen.evaluation.specification import task_of
from halfseen.learning import CensoredQLearner
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.learning.resampling import bootstrap
from halfseen.learning.targets import CENSORING_CHOICES
from halfseen.learning.task import Task
from halfseen.logs import Logs
from halfseen.policies.decision import reach
from halfseen.policies.folder import StoredPolicy, q_space_of_record
from halfseen.policies.folder.specification import reg_of_record, targets_of_record
from halfseen.policies.shares import action_shares
from halfseen.shapes import Float
from halfseen.workers import ALONE, Workers

MOST_STAGES, MOST_COVARIATES = 3, 4
FEWEST_STATES = 10  # a stage of fewer has no curves and no map
NUM_POINTS = 41
MIDDLE = (0.05, 0.95)  # Q is shown between these quantiles of a covariate: beyond, it rests on few states
SAME_COEFFICIENTS = 1e-6
BAND_LEVEL = 0.95
Band = Literal["bootstrap", "regression"]
"""What bands around Q are: what is learned from resampled trajectories, or by standard errors in its folder."""


def choices(stored: StoredPolicy, task: Task, logs: Logs) -> list[dict[str, Any]]:
    """Tell for each stage of a log what was done there, and what the policy would do in the same states.

    Returns
    -------
    list of dict
        stage, num_states; as_logged, the proportion of the states with a known action in which the policy takes that
        one (None without such states); policy and logged, for each action its proportion.
    """
    frame: Any = logs.stages[["stage", "action"]].dropna().astype({"action": str})
    logged = {stage: names.value_counts(normalize=True) for stage, names in frame.groupby("stage")["action"]}
    return [
        {
            "stage": int(stage),
            "num_states": int(row["num_states"]),
            "as_logged": None if np.isnan(row["as_logged"]) else float(row["as_logged"]),
            "policy": dict(row["shares"]),
            "logged": {
                name: float(logged[stage].get(name, 0.0)) if stage in logged else None for name in row["shares"]
            },
        }
        for stage, row in action_shares(stored.policy, task, [logs]).to_dict("index").items()
    ]


def middle_of(policy: DiscretePolicy, states: pd.DataFrame) -> dict[str, Any]:
    """Median of each covariate of numbers, and the commonest category of each of text, the first of those equal."""
    return {
        name: states[name].astype(str).mode()[0] if name in policy.categories else float(states[name].median())
        for name in policy.covariates
    }


@dataclass(frozen=True, eq=False)
class QCurve:
    """Q of the actions of one stage along one covariate of numbers; others at their medians or commonest categories.

    `q` is Q of each possible action at the values of a covariate; `low` and `high` are 95 % bands around it, where
    there are any: the central 95 % of what it is when trajectories are resampled (bootstrap), or those of the errors of
    the regression, as `halfseen.policies.decision` has them.
    """

    stage: int
    covariate: str
    values: Float[np.ndarray, " k"]
    q: dict[str, Float[np.ndarray, " k"]]
    low: dict[str, Float[np.ndarray, " k"]] | None
    high: dict[str, Float[np.ndarray, " k"]] | None

    @property
    def sway(self) -> float:
        """How far the covariate moves the actions against one another."""
        q = np.array(list(self.q.values()))
        return float(np.ptp(q - q.mean(axis=0), axis=1).max())


def q_curves(
    stored: StoredPolicy,
    logs: Logs,
    num_replicates: int,
    seed: int,
    *,
    is_own_log: bool = True,
    workers: Workers = ALONE,
) -> tuple[list[QCurve], Band | None]:
    """Follow Q of named actions along every covariate of numbers that varies, in the first stages; none for tables.

    Parameters
    ----------
    is_own_log
        Whether the policy may have been learned from this very log, so that resampling it tells of its errors.

    Returns
    -------
    curves : list of QCurve
    band
        What their bands are; None where there are none.
    """
    policy = stored.policy
    if not isinstance(policy, DiscretePolicy):
        return [], None
    frame: Any = logs.stages
    states = {stage: frame[frame["stage"] == stage] for stage in range(1, min(MOST_STAGES, logs.horizon) + 1)}
    states = {stage: rows for stage, rows in states.items() if len(rows) >= FEWEST_STATES}
    numeric = [name for name in policy.covariates if name not in policy.categories]
    names = [name for name in numeric if all(np.ptp(_ends(rows[name])) > 0 for rows in states.values())]
    if not states or not names:
        return [], None
    replicates = _replicates(stored, logs, num_replicates, seed, workers) if is_own_log else None
    band: Band | None = "bootstrap" if replicates is not None else "regression" if stored.q_error else None
    return [_curve(stored, replicates, rows, stage, name) for stage, rows in states.items() for name in names], band


def telling(curves: list[QCurve]) -> list[str]:
    """Covariates by how far they move the actions against one another, the farthest first."""
    sway = dict.fromkeys((curve.covariate for curve in curves), 0.0)
    for curve in curves:
        sway[curve.covariate] += curve.sway
    return sorted(sway, key=lambda name: -sway[name])


def _ends(values: Any) -> Float[np.ndarray, " 2"]:
    """Between which Q is shown."""
    return np.quantile(values.astype(float), MIDDLE)


def _curve(stored: StoredPolicy, replicates: Any, states: pd.DataFrame, stage: int, covariate: str) -> QCurve:
    policy = stored.policy
    low, high = _ends(states[covariate])
    values = np.linspace(low, high, NUM_POINTS)
    at = pd.DataFrame(middle_of(policy, states), index=range(NUM_POINTS)).assign(**{covariate: values})
    bands = _regression_bands(stored, at, stage) if replicates is None else replicates.q_interval(at, stage, BAND_LEVEL)

    def by_name(q: Float[np.ndarray, "k A"]) -> dict[str, Float[np.ndarray, " k"]]:
        return {str(policy.actions[k]): q[:, k] for k in np.flatnonzero(policy.is_possible[stage - 1])}

    known = [None, None] if bands is None else [by_name(band) for band in bands]
    return QCurve(stage, covariate, values, by_name(policy.q_values(at, stage)), *known)


def _regression_bands(
    stored: StoredPolicy, at: pd.DataFrame, stage: int
) -> tuple[Float[np.ndarray, "k A"], Float[np.ndarray, "k A"]] | None:
    """The intervals of `halfseen act`, from the margin in the policy's folder; None where it has none."""
    known, policy = stored.q_error, stored.policy
    if known is None:
        return None
    q = policy.q_values(at, stage)
    error = (q - policy.lower_bounds(at, stage)) / known.pessimism
    half = reach(error, known.stages_from(stage, policy.horizon), known.lasting)
    return q - half, q + half


def _replicates(stored: StoredPolicy, logs: Logs, num_replicates: int, seed: int, workers: Workers) -> Any:
    """Learn again from trajectories resampled (bootstrap); None where this log does not give this policy."""
    learned, policy = stored.record["learner"], stored.policy
    if learned.get("censoring") not in CENSORING_CHOICES:
        return None
    learner = CensoredQLearner(
        policy.horizon,
        task_of(policy, logs),
        censoring=targets_of_record(learned),
        q_function=q_space_of_record(learned),
        reg=reg_of_record(learned),
        stages=learned["stages"],
        pessimism=learned.get("pessimism") or 0.0,
        random_state=learned.get("random_state") or 0,
    ).fit(logs)
    again, ours = (np.asarray(each.coefficients) for each in (learner.policy_, policy))
    scale = max(1.0, float(np.abs(ours).max()))
    if again.shape != ours.shape or np.abs(again - ours).max() > SAME_COEFFICIENTS * scale:
        return None
    return bootstrap(learner, logs, num_replicates, seed, workers=workers)
