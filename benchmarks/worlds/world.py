"""What a world of a benchmark tells: logs of it, and what policies of it are worth."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import pandas as pd
from jaxtyping import Float

from halfseen.logs import Logs

Chances = Callable[[pd.DataFrame, int], Float[np.ndarray, "m A"]]
"""(covariates, stage from 1) → chance of each action, for each row."""


class World(Protocol):
    """Named actions and covariates, so many stages, and a value of every policy."""

    actions: Sequence[str]
    actions_by_stage: Mapping[int, Sequence[str]]
    covariates: Sequence[str]
    half: tuple[str, float]
    """A covariate, and the value that half of the trajectories begin below: a policy may tell them apart."""

    @property
    def optimum(self) -> float:
        """Value of the best policy."""
        ...

    def log(self, num_trajectories: int, seed: int, share: float) -> Logs:
        """Draw a log of which a share is cut, in expectation."""
        ...

    def value(self, chances: Chances) -> float:
        """Expected reward of a trajectory under a policy."""
        ...

    def logging(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "m A"]:
        """Decide as the policy that makes the logs."""
        ...

    def plain(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "m A"]:
        """Decide by a rule of thumb: what the logging policy does without its exploration, where that is a rule."""
        ...

    def best(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "m A"]:
        """Decide as the best policy does."""
        ...


def is_possible(world: World, stage: int) -> Any:
    """Tell which of all actions a stage has."""
    return np.isin(np.array(world.actions, dtype=object), np.array(world.actions_by_stage[stage], dtype=object))
