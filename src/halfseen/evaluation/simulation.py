"""Returns of policies of tables in the simulated world, where nothing is cut and nothing needs to be inferred."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.evaluation.estimate import Estimate, check_level, estimate_of
from halfseen.shapes import Float
from halfseen.world import random
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy, check_fits
from halfseen.world.random import Key
from halfseen.world.robots import Team
from halfseen.world.rollout import Totals, evaluate
from halfseen.world.scene import Scene
from halfseen.world.table_world import TableWorld

CHUNK_SIZE = 2000
"""Episodes between two progress updates."""


@dataclass(frozen=True)
class WorldEvaluation:
    """Mean results of episodes in the simulated world.

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


@dataclass(frozen=True)
class WorldComparison:
    """A policy compared with another one on the same tables.

    Parameters
    ----------
    baseline
        Name of the other one.
    value
        Mean reward of its episodes.
    difference
        Value of the policy minus that, by paired episodes.
    """

    baseline: str
    value: Estimate
    difference: Estimate


def evaluate_in_world(policy: Policy, scenes: Sequence[Scene], config: WorldConfig, **how: Any) -> WorldEvaluation:
    """Simulate a policy; with equal seeds, all policies meet the same tables.

    Parameters
    ----------
    policy, scenes, config, **how
        As for `compare_in_world`.

    Raises
    ------
    ArgumentError, PolicyError, SceneError
        As in `compare_in_world`.
    """
    return compare_in_world(policy, {}, scenes, config, **how)[0]


def compare_in_world(
    policy: Policy,
    baselines: Mapping[str, Policy],
    scenes: Sequence[Scene],
    config: WorldConfig,
    *,
    team: Team | None = None,
    episodes: int = 10_000,
    seed: int = 0,
    level: float = 0.95,
    on_progress: Callable[[int], object] = lambda done: None,
) -> tuple[WorldEvaluation, tuple[WorldComparison, ...]]:
    """Simulate a policy and others on the same tables.

    Parameters
    ----------
    policy
        The policy; with several robots, it decides for the one that is free.
    baselines
        Other policies by name; each plays all the episodes, too.
    scenes
        Initial scenes of the episodes, in turn.
    config
        The world, with the horizon of the policy.
    team
        The robots; None for one that reaches everything. Robot time is then the time on the table's clock.
    episodes
        Number of episodes.
    seed
        Of the world.
    level
        Of the intervals.
    on_progress
        Called with the number of episodes since the last call.

    Raises
    ------
    ArgumentError
        The policy does not decide about tables, or `episodes` is below 2.
    PolicyError
        The policy is for another number of robots, or of their decisions.
    SceneError
        A scene does not give a team the places of its objects.
    """
    policies, world = (policy, *baselines.values()), TableWorld.of(team, config)
    layouts, played = world.layouts(scenes), world.played_config
    for each in policies:
        if not isinstance(each, Policy):
            raise ArgumentError(
                f"{type(each).__name__} does not decide about tables, as the simulated world needs; give a policy of "
                "tables"
            )
        if team is not None:
            check_fits(each, played)
    check_level(level)
    if episodes < 2:
        raise ArgumentError(f"episodes is {episodes}; give at least 2, for an interval")
    ours, *theirs = (
        _played(partial(evaluate, played, layouts, each), episodes, seed, on_progress) for each in policies
    )
    means = [estimate_of(column, episodes, level) for column in ours]
    comparisons = (
        WorldComparison(name, estimate_of(other[0], episodes, level), estimate_of(ours[0] - other[0], episodes, level))
        for name, other in zip(baselines, theirs, strict=True)
    )
    return WorldEvaluation(*means, level=level), tuple(comparisons)


def _played(
    play: Callable[[Key, int], Totals], episodes: int, seed: int, on_progress: Callable[[int], object]
) -> Float[np.ndarray, "3 episodes"]:
    """Reward, number of steps and robot time of each episode."""
    totals_of = []
    for chunk, start in enumerate(range(0, episodes, CHUNK_SIZE)):
        num = min(CHUNK_SIZE, episodes - start)
        totals = play(random.fold_in(random.key_of(seed), chunk), num)
        totals_of.append(
            [np.asarray(leaf, dtype=np.float64) for leaf in (totals.reward, totals.num_steps, totals.robot_s)]
        )
        on_progress(num)
    return np.concatenate(totals_of, axis=1)
