"""The actions of a policy in the states of a log that another policy made, Q along covariates, and maps of actions.

Maps are over two covariates, or of objects, and mark where the log has states.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd
from scipy.spatial import KDTree

from halfseen.arrays import expit
from halfseen.evaluation.specification import task_of
from halfseen.learning import CensoredQLearner
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.learning.resampling import bootstrap
from halfseen.learning.rows import stage_places
from halfseen.learning.targets import CENSORING_CHOICES
from halfseen.learning.task import Task
from halfseen.logs import Logs
from halfseen.policies.decision import reach
from halfseen.policies.folder import StoredPolicy, q_space_of_record, reg_of_record, targets_of_record
from halfseen.policies.shares import action_shares, horizon_of
from halfseen.shapes import Bool, Float, Int
from halfseen.workers import ALONE, Workers
from halfseen.world.actions import TARGETED, ActionSpace

MOST_STAGES, MOST_COVARIATES = 3, 4
FEWEST_STATES, NUM_POINTS = 10, 41  # a stage with fewer states has no curves and no map
MIDDLE = (0.05, 0.95)  # Q is shown between these quantiles of a covariate: beyond, it rests on few states
SAME_COEFFICIENTS, BAND_LEVEL = 1e-6, 0.95
Band = Literal["bootstrap", "regression"]
"""Source of bands around Q: learning from resampled trajectories, or the standard errors in the policy's folder."""


def choices(policy: Any, task: Task, logs: Logs) -> list[dict[str, Any]]:
    """Describe, for each stage of a log, the logged actions and those of the policy in the same states.

    Returns
    -------
    list of dict
        stage, num_states; as_logged, the proportion of states with a known action in which the policy takes that action
        (None without such states); policy and logged, the proportion of each action.
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
        for stage, row in action_shares(policy, task, [logs]).to_dict("index").items()
    ]


def middle_of(policy: DiscretePolicy, states: pd.DataFrame) -> dict[str, Any]:
    """Median of each numeric covariate, and most frequent category of each text covariate, the first of those tied."""
    return {
        name: states[name].astype(str).mode()[0] if name in policy.categories else float(states[name].median())
        for name in policy.covariates
    }


@dataclass(frozen=True, eq=False)
class QCurve:
    """Q of the actions of one stage along one numeric covariate, with the others at their medians or modes.

    `q` is Q of each possible action at the values of the covariate. `low` and `high` are 95 % bands around it, if there
    are any: from resampled trajectories (bootstrap), the central 95 % of Q; or from the errors of the regression, as in
    `halfseen.policies.decision`. `taken` names the policy's action at each value.
    """

    stage: int
    covariate: str
    values: Float[np.ndarray, " k"]
    q: dict[str, Float[np.ndarray, " k"]]
    low: dict[str, Float[np.ndarray, " k"]] | None
    high: dict[str, Float[np.ndarray, " k"]] | None
    taken: np.ndarray

    @property
    def sway(self) -> float:
        """How much the covariate changes the actions' values relative to one another."""
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
    """Compute Q of named actions along every numeric covariate that varies, in the first stages; none for tables.

    Parameters
    ----------
    is_own_log
        Whether the policy may have been learned from this very log, so that resampling it shows its errors.

    Returns
    -------
    curves : list of QCurve
    band
        Kind of their bands; None if there are none.
    """
    policy = stored.policy
    if not isinstance(policy, DiscretePolicy):
        return [], None
    states = _first_states(policy, logs)
    numeric = [name for name in policy.covariates if name not in policy.categories]
    names = [name for name in numeric if all(np.ptp(_ends(rows[name])) > 0 for rows in states.values())]
    if not states or not names:
        return [], None
    replicates = _replicates(stored, logs, num_replicates, seed, workers) if is_own_log else None
    band: Band | None = "bootstrap" if replicates is not None else "regression" if stored.q_error else None
    return [_curve(stored, replicates, rows, stage, name) for stage, rows in states.items() for name in names], band


def _first_states(policy: DiscretePolicy, logs: Logs) -> dict[int, Any]:
    """States of each of the first stages that has enough of them."""
    frame: Any = logs.stages
    stages = range(1, min(MOST_STAGES, logs.horizon, policy.horizon) + 1)
    states = {stage: frame[frame["stage"] == stage] for stage in stages}
    return {stage: rows for stage, rows in states.items() if len(rows) >= FEWEST_STATES}


