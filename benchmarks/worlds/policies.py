"""Policies of a world whose values are known: better ones, and three that are exactly as good as the logging policy."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from worlds.world import Chances, World, is_possible


@dataclass(frozen=True)
class Drawn:
    """A policy of named actions that draws them with these chances."""

    chances: Chances
    actions: tuple[str, ...]
    horizon: int
    covariates: tuple[str, ...]
    actions_by_stage: dict[int, list[Any]]

    def probabilities(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        return self.chances(frame, stage)


def policies_of(world: World) -> dict[str, Drawn]:
    """Policies to be judged, by name; a null that a world does not have is left out.

    best        the optimum
    plain       a rule of thumb
    null, near  the logging policy, but nearer to the best one in one half of the states and farther in the other
    null, far   the best action or the worst, by lot
    null, split the best action in one half of the states, in the other the best or the worst by lot
    """
    own = world.value(world.logging)

    def gain(family: Callable[[World, float], Chances], share: float) -> float:
        return world.value(family(world, share)) - own

    def null(family: Callable[[World, float], Chances]) -> Chances:
        root: Any = brentq(lambda share: gain(family, share), 0.0, 1.0, xtol=1e-3)
        return family(world, root)

    families = {"null, near": _near, "null, far": _far, "null, split": _split}
    # Where the better half of the states is worth more than the rule earns in all, nothing undoes it in the other.
    exist = {name: family for name, family in families.items() if gain(family, 0.0) * gain(family, 1.0) <= 0.0}
    named = {"best": world.best, "plain": world.plain, **{name: null(family) for name, family in exist.items()}}
    by_stage = {stage: list(names) for stage, names in world.actions_by_stage.items()}
    rest = (tuple(world.actions), len(by_stage), tuple(world.covariates), by_stage)
    return {name: Drawn(chances, *rest) for name, chances in named.items()}


def _near(world: World, share: float) -> Chances:
    def chances(frame: pd.DataFrame, stage: int) -> np.ndarray:
        own = world.logging(frame, stage)
        nearer = world.best(frame, stage)
        farther = _worst(world, nearer, stage)
        return np.where(_is_low(world, frame), 0.8 * own + 0.2 * nearer, (1.0 - share) * own + share * farther)

    return chances


def _far(world: World, share: float) -> Chances:
    def chances(frame: pd.DataFrame, stage: int) -> np.ndarray:
        best = world.best(frame, stage)
        return (1.0 - share) * best + share * _worst(world, best, stage)

    return chances


def _split(world: World, share: float) -> Chances:
    def chances(frame: pd.DataFrame, stage: int) -> np.ndarray:
        best = world.best(frame, stage)
        far = (1.0 - share) * best + share * _worst(world, best, stage)
        return np.where(_is_low(world, frame), best, far)

    return chances


def _is_low(world: World, frame: pd.DataFrame) -> np.ndarray:
    name, middle = world.half
    return (frame[name].to_numpy() < middle)[:, None]


def _worst(world: World, best: np.ndarray, stage: int) -> np.ndarray:
    """The possible action after the best one, in their order: seldom a good one."""
    possible = np.flatnonzero(is_possible(world, stage))
    place = np.searchsorted(possible, best.argmax(axis=1))
    return np.eye(len(world.actions))[possible[(place + 1) % len(possible)]]
