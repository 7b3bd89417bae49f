"""What a policy would do over the two covariates that tell most, beside what was done; and where the log has states."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from halfseen.learning.flat_policy import FlatPolicy
from halfseen.logs import Logs
from halfseen.report.states import middle_of
from halfseen.shapes import Bool, Float

NUM_CELLS = 90
"""Along each axis."""
MOST_STAGES, FEWEST_STATES = 3, 10
"""Stages that are drawn at most, and states that one of them has at least."""
SHOWN = (0.01, 0.99)
"""A map reaches from one of these quantiles of a covariate to the other."""
NEAR, FEWEST_NEAR = 0.5, 5
"""A place has support where so many logged states lie within this distance, in standard deviations."""
LEAST_SUPPORTED = 0.05
"""Of a map: less is not drawn."""
MOST_DOTS = 300


@dataclass(frozen=True, eq=False)
class PolicyMap:
    """What a policy would do in one stage over one or two covariates; everything else stands in the middle.

    Parameters
    ----------
    stage
        From 1.
    covariates
        One name, or two: across and up.
    across, up
        Values of the covariates; `up` is None for a strip.
    taken
        Name of the action at each place, up by across.
    is_supported
        Where the log has states enough.
    dots
        Values of the covariates of logged states, evenly spaced ones where there are many.
    done
        What was done there.
    middle
        The other covariates: where they stand.
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


def policy_maps(policy: FlatPolicy, logs: Logs, telling: list[str]) -> list[PolicyMap]:
    """Draw up the maps of the first stages.

    Parameters
    ----------
    policy
        Of named actions.
    logs
        Whose states are shown.
    telling
        Covariates of numbers, those that sway the choice most first.
    """
    stages = range(1, min(MOST_STAGES, logs.horizon, policy.horizon) + 1)
    frame: Any = logs.stages
    maps = [_map_of(policy, frame[frame["stage"] == stage], stage, telling) for stage in stages]
    return [one for one in maps if one is not None and one.is_supported.mean() >= LEAST_SUPPORTED]


def _map_of(policy: FlatPolicy, states: pd.DataFrame, stage: int, telling: list[str]) -> PolicyMap | None:
    varying = [name for name in telling if states[name].nunique() > 1]
    if len(states) < FEWEST_STATES or not varying:
        return None
    names = tuple(varying[:2])
    values = states[list(names)].to_numpy(dtype=np.float64)
    low, high = np.quantile(values, SHOWN, axis=0)
    if (low == high).any():
        return None
    axes = [np.linspace(*ends, NUM_CELLS) for ends in zip(low, high, strict=True)]
    across, up = axes[0], axes[1] if len(names) == 2 else None
    grid = np.stack([each.ravel() for each in np.meshgrid(*axes)], axis=1)
    middle = middle_of(policy, states)
    at = pd.DataFrame(middle, index=range(len(grid))).assign(**dict(zip(names, grid.T, strict=True)))
    shape = (1 if up is None else len(up), len(across))
    known: Any = states[states["action"].notna().to_numpy()]
    dots = _few_of(known)
    return PolicyMap(
        stage=stage,
        covariates=names,
        across=across,
        up=up,
        taken=policy.decide(at, stage).astype(str).reshape(shape),
        is_supported=supported(across, up, values),
        dots=dots[list(names)].to_numpy(dtype=np.float64),
        done=dots["action"].astype(str).to_numpy(dtype=object),
        middle={name: _written(value) for name, value in middle.items() if name not in names},
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


def _few_of(states: pd.DataFrame) -> pd.DataFrame:
    """Evenly spaced rows, where there are many."""
    if len(states) <= MOST_DOTS:
        return states
    return states.iloc[((np.arange(MOST_DOTS) + 0.5) * len(states) / MOST_DOTS).astype(int)]


def _written(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