def informative(curves: list[QCurve]) -> list[str]:
    """Covariates by how much they change the actions' values relative to one another, the most influential first."""
    sway = dict.fromkeys((curve.covariate for curve in curves), 0.0)
    for curve in curves:
        sway[curve.covariate] += curve.sway
    return sorted(sway, key=lambda name: -sway[name])


def _ends(values: Any) -> Float[np.ndarray, " 2"]:
    """Ends of the range in which Q is shown."""
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
    taken = policy.decide(at, stage).astype(str)
    return QCurve(stage, covariate, values, by_name(policy.q_values(at, stage)), *known, taken=taken)


def _regression_bands(
    stored: StoredPolicy, at: pd.DataFrame, stage: int
) -> tuple[Float[np.ndarray, "k A"], Float[np.ndarray, "k A"]] | None:
    """The intervals of `halfseen act`, from the margin in the policy's folder; None without one."""
    known, policy = stored.q_error, stored.policy
    if known is None:
        return None
    q = policy.q_values(at, stage)
    error = (q - policy.lower_bounds(at, stage)) / known.pessimism
    half = reach(error, known.stages_from(stage, policy.horizon), known.lasting)
    return q - half, q + half


def _replicates(stored: StoredPolicy, logs: Logs, num_replicates: int, seed: int, workers: Workers) -> Any:
    """Learn again from resampled trajectories (bootstrap); None if this log does not reproduce the policy."""
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


NUM_CELLS, NUM_TABLE_CELLS = 90, 10  # along each axis: of a map of states, and of one of objects
SHOWN = (0.01, 0.99)  # a map extends between these quantiles of a covariate
NEAR, FEWEST_NEAR = 0.5, 5
"""A place has support if at least this many logged states lie within this distance, in standard deviations."""
LEAST_SUPPORTED = 0.05  # a map with a smaller supported fraction is not drawn
MOST_DOTS = 300
FEWEST_OBJECTS = 20  # a cell with fewer objects is not coloured
NEEDED = {"location", "log_odds", "occlusion"}
ON_TABLE = "TABLE"


@dataclass(frozen=True, eq=False)
class PolicyMap:
    """A policy's actions in one stage over one or two covariates; the others are fixed at the `middle`.

    `taken` names the action at each place, up by across (`up` is None for a strip), and `is_supported` marks places
    with enough states in the log. `dots` are covariates of logged states, evenly spaced ones if there are many, and
    `done` are their logged actions.
    """

    stage: int
    covariates: tuple[str, ...]
    across: Float[np.ndarray, " k"]
    up: Float[np.ndarray, " j"] | None
    taken: np.ndarray
    is_supported: Bool[np.ndarray, "j k"]
    dots: Float[np.ndarray, "m d"]
    done: np.ndarray
    middle: dict[str, str]

    @property
    def names(self) -> list[str]:
        """Names of all actions in `taken` and `done`."""
        return list(dict.fromkeys([*map(str, np.unique(self.taken)), *map(str, self.done)]))


def policy_maps(policy: DiscretePolicy, logs: Logs, informative: list[str]) -> list[PolicyMap]:
    """Compute the maps of the first stages.

    Parameters
    ----------
    informative
        Numeric covariates, the most influential first.
    """
    maps = [_map_of(policy, states, stage, informative) for stage, states in _first_states(policy, logs).items()]
    return [one for one in maps if one is not None and one.is_supported.mean() >= LEAST_SUPPORTED]


