"""What a log holds, broken down by cause of the cuts, by action, by robot and by stage."""

from typing import Any

import numpy as np
import pandas as pd

from halfseen.logs.columns import ROBOT
from halfseen.logs.logs import Logs


def by_cause(logs: Logs) -> list[dict[str, Any]]:
    """Describe each cause of a cut, the most frequent first: its trajectories, when they were cut, in which stages.

    Returns
    -------
    list of dict
        cause, num_trajectories, share (proportion of the cuts), earliest, median and latest end [s], first and last
        stage.
    """
    last_stage: Any = logs.stages.groupby("trajectory")["stage"].max()
    cut: Any = logs.trajectories[~logs.is_finished]
    cut = cut.assign(stage=last_stage.reindex(cut["trajectory"]).to_numpy())
    rows = [
        {
            "cause": str(cause),
            "num_trajectories": len(rows),
            "share": len(rows) / len(cut),
            "earliest_s": float(rows["end_s"].min()),
            "median_s": float(rows["end_s"].median()),
            "latest_s": float(rows["end_s"].max()),
            "first_stage": int(rows["stage"].min()),
            "last_stage": int(rows["stage"].max()),
        }
        for cause, rows in cut.groupby("cause")
    ]
    return sorted(rows, key=lambda row: (-row["num_trajectories"], row["cause"]))


def by_action(logs: Logs) -> list[dict[str, Any]]:
    """Describe each action that was completed, the most frequent first: its stages, durations and rewards.

    Returns
    -------
    list of dict
        action, num_stages, share (a proportion of the completed stages), the median duration [s], the mean reward, and
        the mean and the smallest probability with which it was taken, None where that was not logged.
    """
    stages: Any = logs.stages.assign(duration_s=durations_s(logs))
    stages = stages[stages["elapsed_s"].notna()]
    rows = [
        {
            "action": str(action),
            "num_stages": len(rows),
            "share": len(rows) / len(stages),
            "median_s": float(rows["duration_s"].median()),
            "mean_reward": float(rows["reward"].mean()),
            "mean_probability": float(rows["probability"].mean()) if "probability" in rows else None,
            "smallest_probability": float(rows["probability"].min()) if "probability" in rows else None,
        }
        for action, rows in stages.groupby("action", observed=True)
    ]
    return sorted(rows, key=lambda row: (-row["num_stages"], row["action"]))


def by_robot(logs: Logs) -> list[dict[str, Any]]:
    """Count the decisions of each robot of a log of several, in the order of their names.

    Returns
    -------
    list of dict
        robot, num_decisions, share (a proportion of the stages); none where stages do not say which robot decided.
    """
    made = logs.stages[ROBOT].value_counts().sort_index() if ROBOT in logs.stages.columns else pd.Series(dtype=int)
    return [
        {"robot": str(robot), "num_decisions": int(number), "share": int(number) / len(logs.stages)}
        for robot, number in made.items()
    ]


def by_stage(logs: Logs) -> list[dict[str, Any]]:
    """Describe each stage: how many trajectories began and completed it, were cut in it, and how long it took.

    Returns
    -------
    list of dict
        stage, num_begun, num_completed, num_cut, and quantiles (5 %, 50 %, 95 %) of its duration [s], None where no
        trajectory completed it.
    """
    table: list[dict[str, Any]] = []
    stage: Any
    for stage, duration_s in pd.Series(durations_s(logs)).groupby(logs.stages["stage"].to_numpy()):
        took_s: Any = duration_s.dropna()
        low, middle, high = took_s.quantile([0.05, 0.5, 0.95]).tolist() if len(took_s) else (None, None, None)
        counts = {"num_begun": len(duration_s), "num_completed": len(took_s), "num_cut": len(duration_s) - len(took_s)}
        table.append({"stage": int(stage), **counts, "duration_5_s": low, "median_s": middle, "duration_95_s": high})
    return table


def durations_s(logs: Logs) -> np.ndarray:
    """Duration of each stage [s], shape (rows of stages,); NaN where it was not completed."""
    before = logs.stages.groupby("trajectory")["elapsed_s"].shift(fill_value=0.0)
    return (logs.stages["elapsed_s"] - before).to_numpy(dtype=np.float64)
