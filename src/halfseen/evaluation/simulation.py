"""What a policy of tables earns in the simulated world, where nothing is cut and nothing has to be inferred."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from halfseen.errors import ArgumentError
from halfseen.evaluation.estimate import Estimate, check_level, estimate_of
from halfseen.world.config import WorldConfig
from halfseen.world.episodes import evaluate as play_out
from halfseen.world.policy import Policy
from halfseen.world.scene import Scene
from halfseen.world.state import pad_scenes

CHUNK_SIZE = 2000
"""Episodes between two signs of progress."""


@dataclass(frozen=True)
class WorldEvaluation:
    """The mean of episodes in the simulated world.

    Parameters
    ----------
    value
        Mean reward of an episode.
    steps
        Mean number of steps.
    robot_s
        Mean robot time of an episode [s].
    level
        Of the intervals.
    """

    value: Estimate
    steps: Estimate
    robot_s: Estimate
    level: float


def evaluate_in_world(
    policy: Any,
    scenes: Sequence[Scene],
    config: WorldConfig,
    *,
    episodes: int = 10_000,
    seed: int = 0,
    level: float = 0.95,
    on_progress: Callable[[int], object] = lambda done: None,
) -> WorldEvaluation:
    """Let a policy play; the same seed meets every policy with the same tables.

    Parameters
    ----------
    policy
        A `halfseen.world.Policy`.
    scenes
        Where episodes begin, in turn.
    config
        The world, with the horizon of the policy.
    episodes
        How many.
    seed
        Of the world.
    level
        Of the intervals.
    on_progress
        Called with the number of episodes played since.

    Raises
    ------
    ArgumentError
        The policy decides nothing about tables, or `episodes` is below 2.
    """
    check_level(level)
    if episodes < 2:
        raise ArgumentError(f"episodes is {episodes}; at least 2 are needed for an interval")
    if not isinstance(policy, Policy):
        raise ArgumentError(f"{type(policy).__name__} decides nothing about tables, so there is no world to play it in")
    layouts, totals_of = pad_scenes(scenes), []
    for chunk, start in enumerate(range(0, episodes, CHUNK_SIZE)):
        num = min(CHUNK_SIZE, episodes - start)
        key = jax.random.fold_in(jax.random.key(seed), chunk)
        totals = play_out(config, layouts, policy, key, num)
        totals_of.append(
            [np.asarray(leaf, dtype=np.float64) for leaf in (totals.reward, totals.num_steps, totals.robot_s)]
        )
        on_progress(num)
    means = [estimate_of(column, episodes, level) for column in np.concatenate(totals_of, axis=1)]
    return WorldEvaluation(*means, level=level)
