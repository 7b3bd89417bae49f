"""Values of a policy by scope-rl's sequential estimators, which know of no cuts, with their bootstrap intervals.

Trajectories that ended early are filled up to the horizon with stages of reward 0 that any policy would take. Q of
those that need one is fitted backwards, by stage and action, for each half of the trajectories on the other half.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np
import pandas as pd
from sklearn.dummy import DummyRegressor
from sklearn.linear_model import RidgeCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler
from worlds.policies import Drawn
from worlds.world import World

from halfseen.logs import Logs

ESTIMATORS = {
    "per decision": "PerDecisionImportanceSampling",
    "self-normalised": "SelfNormalizedPDIS",
    "doubly robust": "DoublyRobust",
    "self-normalised DR": "SelfNormalizedDR",
    "direct": "DirectMethod",
}
NUM_BOOTSTRAPS, LEVEL = 100, 0.95
FEWEST = 10
REGS = np.logspace(-2.0, 3.0, 11)
Interval = tuple[float, float, float]
"""Value, lower and upper end."""


def estimates(world: World, policy: Drawn, logs: Logs) -> dict[str, Interval]:
    """Value of a policy by each estimator, from trajectories of which none was cut."""
    given, discrete = arranged(world, policy, logs), import_module("scope_rl.ope.discrete")
    each = {}
    for name, kind in ESTIMATORS.items():
        estimator = getattr(discrete, kind)()
        value = estimator.estimate_policy_value(**given)
        around = estimator.estimate_interval(
            **given, alpha=1.0 - LEVEL, n_bootstrap_samples=NUM_BOOTSTRAPS, random_state=0
        )
        ends = (around[f"{100 * LEVEL}% CI ({end})"] for end in ("lower", "upper"))
        each[name] = (float(value), *map(float, ends))
    return each


def arranged(world: World, policy: Drawn, logs: Logs) -> dict[str, Any]:
    """Stages of all trajectories as scope-rl has them, one trajectory after the other, each of as many stages."""
    horizon, num_actions = len(world.actions_by_stage), len(world.actions)
    frame = logs.stages.reset_index(drop=True)
    number = pd.Index(logs.trajectory_ids).get_indexer(frame["trajectory"])
    size = logs.num_trajectories * horizon
    at = number * horizon + frame["stage"].to_numpy() - 1
    action, reward, pscore = np.zeros(size, dtype=int), np.zeros(size), np.ones(size)
    would, q = np.eye(num_actions)[np.zeros(size, dtype=int)], np.zeros((size, num_actions))
    action[at] = pd.Index(world.actions).get_indexer(frame["action"])
    reward[at], pscore[at] = frame["reward"], frame["probability"]
    for stage, rows in frame.groupby("stage"):
        would[at[rows.index]] = policy.probabilities(rows, int(stage))  # type: ignore[arg-type]
    half = np.random.default_rng(0).permutation(logs.num_trajectories)[number] % 2
    for k in (0, 1):
        fitted = backwards(world, policy, frame[half != k])
        for stage, rows in frame[half == k].groupby("stage"):
            q[at[rows.index]] = fitted[int(stage)](rows)  # type: ignore[arg-type]
    return {
        "step_per_trajectory": horizon,
        "action": action,
        "reward": reward,
        "pscore": pscore,
        "evaluation_policy_action_dist": would,
        "state_action_value_prediction": q,
    }


def backwards(world: World, policy: Drawn, frame: pd.DataFrame) -> Mapping[int, Any]:
    """Q of a policy by stage, as a function of covariates."""
    later, found = pd.Series(0.0, index=frame["trajectory"].unique()), {}
    for stage in range(len(world.actions_by_stage), 0, -1):
        rows = frame[frame["stage"] == stage]
        if rows.empty:
            found[stage] = nothing(world)
            continue
        found[stage] = q_of_stage(world, rows, rows["reward"] + later[rows["trajectory"]].to_numpy())
        value = (policy.probabilities(rows, stage) * found[stage](rows)).sum(axis=1)
        later = pd.Series(0.0, index=later.index)
        later[rows["trajectory"]] = value
    return found


def nothing(world: World) -> Any:
    """Q of a stage that no trajectory reached."""
    return lambda frame: np.zeros((len(frame), len(world.actions)))


def q_of_stage(world: World, rows: pd.DataFrame, target: pd.Series) -> Any:
    """Of each action, quadratic, with λ by leave-one-out, or a mean where it is rare; never beyond what was seen."""
    covariates, models = list(world.covariates), list[Any]()
    for name in world.actions:
        taken = (rows["action"] == name).to_numpy()
        if taken.sum() < FEWEST:
            models.append(DummyRegressor().fit(rows[covariates], target))
            continue
        model = make_pipeline(StandardScaler(), PolynomialFeatures(2, include_bias=False), RidgeCV(REGS))
        models.append(model.fit(rows.loc[taken, covariates], target[taken]))
    low, high = target.min(), target.max()

    def q(frame: pd.DataFrame) -> np.ndarray:
        return np.clip(np.column_stack([model.predict(frame[covariates]) for model in models]), low, high)

    return q
