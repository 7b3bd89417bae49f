"""The main interface of the world: simulate scenes under a policy into logs, for one robot or several."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.logs import Logs
from halfseen.world import random
from halfseen.world.config import WorldConfig, is_whole
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
    """Tables of half-hidden cups (design, §3), optionally with a team of robots (§9).

    Parameters
    ----------
    config
        Parameters of the world; its horizon counts the decisions of each robot.
    robots
        Robots at the table, robot 0 first; empty for one robot that reaches everything.
    clearance_m
        Distance below which two objects are too near for two robots at once [m].
    reward_per_s
        Price of each second of the table's clock; 0 or below [1/s].

    Raises
    ------
    ArgumentError
        The parameters of the robots are invalid; see `Team`.

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
        # Check an invalid team here, not on its first use.
        _ = self.team

    @classmethod
    def of(cls, team: Team | None, config: WorldConfig | None = None) -> "TableWorld":
        """World of a team; a team of None is one robot that reaches everything."""
        config = WorldConfig() if config is None else config
        return cls(config) if team is None else cls(config, team.robots, team.clearance_m, team.reward_per_s)

    @property
    def team(self) -> Team | None:
        """The robots, their clearance and the price of time; None for one robot that reaches everything."""
        return Team(tuple(self.robots), self.clearance_m, self.reward_per_s) if len(self.robots) else None

    @property
    def played_config(self) -> WorldConfig:
        """Parameters of the world with those of its robots."""
        return self.config if self.team is None else self.team.config(self.config)

    def layouts(self, scenes: Sequence[Scene], num_objects: int | None = None) -> Layout:
        """Lay out scenes before the robots, padded to a common number of objects.

        Raises
        ------
        SceneError
            There is no scene; or one has no object, more than `num_objects`, or, for a team, no places.
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
        """Play episodes, cut some, and return the logs; a cut ends the table for all robots.

        Parameters
        ----------
        scenes
            Initial scenes, for a team with `places_m`; episode k begins from scene k modulo their number.
        policy
            Policy that decides; in a team, for the robot that is free.
        episodes
            Number of trajectories.
        seed
            Random seed; the same seed gives the same logs.
        cut_share
            Expected share of trajectories that are cut, in [0, 1).
        cut_kind
            Kind of hazard of a cut; see `halfseen.world.cuts`.
        drop_out_cause
            Cause recorded when a robot drops out alone.

        Raises
        ------
        ArgumentError
            `episodes` or `seed` is not a whole number, or too small; `cut_share` is outside [0, 1); `policy` does not
            decide; or the prior is certain, whose log-odds no log can hold.
        PolicyError
            The policy is for another number of robots.
        SceneError
            A scene for a team lacks the places of its objects.
        """
        scenes, share = _as_list(scenes), self.config.dirty_share
        if not 0.0 < share < 1.0:
            raise ArgumentError(f"dirty_share is {share}, whose log-odds no log can hold; give one between 0 and 1")
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
        """Simulate as in `simulate`, but return arrays instead of logs."""
        config, layouts = self.played_config, self._checked(scenes, policy, episodes, seed)
        check_share(cut_share)
        pilot_key, play_key = random.split(random.key_of(seed))
        rate = 0.0
        if cut_share != 0.0:
            rate = cut_rate(play(config, layouts, policy, pilot_key, NUM_PILOT_TRAJECTORIES), cut_share, cut_kind)
        played = play(config, layouts, policy, play_key, episodes)
        return cut(played, rate, cut_kind, np.random.default_rng(seed))

    def evaluate(self, scenes: Scene | Sequence[Scene], policy: Policy, episodes: int, seed: int) -> Totals:
        """Play episodes to their end and return the reward, duration and steps of each; see `simulate`."""
        layouts = self._checked(_as_list(scenes), policy, episodes, seed)
        return evaluate(self.played_config, layouts, policy, random.key_of(seed), episodes)

    def _checked(self, scenes: Sequence[Scene], policy: Policy, episodes: int, seed: int) -> Layout:
        if not is_whole(episodes, 1):
            raise ArgumentError(f"episodes is {episodes!r}; give a whole number, at least 1")
        if not is_whole(seed, 0):
            raise ArgumentError(f"seed is {seed!r}; give a whole number, at least 0")
        if not isinstance(policy, Policy):
            raise ArgumentError(f"policy is a {type(policy).__name__}; give one that decides, such as UniformPolicy()")
        layouts = self.layouts(scenes)
        if self.team is not None:
            check_fits(policy, self.played_config)
        return layouts


def _as_list(scenes: Scene | Sequence[Scene]) -> list[Scene]:
    return [scenes] if isinstance(scenes, Scene) else list(scenes)
