"""What a log holds, broken down by cause of the cuts, by action, by robot and by stage."""

from typing import Any

import numpy as np

from halfseen.logs.checks.robots import ROBOT
from halfseen.logs.logs import Logs


def by_cause(logs: Logs) -> list[dict[str, Any]]:
    """Tell for each cause of a cut, the most frequent first: its trajectories, when they were cut, and in which stages.

    Returns
    -------
    list of dict
        cause, num_trajectories, share (proportion of the cuts), earliest, median and latest end [s], first and last
        stage.
    """
    cut = logs.trajectories[~logs.is_finished].reset_index(drop=True)
    last_stage: Any = logs.stages.groupby("trajectory")["stage"].max()
    stage = last_stage.reindex(cut["trajectory"]).reset_index(drop=True)
    rows = [
        {
            "cause": str(cause),
            "num_trajectories": len(ends),
            "share": len(ends) / len(cut),
            "earliest_s": float(ends.min()),
            "median_s": float(ends.median()),
            "latest_s": float(ends.max()),
            "first_stage": int(stage[ends.index].min()),
            "last_stage": int(stage[ends.index].max()),
        }
        for cause, ends in cut.groupby("cause")["end_s"]
    ]
    return sorted(rows, key=lambda row: (-row["num_trajectories"], row["cause"]))


def by_action(logs: Logs) -> list[dict[str, Any]]:
    """Tell for each action that was completed, the most frequent first: its stages, durations and rewards.

    Returns
    -------
    list of dict
        action, num_stages, share (a proportion of the completed stages), the median duration [s], the mean reward, and
        the mean and the smallest probability with which it was taken, None where that was not logged.
    """
    stages: Any = logs.stages.assign(duration_s=durations_s(logs))
    stages = stages[stages["elapsed_s"].notna()]
    rows = [_action_row(str(action), taken, len(stages)) for action, taken in stages.groupby("action", observed=True)]
    return sorted(rows, key=lambda row: (-row["num_stages"], row["action"]))


def by_robot(logs: Logs) -> list[dict[str, Any]]:
    """Tell for each robot of a log of several, in the order of their names: the decisions that it made.

    Returns
    -------
    list of dict
        robot, num_decisions, share (a proportion of the stages); none where stages do not say which robot decided.
    """
    if ROBOT not in logs.stages.columns:
        return []
    made = logs.stages[ROBOT].value_counts().sort_index()
    return [
        {"robot": str(robot), "num_decisions": int(number), "share": int(number) / len(logs.stages)}
        for robot, number in made.items()
    ]


def by_stage(logs: Logs) -> list[dict[str, Any]]:
    """Tell for each stage: how many trajectories began and completed it, were cut in it, and how long it took.

    Returns
    -------
    list of dict
        stage, num_begun, num_completed, num_cut, and quantiles (5 %, 50 %, 95 %) of its duration [s], None where no
        trajectory completed it.
    """
    stages: Any = logs.stages.assign(duration_s=durations_s(logs))
    return [_stage_row(int(stage), rows) for stage, rows in stages.groupby("stage")]


def durations_s(logs: Logs) -> np.ndarray:
    """Duration of each stage [s], shape (rows of stages,); NaN where it was not completed."""
    before = logs.stages.groupby("trajectory")["elapsed_s"].shift(fill_value=0.0)
    return (logs.stages["elapsed_s"] - before).to_numpy(dtype=np.float64)


def _action_row(action: str, taken: Any, num_completed: int) -> dict[str, Any]:
    probability = taken["probability"] if "probability" in taken.columns else None
    return {
        "action": action,
        "num_stages": len(taken),
        "share": len(taken) / num_completed,
        "median_s": float(taken["duration_s"].median()),
        "mean_reward": float(taken["reward"].mean()),
        "mean_probability": None if probability is None else float(probability.mean()),
        "smallest_probability": None if probability is None else float(probability.min()),
    }


def _stage_row(stage: int, rows: Any) -> dict[str, Any]:
    took_s = rows["duration_s"].dropna()
    quantiles = [None] * 3 if took_s.empty else [float(took_s.quantile(share)) for share in (0.05, 0.5, 0.95)]
    return {
        "stage": stage,
        "num_begun": len(rows),
        "num_completed": len(took_s),
        "num_cut": len(rows) - len(took_s),
        "duration_5_s": quantiles[0],
        "median_s": quantiles[1],
        "duration_95_s": quantiles[2],
    }
