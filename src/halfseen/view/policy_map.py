"""Maps of a policy: what it would do over two covariates, or to objects, beside where the log has states."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from halfseen.arrays import expit
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.learning.rows import stage_places
from halfseen.learning.task import Task
from halfseen.logs import Logs
from halfseen.policies.shares import horizon_of
from halfseen.shapes import Bool, Float, Int
from halfseen.view.policy_findings import FEWEST_STATES, MOST_STAGES, middle_of
from halfseen.world.actions import TARGETED, ActionSpace

NUM_CELLS, NUM_TABLE_CELLS = 90, 10  # along each axis: of a map of states, and of one of objects
SHOWN = (0.01, 0.99)  # a map reaches from one of these quantiles of a covariate to the other
NEAR, FEWEST_NEAR = 0.5, 5
"""A place has support where so many logged states lie within this distance, in standard deviations."""
LEAST_SUPPORTED = 0.05  # of a map: less is not drawn
MOST_DOTS = 300
FEWEST_OBJECTS = 20  # a cell of fewer is not coloured
NEEDED = {"location", "log_odds", "occlusion"}
ON_TABLE = "TABLE"


@dataclass(frozen=True, eq=False)
class PolicyMap:
    """What a policy would do in one stage over one or two covariates; everything else stands in the `middle`.

    `taken` names the action at each place, up by across (`up` is None for a strip), and `is_supported` says where the
    log has states enough. `dots` are covariates of logged states, evenly spaced ones where there are many, and `done`
    is what was done there.
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
        """Every action that is taken or was, by name."""
        return list(dict.fromkeys([*map(str, np.unique(self.taken)), *map(str, self.done)]))


def policy_maps(policy: DiscretePolicy, logs: Logs, telling: list[str]) -> list[PolicyMap]:
    """Draw up the maps of the first stages.

    Parameters
    ----------
    telling
        Covariates of numbers, those that sway the choice most first.
    """
    stages = range(1, min(MOST_STAGES, logs.horizon, policy.horizon) + 1)
    frame: Any = logs.stages
    maps = [_map_of(policy, frame[frame["stage"] == stage], stage, telling) for stage in stages]
    return [one for one in maps if one is not None and one.is_supported.mean() >= LEAST_SUPPORTED]


def _map_of(policy: DiscretePolicy, states: pd.DataFrame, stage: int, telling: list[str]) -> PolicyMap | None:
    names = tuple([name for name in telling if states[name].nunique() > 1][:2])
    if len(states) < FEWEST_STATES or not names:
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
        is_supported=supported(across, up, values),
        dots=dots[list(names)].to_numpy(dtype=np.float64),
        done=dots["action"].astype(str).to_numpy(dtype=object),
        middle={
            name: f"{value:.3g}" if isinstance(value, float) else str(value)
            for name, value in middle.items()
            if name not in names
        },
    )


def supported(
    across: Float[np.ndarray, " k"], up: Float[np.ndarray, " j"] | None, states: Float[np.ndarray, "n d"]
) -> Bool[np.ndarray, "j k"]:
    """Whether enough logged states lie near each place of a grid, each covariate by its standard deviation."""
    x, y = (states / states.std(axis=0)).T if up is not None else (states[:, 0] / states.std(), np.zeros(len(states)))
    heights = np.zeros(1) if up is None else up / states[:, 1].std()
    num_near = np.zeros((len(heights), len(across)), dtype=np.int64)
    for column, place in enumerate(across / states[:, 0].std()):
        # In a column of places those near a state are the ones between two heights.
        squared = NEAR**2 - (x - place) ** 2
        reach, middle = np.sqrt(squared[squared >= 0.0]), y[squared >= 0.0]
        begun = np.searchsorted(np.sort(middle - reach), heights, side="right")
        num_near[:, column] = begun - np.searchsorted(np.sort(middle + reach), heights, side="left")
    return num_near >= FEWEST_NEAR


@dataclass(frozen=True, eq=False)
class TableMap:
    """Of the objects on the tables of a log, by how dirty they seem and how much of them is hidden.

    Cells have edges in the probability of being dirty and in the hidden share; an object counts once in every state.
    `share` is, by verb, that of the objects to which the policy would do it next; NaN where there are too few.
    """

    chance_edges: Float[np.ndarray, " c"]
    hidden_edges: Float[np.ndarray, " h"]
    num_objects: Int[np.ndarray, "H C"]
    share: dict[str, Float[np.ndarray, "H C"]]


def table_map(policy: Any, task: Task, logs: Logs) -> TableMap | None:
    """Count what a policy would do to the objects of a log; None where the log does not say how they stand."""
    if logs.objects is None or not set(logs.objects.columns) >= NEEDED:
        return None
    objects = _with_verbs(policy, task, logs)
    hidden, chance = edges = [_edges(objects[name].to_numpy()) for name in ("hidden", "chance")]

    def counted(rows: Any) -> Int[np.ndarray, "H C"]:
        return np.histogram2d(rows["hidden"], rows["chance"], bins=edges)[0].astype(np.int64)

    count, verbs = counted(objects), {verb: objects[objects["verb"] == verb] for verb in TARGETED}
    is_known = count >= FEWEST_OBJECTS
    share = {
        verb.name: np.where(is_known, counted(rows) / np.maximum(count, 1), np.nan)
        for verb, rows in verbs.items()
        if len(rows)
    }
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
    """Of cells of equal width, over what there is."""
    low, high = float(values.min()), float(values.max())
    return np.linspace(low, high if high > low else low + 1.0, NUM_TABLE_CELLS + 1)
