"""The world behind one door: scenes and a policy in, logs out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import jax
import numpy as np
from jaxtyping import Array

from halfseen.errors import ArgumentError
from halfseen.logs import Logs
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CutEpisodes, CutKind, check_share, cut, cut_rate
from halfseen.world.episodes import Episodes, play
from halfseen.world.policy import Policy
from halfseen.world.recording import to_logs
from halfseen.world.scene import Scene
from halfseen.world.state import pad_scenes

NUM_PILOT_PATHS = 2000
"""Uncut paths on which the rate of cuts is calibrated."""


@dataclass(frozen=True)
class TableWorld:
    """Tables of half-hidden cups (design, §3).

    Parameters
    ----------
    config
        The numbers of the world.

    Examples
    --------
    >>> import numpy as np
    >>> from halfseen.world import Scene, TableWorld, UniformPolicy
    >>> scene = Scene(np.array([[0.0, 0.4], [0.0, 0.0]]))
    >>> logs = TableWorld().simulate(scene, UniformPolicy(), episodes=20, seed=0, cut_share=0.5)
    >>> logs.num_paths
    20
    """

    config: WorldConfig = field(default_factory=WorldConfig)

    def simulate(
        self,
        scenes: Scene | Sequence[Scene],
        policy: Policy,
        episodes: int,
        seed: int,
        cut_share: float | int = 0.0,
        cut_kind: CutKind | str = "independent",
    ) -> Logs:
        """Play episodes, cut some, and write down what was seen.

        Parameters
        ----------
        scenes
            Where episodes begin; episode k begins from scene k modulo their number.
        policy
            What decides.
        episodes
            Number of paths.
        seed
            Same seed, same logs.
        cut_share
            Share of the paths that is cut, in expectation, in [0, 1).
        cut_kind
            How the hazard of a cut behaves; see `halfseen.world.cuts`.

        Raises
        ------
        ArgumentError
            `episodes` is below 1 or `cut_share` outside [0, 1).
        """
        scenes = [scenes] if isinstance(scenes, Scene) else list(scenes)
        cuts = self.record(scenes, policy, episodes, seed, cut_share, cut_kind)
        return to_logs(cuts, cut_kind, scenes, self.config.dirty_share)

    def record(
        self,
        scenes: Sequence[Scene],
        policy: Policy,
        episodes: int,
        seed: int,
        cut_share: float | int = 0.0,
        cut_kind: CutKind | str = "independent",
    ) -> CutEpisodes:
        """Do as `simulate`, but keep the arrays as they are."""
        layouts = pad_scenes(scenes)
        return cut_at_share(
            lambda key, size: play(self.config, layouts, policy, key, size), episodes, seed, cut_share, cut_kind
        )


def cut_at_share(
    play_some: Callable[[Array, int], Episodes],
    episodes: int,
    seed: int,
    cut_share: float | int,
    cut_kind: CutKind | str,
    seen_by_cuts: Callable[[Episodes], Episodes] = lambda played: played,
) -> CutEpisodes:
    """Play episodes and cut a share of them, by a hazard that others, uncut, tell.

    Parameters
    ----------
    play_some
        Plays so many from a key.
    episodes, seed, cut_share, cut_kind
        As in `TableWorld.simulate`.
    seen_by_cuts
        The same episodes with the states that a cut looks at.

    Raises
    ------
    ArgumentError
        `episodes` is below 1 or `cut_share` outside [0, 1).
    """
    check_episodes(episodes)
    check_share(cut_share)
    pilot_key, play_key = jax.random.split(jax.random.key(seed))
    rate = 0.0
    if cut_share != 0.0:
        rate = cut_rate(seen_by_cuts(play_some(pilot_key, NUM_PILOT_PATHS)), cut_share, cut_kind)
    played = play_some(play_key, episodes)
    return replace(cut(seen_by_cuts(played), rate, cut_kind, np.random.default_rng(seed)), episodes=played)


def check_episodes(episodes: int) -> None:
    """Refuse to play none."""
    if episodes < 1:
        raise ArgumentError(f"episodes is {episodes}; simulate at least 1")
