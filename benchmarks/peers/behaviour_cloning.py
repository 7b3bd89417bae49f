"""Do what the log most probably did, by a forest for each stage; stages that were cut count as well."""

import numpy as np
import pandas as pd
from peers.completed import begun
from sklearn.ensemble import RandomForestClassifier
from worlds.world import Chances, World

from halfseen.logs import Logs


def cloned(world: World, logs: Logs) -> Chances:
    """Learn to act like the log."""
    rows = begun(logs, world)
    forests = {}
    for stage in sorted(set(rows.stage.tolist())):
        is_here = rows.stage == stage
        forest = RandomForestClassifier(200, min_samples_leaf=5, random_state=0)
        forests[stage] = forest.fit(rows.state[is_here], rows.action[is_here])

    def chances(frame: pd.DataFrame, stage: int) -> np.ndarray:
        forest = forests[min(stage, max(forests))]
        action = forest.predict(frame[list(world.covariates)].to_numpy())
        return np.eye(len(world.actions))[action]

    return chances
