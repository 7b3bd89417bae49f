"""What policies of tables earn in the simulated world, where nothing is cut and nothing has to be inferred."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import jax
import numpy as np
from jaxtyping import Float

from halfseen.errors import ArgumentError
from halfseen.evaluation.estimate import Estimate, check_level, estimate_of
from halfseen.team.episodes import evaluate as play_out_team
from halfseen.team.fit import check_fits
from halfseen.team.policy import TeamPolicy
from halfseen.team.team_world import TeamWorld
from halfseen.world.config import WorldConfig
from halfseen.world.episodes import Totals
from halfseen.world.episodes import evaluate as play_out
from halfseen.world.policy import Policy
from halfseen.world.scene import Scene
from halfseen.world.state import pad_scenes

CHUNK_SIZE = 2000
"""Episodes between two signs of progress."""

Play: TypeAlias = Callable[[Any, jax.Array, int], Totals]
"""Plays so many episodes by a policy."""


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


@dataclass(frozen=True)
class WorldComparison:
    """A policy beside another one that met the same tables.

    Parameters
    ----------
    opponent
        Name of the other one.
    value
        Mean reward of its episodes.
    difference
        Of the policy's value from that, episode by episode.
    """

    opponent: str
    value: Estimate
    difference: Estimate


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
    return compare_in_world(
        policy, {}, scenes, config, episodes=episodes, seed=seed, level=level, on_progress=on_progress
    )[0]


def compare_in_world(
    policy: Any,
    opponents: Mapping[str, Any],
    scenes: Sequence[Scene],
    config: WorldConfig,
    *,
    episodes: int = 10_000,
    seed: int = 0,
    level: float = 0.95,
    on_progress: Callable[[int], object] = lambda done: None,
) -> tuple[WorldEvaluation, tuple[WorldComparison, ...]]:
    """Let a policy and others play the same tables.

    Parameters
    ----------
    policy, scenes, config, episodes, seed, level, on_progress
        As for `evaluate_in_world`; each policy plays all the episodes.
    opponents
        Policies by their names.

    Raises
    ------
    ArgumentError
        A policy decides nothing about tables, or `episodes` is below 2.
    """
    layouts = pad_scenes(scenes)

    def play(one: Any, key: jax.Array, num: int) -> Totals:
        if not isinstance(one, Policy):
            raise ArgumentError(
                f"{type(one).__name__} decides nothing about tables, so there is no world to play it in"
            )
        return play_out(config, layouts, one, key, num)

    return _compared(policy, opponents, play, episodes, seed, level, on_progress)


def compare_teams(
    policy: TeamPolicy,
    opponents: Mapping[str, TeamPolicy],
    scenes: Sequence[Scene],
    world: TeamWorld,
    *,
    episodes: int = 10_000,
    seed: int = 0,
    level: float = 0.95,
    on_progress: Callable[[int], object] = lambda done: None,
) -> tuple[WorldEvaluation, tuple[WorldComparison, ...]]:
    """Let a policy of a team and others play the same tables; robot time is that of the table's clock.

    Parameters
    ----------
    policy, opponents, scenes, episodes, seed, level, on_progress
        As for `compare_in_world`.
    world
        Of the team.

    Raises
    ------
    ArgumentError
        `episodes` is below 2.
    PolicyError
        A policy is for another number of robots, or of their decisions.
    SceneError
        A scene does not tell where its objects stand.
    """
    layouts, config = world.team.layouts(scenes), world.team_config
    for each in (policy, *opponents.values()):
        check_fits(each, config)

    def play(one: TeamPolicy, key: jax.Array, num: int) -> Totals:
        return play_out_team(config, layouts, one, key, num)

    return _compared(policy, opponents, play, episodes, seed, level, on_progress)


def _compared(
    policy: Any,
    opponents: Mapping[str, Any],
    play: Play,
    episodes: int,
    seed: int,
    level: float,
    on_progress: Callable[[int], object],
) -> tuple[WorldEvaluation, tuple[WorldComparison, ...]]:
    check_level(level)
    if episodes < 2:
        raise ArgumentError(f"episodes is {episodes}; at least 2 are needed for an interval")
    ours, *theirs = (
        _played(partial(play, each), episodes, seed, on_progress) for each in (policy, *opponents.values())
    )
    means = [estimate_of(column, episodes, level) for column in ours]
    comparisons = (
        WorldComparison(name, estimate_of(other[0], episodes, level), estimate_of(ours[0] - other[0], episodes, level))
        for name, other in zip(opponents, theirs, strict=True)
    )
    return WorldEvaluation(*means, level=level), tuple(comparisons)


def _played(
    play: Callable[[jax.Array, int], Totals], episodes: int, seed: int, on_progress: Callable[[int], object]
) -> Float[np.ndarray, "3 episodes"]:
    """Reward, number of steps and robot time of each episode."""
    totals_of = []
    for chunk, start in enumerate(range(0, episodes, CHUNK_SIZE)):
        num = min(CHUNK_SIZE, episodes - start)
        key = jax.random.fold_in(jax.random.key(seed), chunk)
        totals = play(key, num)
        totals_of.append(
            [np.asarray(leaf, dtype=np.float64) for leaf in (totals.reward, totals.num_steps, totals.robot_s)]
        )
        on_progress(num)
    return np.concatenate(totals_of, axis=1)
