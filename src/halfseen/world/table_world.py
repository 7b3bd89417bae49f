"""The world behind one door: scenes and a policy in, logs out; for one robot, or several at one table."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.logs import Logs
from halfseen.world import random
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import DROP_OUT_CAUSE, CutEpisodes, CutKind, check_share, cut, cut_rate
from halfseen.world.logs import to_logs
from halfseen.world.policy import Policy, check_fits
from halfseen.world.robots import CLEARANCE_M, Robot, Team
from halfseen.world.rollout import Totals, evaluate, play
from halfseen.world.scene import Scene
from halfseen.world.state import Layout, pad_scenes

NUM_PILOT_TRAJECTORIES = 2000
"""Uncut trajectories on which the rate of cuts is calibrated."""


@dataclass(frozen=True)
class TableWorld:
    """Tables of half-hidden cups (design, §3), before several robots where there are any (§9).

    Parameters
    ----------
    config
        The numbers of the world; its horizon is counted in decisions of each robot.
    robots
        Who works at the table, robot 0 first; empty for one robot that reaches everything.
    clearance_m
        Objects nearer than that are too near for two robots at once [m].
    reward_per_s
        Price of each second of the table's clock; 0 or below [1/s].

    Raises
    ------
    ArgumentError
        What is given of the robots is what no team has.

    Examples
    --------
    >>> import numpy as np
    >>> from halfseen.world import Robot, Scene, TableWorld, UniformPolicy
    >>> scene = Scene(np.array([[0.0, 0.4], [0.0, 0.0]]), places_m=np.array([[-0.2, 0.0], [0.2, 0.0]]))
    >>> logs = TableWorld().simulate(scene, UniformPolicy(), episodes=20, seed=0, cut_share=0.5)
    >>> logs.num_trajectories
    20
    >>> world = TableWorld(robots=[Robot((-0.6, 0.0), 0.9), Robot((0.6, 0.0), 0.9)])
    >>> logs = world.simulate(scene, UniformPolicy(), episodes=20, seed=0, cut_share=0.5)
    >>> sorted(logs.stages["robot"].unique().tolist())
    [0, 1]
    """

    config: WorldConfig = field(default_factory=WorldConfig)
    robots: Sequence[Robot] = ()
    clearance_m: float | int = CLEARANCE_M
    reward_per_s: float | int = 0.0

    def __post_init__(self) -> None:
        # A team that cannot be is refused here, not where it is first asked for.
        _ = self.team

    @classmethod
    def of(cls, team: Team | None, config: WorldConfig | None = None) -> "TableWorld":
        """World of a team; None for one robot that reaches everything."""
        config = WorldConfig() if config is None else config
        return cls(config) if team is None else cls(config, team.robots, team.clearance_m, team.reward_per_s)

    @property
    def team(self) -> Team | None:
        """The robots, how near two may work, and what seconds cost; None for one that reaches everything."""
        return Team(tuple(self.robots), self.clearance_m, self.reward_per_s) if len(self.robots) else None

    @property
    def played_config(self) -> WorldConfig:
        """The numbers of the world with those of its robots."""
        return self.config if self.team is None else self.team.config(self.config)

    def layouts(self, scenes: Sequence[Scene], num_objects: int | None = None) -> Layout:
        """Set scenes before the robots, padded to a common number of objects.

        Raises
        ------
        SceneError
            There is no scene, one has no object, or more than `num_objects`; or does not tell several robots where
            they stand.
        """
        return pad_scenes(scenes, num_objects) if self.team is None else self.team.layouts(scenes, num_objects)

    def simulate(
        self,
        scenes: Scene | Sequence[Scene],
        policy: Policy,
        episodes: int,
        seed: int,
        cut_share: float | int = 0.0,
        cut_kind: CutKind | str = "independent",
        drop_out_cause: str = DROP_OUT_CAUSE,
    ) -> Logs:
        """Play episodes, cut some, and write down what was seen; one cut ends the table for all robots.

        Parameters
        ----------
        scenes
            Where episodes begin, for a team with `places_m`; episode k begins from scene k modulo their number.
        policy
            What decides, for the robot that is free where there are several.
        episodes
            Number of trajectories.
        seed
            Same seed, same logs.
        cut_share
            Share of the trajectories that is cut, in expectation, in [0, 1).
        cut_kind
            How the hazard of a cut behaves; see `halfseen.world.cuts`.
        drop_out_cause
            What it is called when a robot drops out alone.

        Raises
        ------
        ArgumentError
            `episodes` is below 1 or `cut_share` outside [0, 1).
        PolicyError
            The policy is one for another number of robots.
        SceneError
            A scene does not tell several robots where its objects stand.
        """
        scenes = _as_list(scenes)
        cuts = self.record(scenes, policy, episodes, seed, cut_share, cut_kind)
        return to_logs(cuts, cut_kind, scenes, self.config.dirty_share, drop_out_cause)

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
        config, layouts = self.played_config, self._checked(scenes, policy, episodes)
        check_share(cut_share)
        pilot_key, play_key = random.split(random.key_of(seed))
        rate = 0.0
        if cut_share != 0.0:
            rate = cut_rate(play(config, layouts, policy, pilot_key, NUM_PILOT_TRAJECTORIES), cut_share, cut_kind)
        played = play(config, layouts, policy, play_key, episodes)
        return cut(played, rate, cut_kind, np.random.default_rng(seed))

    def evaluate(self, scenes: Scene | Sequence[Scene], policy: Policy, episodes: int, seed: int) -> Totals:
        """Play episodes to their end and tell what each earned, by the time the table took; see `simulate`."""
        layouts = self._checked(_as_list(scenes), policy, episodes)
        return evaluate(self.played_config, layouts, policy, random.key_of(seed), episodes)

    def _checked(self, scenes: Sequence[Scene], policy: Policy, episodes: int) -> Layout:
        if episodes < 1:
            raise ArgumentError(f"episodes is {episodes}; simulate at least 1")
        layouts = self.layouts(scenes)
        if self.team is not None:
            check_fits(policy, self.played_config)
        return layouts


def _as_list(scenes: Scene | Sequence[Scene]) -> list[Scene]:
    return [scenes] if isinstance(scenes, Scene) else list(scenes)
