"""A log as the rows that learners know who know of no cuts: completed stages, and what came after each."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from worlds.world import World, is_possible

from halfseen.logs import Logs


class Begun(NamedTuple):
    """The begun stages of a log, ordered by trajectory and stage."""

    trajectory: Int[np.ndarray, " m"]
    stage: Int[np.ndarray, " m"]
    state: Float[np.ndarray, "m F"]
    action: Int[np.ndarray, " m"]
    reward: Float[np.ndarray, " m"]
    is_completed: Bool[np.ndarray, " m"]
    is_last: Bool[np.ndarray, " m"]
    """The last begun stage of its trajectory; the end of the trajectory if it is completed."""


def begun(logs: Logs, world: World) -> Begun:
    """Lay out a log."""
    frame = logs.stages.sort_values(["trajectory", "stage"], ignore_index=True)
    trajectory = frame["trajectory"].to_numpy()
    return Begun(
        trajectory=trajectory,
        stage=frame["stage"].to_numpy(dtype=np.int64),
        state=frame[list(world.covariates)].to_numpy(dtype=np.float64),
        action=pd.Index(world.actions).get_indexer(frame["action"]).astype(np.int64),
        reward=frame["reward"].to_numpy(dtype=np.float64),
        is_completed=frame["elapsed_s"].notna().to_numpy(),
        is_last=np.append(trajectory[1:] != trajectory[:-1], True),
    )


def possible_of(stage: Int[np.ndarray, " m"], world: World) -> Bool[np.ndarray, "m A"]:
    """Which actions each row may take."""
    by_stage = np.stack([is_possible(world, t) for t in sorted(world.actions_by_stage)])
    return by_stage[stage - 1]
