"""The world behind one door: scenes and a policy in, logs out."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import jax
import numpy as np

from halfseen.errors import ArgumentError
from halfseen.logs import Logs
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CutEpisodes, CutKind, check_share, cut, cut_rate
from halfseen.world.episodes import play
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
        if episodes < 1:
            raise ArgumentError(f"episodes is {episodes}; simulate at least 1")
        check_share(cut_share)
        layouts = pad_scenes(scenes)
        pilot_key, play_key = jax.random.split(jax.random.key(seed))
        rate = 0.0
        if cut_share != 0.0:
            pilot = play(self.config, layouts, policy, pilot_key, NUM_PILOT_PATHS)
            rate = cut_rate(pilot, cut_share, cut_kind)
        played = play(self.config, layouts, policy, play_key, episodes)
        return cut(played, rate, cut_kind, np.random.default_rng(seed))