def _map_of(policy: DiscretePolicy, states: pd.DataFrame, stage: int, informative: list[str]) -> PolicyMap | None:
    names = tuple([name for name in informative if states[name].nunique() > 1][:2])
    if not names:
        return None
    values = states[list(names)].to_numpy(dtype=np.float64)
    low, high = np.quantile(values, SHOWN, axis=0)
    if (low == high).any():
        return None
    axes = [np.linspace(*ends, NUM_CELLS) for ends in zip(low, high, strict=True)]
    across, up = axes[0], axes[1] if len(names) == 2 else None
    grid = np.stack([each.ravel() for each in np.meshgrid(*axes)], axis=1)
    middle = middle_of(policy, states)
    at = pd.DataFrame(middle, index=range(len(grid))).assign(**dict(zip(names, grid.T, strict=True)))
    dots: Any = states[states["action"].notna().to_numpy()]
    if len(dots) > MOST_DOTS:
        dots = dots.iloc[((np.arange(MOST_DOTS) + 0.5) * len(dots) / MOST_DOTS).astype(int)]
    return PolicyMap(
        stage=stage,
        covariates=names,
        across=across,
        up=up,
        taken=policy.decide(at, stage).astype(str).reshape(-1, len(across)),
        is_supported=supported(grid, values).reshape(-1, len(across)),
        dots=dots[list(names)].to_numpy(dtype=np.float64),
        done=dots["action"].astype(str).to_numpy(dtype=object),
        middle={
            name: f"{value:.3g}".replace("-", "−") if isinstance(value, float) else str(value)
            for name, value in middle.items()
            if name not in names
        },
    )


def supported(places: Float[np.ndarray, "k d"], states: Float[np.ndarray, "n d"]) -> Bool[np.ndarray, " k"]:
    """Whether enough logged states lie near each place, each covariate in its standard deviations."""
    scale = states.std(axis=0)
    rows = pd.DataFrame(states / scale)
    # A tree is slow with many equal points, of which enough suffice.
    nearest: Any = KDTree(rows.groupby(list(rows)).head(FEWEST_NEAR))
    distance, _ = nearest.query(places / scale, k=[FEWEST_NEAR])
    return distance[:, 0] <= NEAR


@dataclass(frozen=True, eq=False)
class TableMap:
    """The objects on the tables of a log, by probability of being dirty and by hidden share.

    Cells have edges in both; an object counts once in every state. `share` is, by verb, the proportion of objects to
    which the policy would apply it next; NaN for too few objects.
    """

    chance_edges: Float[np.ndarray, " c"]
    hidden_edges: Float[np.ndarray, " h"]
    num_objects: Int[np.ndarray, "H C"]
    share: dict[str, Float[np.ndarray, "H C"]]


def table_map(policy: Any, task: Task, logs: Logs) -> TableMap | None:
    """Count a policy's verbs for the objects of a log; None if the log does not describe them."""
    if logs.objects is None or not set(logs.objects.columns) >= NEEDED:
        return None
    objects = _with_verbs(policy, task, logs)
    hidden, chance = edges = [_edges(objects[name].to_numpy()) for name in ("hidden", "chance")]

    def counted(rows: Any) -> Int[np.ndarray, "H C"]:
        return np.histogram2d(rows["hidden"], rows["chance"], bins=edges)[0].astype(np.int64)

    count, taken = counted(objects), {verb.name: counted(objects[objects["verb"] == verb]) for verb in TARGETED}
    is_known = count >= FEWEST_OBJECTS
    share = {name: np.where(is_known, num / np.maximum(count, 1), np.nan) for name, num in taken.items() if num.any()}
    return TableMap(chance, hidden, count, share) if is_known.any() and share else None


def _with_verbs(policy: Any, task: Task, logs: Logs) -> Any:
    """Objects that stand on their table, with the verb that the policy would take on each; 0 for none."""
    assert logs.objects is not None
    taken = task.target_probabilities(policy, logs, horizon_of(policy))[stage_places(logs)]
    space = ActionSpace.of_size(taken.shape[1])
    action = taken.argmax(axis=1)
    decided = logs.stages[["trajectory", "stage"]].assign(of_verb=space.verb(action), target=space.target(action))
    objects = logs.objects[["trajectory", "stage", *sorted(NEEDED)]].copy()
    objects["place"] = objects.groupby(["trajectory", "stage"]).cumcount()
    joined: Any = objects.merge(decided, on=["trajectory", "stage"], how="left")
    found = joined.assign(
        verb=np.where(joined["place"] == joined["target"], joined["of_verb"], 0).astype(np.int64),
        chance=expit(joined["log_odds"].to_numpy(dtype=np.float64)),
        hidden=joined["occlusion"].to_numpy(dtype=np.float64),
    )
    return found[found["location"] == ON_TABLE]


def _edges(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " k"]:
    """Edges of cells of equal width, over the range of the values."""
    low, high = float(values.min()), float(values.max())
    return np.linspace(low, high if high > low else low + 1.0, NUM_TABLE_CELLS + 1)
