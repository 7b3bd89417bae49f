"""What a policy of tables would do to an object, by how dirty that seems and how much of it is hidden.

No table is made up for it: these are the objects of the states of the log, with all that stood around them.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from halfseen.arrays import expit
from halfseen.learning.rows import stage_places
from halfseen.learning.task import Task
from halfseen.logs import Logs
from halfseen.policies.shares import horizon_of
from halfseen.shapes import Float, Int
from halfseen.world.actions import TARGETED, ActionSpace

NUM_CELLS = 10
FEWEST_OBJECTS = 20
"""A cell of fewer is not coloured."""
NEEDED = {"location", "log_odds", "occlusion"}
ON_TABLE = "TABLE"


@dataclass(frozen=True, eq=False)
class TableMap:
    """Of the objects on the tables of a log, by how dirty they seem and how much of them is hidden.

    Parameters
    ----------
    chance_edges, hidden_edges
        Of the cells: the probability of being dirty, and the hidden share.
    num_objects
        Of each cell, hidden share by probability; an object counts once in every state.
    share
        By verb, the share of these objects to which the policy would do it next; NaN where there are too few.
    """

    chance_edges: Float[np.ndarray, " c"]
    hidden_edges: Float[np.ndarray, " h"]
    num_objects: Int[np.ndarray, "H C"]
    share: dict[str, Float[np.ndarray, "H C"]]


def table_map(policy: Any, task: Task, logs: Logs) -> TableMap | None:
    """Count what a policy would do to the objects of a log; None where the log does not say how they stand."""
    if logs.objects is None or not set(logs.objects.columns) >= NEEDED:
        return None
    objects: Any = _with_verbs(policy, task, logs)
    edges = [_edges(objects[name].to_numpy()) for name in ("hidden", "chance")]
    count = _counts(objects, edges)
    is_known = count >= FEWEST_OBJECTS
    share = {
        verb.name: np.where(is_known, _counts(objects[objects["verb"] == verb], edges) / np.maximum(count, 1), np.nan)
        for verb in TARGETED
        if (objects["verb"] == verb).any()
    }
    return TableMap(edges[1], edges[0], count, share) if is_known.any() and share else None


def _with_verbs(policy: Any, task: Task, logs: Logs) -> pd.DataFrame:
    """Objects that stand on their table, with the verb that the policy would take on each; 0 for none."""
    assert logs.objects is not None
    taken = task.target_probabilities(policy, logs, horizon_of(policy))[stage_places(logs)]
    space = ActionSpace.of_size(taken.shape[1])
    action = taken.argmax(axis=1)
    decided = logs.stages[["trajectory", "stage"]].assign(of_verb=space.verb(action), target=space.target(action))
    objects = logs.objects[["trajectory", "stage", *sorted(NEEDED)]].copy()
    objects["place"] = objects.groupby(["trajectory", "stage"]).cumcount()
    joined: Any = objects.merge(decided, on=["trajectory", "stage"], how="left")
    told: Any = pd.DataFrame(
        {
            "verb": np.where(joined["place"] == joined["target"], joined["of_verb"], 0).astype(np.int64),
            "chance": expit(joined["log_odds"].to_numpy(dtype=np.float64)),
            "hidden": joined["occlusion"].to_numpy(dtype=np.float64),
        }
    )
    return told[(joined["location"] == ON_TABLE).to_numpy()]


def _edges(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " k"]:
    """Of cells of equal width, over what there is."""
    low, high = float(values.min()), float(values.max())
    return np.linspace(low, high if high > low else low + 1.0, NUM_CELLS + 1)


def _counts(objects: pd.DataFrame, edges: list[Float[np.ndarray, " k"]]) -> Int[np.ndarray, "H C"]:
    count, *_ = np.histogram2d(objects["hidden"], objects["chance"], bins=edges)
    return count.astype(np.int64)
