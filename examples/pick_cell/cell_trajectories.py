"""Who decides in the cell, and the log of what came of it: for many parts at once, or one by one while it happens."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from cell_parts import (
    ACTIONS,
    ACTIONS_ALL,
    COVARIATES,
    GRIPPERS,
    HAND_OVER,
    HORIZON,
    RATE,
    REWARD_UNIT,
    attempt,
    new_parts,
)
from jaxtyping import Float, Int

from halfseen.logs import LogRecorder, Logs, read_logs

RULE_SHARE = 0.6
"""Share of the logged stages in which the rule of thumb was followed; in the others any possible action was tried."""
CAUSES = ("operator", "sensor-lost")
CAUSE_SHARES = (0.75, 0.25)


def rule_of_thumb(parts: pd.DataFrame, stage: int) -> Int[np.ndarray, " m"]:
    """Heavy parts to the parallel gripper, shiny ones to suction, others to the soft one; after two failures, a person.

    Thresholds were not tuned; they are what one would say at the cell.
    """
    if stage > 2:
        return np.full(len(parts), HAND_OVER)
    heavy, shiny = parts["weight_kg"].to_numpy() > 1.5, parts["shine"].to_numpy() > 0.5
    names = np.select([heavy, shiny], ["parallel", "suction"], "soft")
    return pd.Index(GRIPPERS).get_indexer(names).astype(np.int64)


def logging_chances(parts: pd.DataFrame, stage: int) -> Float[np.ndarray, "m A"]:
    """Chance of each action while the log was made."""
    is_possible = np.isin(ACTIONS_ALL, ACTIONS[stage])
    chances = np.tile((1.0 - RULE_SHARE) * is_possible / is_possible.sum(), (len(parts), 1))
    chances[np.arange(len(parts)), rule_of_thumb(parts, stage)] += RULE_SHARE
    return chances


def simulate(num_trajectories: int, seed: int, is_cut: bool = True, rate: float = RATE) -> Logs:
    """Log parts, all of them at once.

    Parameters
    ----------
    num_trajectories
        n.
    seed
        Of all draws.
    is_cut
        False for a cell that nobody stops.
    rate
        Takes the place of RATE: cuts are more, or fewer.
    """
    rng = np.random.default_rng(seed)
    trajectory, clock, parts = np.arange(num_trajectories), np.zeros(num_trajectories), new_parts(num_trajectories, rng)
    stages, trajectories = [], []
    for stage in range(1, HORIZON + 1):
        action, chance = draw_action(parts, stage, rng)
        outcome = attempt(parts, action, rng, rate)
        is_seen = outcome.duration_s <= outcome.cut_s if is_cut else np.ones(len(trajectory), dtype=bool)
        end = clock + np.where(is_seen, outcome.duration_s, outcome.cut_s)
        rows = {
            "trajectory": trajectory,
            "stage": stage,
            "elapsed_s": np.where(is_seen, end, np.nan),
            "action": np.array(ACTIONS_ALL, dtype=object)[action],
            "reward": np.where(is_seen, outcome.reward, np.nan),
            "probability": chance,
        }
        stages.append(pd.concat([pd.DataFrame(rows), parts], axis=1))
        ends = ~is_seen | outcome.is_over | (stage == HORIZON)
        cause = rng.choice(np.array(CAUSES, dtype=object), len(trajectory), p=CAUSE_SHARES)
        cause[is_seen] = None
        ending = np.where(is_seen, "finished", "cut")
        trajectories.append(
            pd.DataFrame({"trajectory": trajectory, "end_s": end, "ending": ending, "cause": cause})[ends]
        )
        goes_on = ~ends
        trajectory, clock = trajectory[goes_on], end[goes_on]
        parts = parts.assign(clutter=outcome.clutter).loc[goes_on].reset_index(drop=True)
    tables: Any = (pd.concat(each, ignore_index=True) for each in (stages, trajectories))
    return Logs(*tables, reward_unit=REWARD_UNIT)


def record(folder: Path, num_trajectories: int, seed: int) -> None:
    """Log parts one by one with a recorder, stage by stage, and write what it holds into a folder for good.

    The clock is simulated, so the recorder is given it; at a real cell it reads its own.
    """
    rng = np.random.default_rng(seed)
    with TemporaryDirectory() as journal:
        with LogRecorder(journal, reward_unit=REWARD_UNIT) as recorder:
            for _ in range(num_trajectories):
                _record_one(recorder, rng)
        read_logs(journal).write(folder, overwrite=True)


def _record_one(recorder: LogRecorder, rng: np.random.Generator) -> None:
    part, clock_s, trajectory = new_parts(1, rng), 0.0, recorder.begin_trajectory()
    for stage in range(1, HORIZON + 1):
        action, chance = draw_action(part, stage, rng)
        seen = {name: float(part[name].iloc[0]) for name in COVARIATES}
        trajectory.begin_stage(covariates=seen, action=ACTIONS_ALL[action[0]], probability=float(chance[0]))
        outcome = attempt(part, action, rng)
        if outcome.cut_s[0] < outcome.duration_s[0]:
            trajectory.cut(str(rng.choice(CAUSES, p=CAUSE_SHARES)), elapsed_s=clock_s + float(outcome.cut_s[0]))
            return
        clock_s += float(outcome.duration_s[0])
        trajectory.complete_stage(reward=float(outcome.reward[0]), elapsed_s=clock_s)
        if outcome.is_over[0]:
            break
        part = part.assign(clutter=outcome.clutter)
    trajectory.finish()


def draw_action(
    parts: pd.DataFrame, stage: int, rng: np.random.Generator
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Draw what the logging policy does with each part, and tell how likely it was to."""
    chances = logging_chances(parts, stage)
    level = rng.random((len(parts), 1))
    action = np.minimum((level > np.cumsum(chances, axis=1)).sum(axis=1), len(ACTIONS_ALL) - 1)
    return action, chances[np.arange(len(parts)), action]
