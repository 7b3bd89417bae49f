"""A trial of two stages with few kinds of state, so that Q is a table and every estimate a weighted mean."""

from typing import Any

import numpy as np
import pandas as pd

from censoring.oracles import naive_survival
from halfseen.logs import Logs

FULL = ["s1_0", "s1_1", "s1_2", "s2_0", "s2_1"]
REDUCED = ["s1_1", "s1_2", "s2_1"]
ACTIONS = ["A", "B"]


def log_of(
    action: Any,
    reward: Any,
    *,
    trajectory: Any = None,
    stage: Any = None,
    num_stages: Any = 1,
    ends_s: Any = None,
    is_seen: Any = True,
    **covariates: Any,
):
    """Stages by rows, as many of each trajectory if it is not given; one ends at its number, and is cut if not seen."""
    rows = np.arange(len(reward))
    trajectory = rows // num_stages if trajectory is None else trajectory
    stage = rows % num_stages + 1 if stage is None else stage
    frame = pd.DataFrame({"trajectory": trajectory, "stage": stage, "action": action, **covariates})
    frame["end_s"] = np.asarray(stage if ends_s is None else ends_s, dtype=float)
    is_seen = np.broadcast_to(is_seen, len(rows))
    frame["ending"] = np.where(is_seen, "finished", "cut")
    ends = frame.groupby("trajectory")[["end_s", "ending"]].last().reset_index()
    seen = {"elapsed_s": frame["end_s"].where(is_seen), "reward": np.where(is_seen, reward, np.nan)}
    return Logs(frame.drop(columns=["end_s", "ending"]).assign(**seen), ends)


def indicators(stage, state):
    return {name: float(name == f"s{stage}_{state}") for name in FULL}


def two_stage_trial(seed=0, num_trajectories=400, last_cut=9, cut_from=1):
    """Trajectories of one or two stages on a clock of whole seconds, cut at a whole second: ties abound."""
    rng, rows = np.random.default_rng(seed), []
    for trajectory in range(num_trajectories):
        states = rng.integers(0, 3), rng.integers(0, 2)
        actions = rng.integers(0, 2, size=2)
        clock = np.cumsum(rng.integers(1, 4, size=2))
        num_stages = 1 if states[0] == 2 and actions[0] == 1 else 2
        cut_s = int(rng.integers(cut_from, last_cut + 1))
        rewards = np.array([states[0] * 0.5 - actions[0], (2 * states[1] - 1) * (2 * actions[1] - 1) + clock[1] / 4])
        rewards = rewards + rng.normal(size=2)
        num_seen = sum(clock[t] <= cut_s for t in range(num_stages))
        for t in range(min(num_seen + 1, num_stages)):
            row = {"trajectory": trajectory, "stage": t + 1, "ends_s": min(clock[t], cut_s), "is_seen": t < num_seen}
            row |= {"action": ACTIONS[actions[t]] if t < num_seen or rng.random() < 0.5 else None}
            rows.append(row | {"reward": rewards[t], "state": int(states[t]), **indicators(t + 1, states[t])})
    return log_of(**pd.DataFrame(rows))


def with_known_actions(trial):
    """The same with the action of every stage, those that were cut included."""
    by_lot = pd.Series(np.random.default_rng(0).choice(ACTIONS, trial.num_stages))
    return Logs(trial.stages.assign(action=trial.stages["action"].fillna(by_lot)), trial.trajectories)


def all_cut(trial):
    """The same of which no trajectory came to its own end."""
    stages = trial.stages.groupby("trajectory").head(1).assign(elapsed_s=None, reward=None)
    return Logs(stages, trial.trajectories.assign(ending="cut", cause=None))


def cell_means(logs):
    """Eq. (3) for saturated Q: weighted means by state and action, as frames indexed by state, columns by action."""
    ends, own = logs.end_s.tolist(), logs.is_finished.tolist()
    survival = {u: naive_survival(ends, own, u) for u in logs.stages["elapsed_s"].dropna().unique()}
    rows = logs.stages.assign(weight=(1.0 / logs.stages["elapsed_s"].map(survival)).fillna(0.0))
    completed = rows[rows["weight"] > 0]

    def means(stage, target):
        part = completed[completed["stage"] == stage].assign(target=target)
        part = part.assign(mass=part["weight"] * part["target"])
        sums = part.groupby(["state", "action"])[["mass", "weight"]].sum()
        return (sums["mass"] / sums["weight"]).unstack("action")

    second = means(2, completed.loc[completed["stage"] == 2, "reward"])
    state_after = rows[rows["stage"] == 2].set_index("trajectory")["state"]
    first = completed[completed["stage"] == 1]
    value = first["trajectory"].map(state_after).map(second.max(axis=1)).fillna(0.0)
    return means(1, first["reward"] + value), second
