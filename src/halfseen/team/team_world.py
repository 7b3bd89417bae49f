"""A team's world behind one door: scenes and a policy in, logs out."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import jax

from halfseen.logs import Logs
from halfseen.team.config import TeamConfig
from halfseen.team.episodes import TeamEpisodes, evaluate, play
from halfseen.team.fit import check_fits
from halfseen.team.policy import TeamPolicy
from halfseen.team.recording import DROP_OUT_CAUSE, to_logs
from halfseen.team.robots import CLEARANCE_M, Robot
from halfseen.team.team import Team
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CutEpisodes, CutKind
from halfseen.world.episodes import Episodes, Totals
from halfseen.world.scene import Scene
from halfseen.world.table_world import check_episodes, cut_at_share


@dataclass(frozen=True)
class TeamWorld:
    """Tables of half-hidden cups before several robots (design, §9).

    Parameters
    ----------
    config
        The numbers of the world; its horizon is counted in decisions of each robot.
    robots
        The team, robot 0 first.
    clearance_m
        Objects nearer than that are too near for two robots at once [m].
    reward_per_s
        Price of each second of the table's clock; 0 or below [1/s].

    Examples
    --------
    >>> import numpy as np
    >>> from halfseen.team import Robot, TeamWorld, UniformTeam
    >>> from halfseen.world import Scene
    >>> scene = Scene(np.array([[0.0, 0.4], [0.0, 0.0]]), places_m=np.array([[-0.2, 0.0], [0.2, 0.0]]))
    >>> world = TeamWorld(robots=[Robot((-0.6, 0.0), 0.9), Robot((0.6, 0.0), 0.9)])
    >>> logs = world.simulate(scene, UniformTeam(), episodes=20, seed=0, cut_share=0.5)
    >>> sorted(logs.stages["robot"].unique().tolist())
    [0, 1]
    """

    config: WorldConfig = field(default_factory=WorldConfig)
    robots: Sequence[Robot] = ()
    clearance_m: float | int = CLEARANCE_M
    reward_per_s: float | int = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "robots", self.team.robots)

    @classmethod
    def of(cls, team: Team, config: WorldConfig | None = None) -> "TeamWorld":
        """World of a team, such as `read_team` gives."""
        world = WorldConfig() if config is None else config
        return cls(world, team.robots, team.clearance_m, team.reward_per_s)

    @property
    def team(self) -> Team:
        """The robots, how near two may work, and what seconds cost."""
        return Team(tuple(self.robots), self.clearance_m, self.reward_per_s)

    @property
    def team_config(self) -> TeamConfig:
        """The numbers of the team in its world."""
        return self.team.config(self.config)

    def simulate(
        self,
        scenes: Scene | Sequence[Scene],
        policy: TeamPolicy,
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
            Where episodes begin, with `places_m`; episode k begins from scene k modulo their number.
        policy
            What decides for the robot that is free.
        episodes
            Number of paths.
        seed
            Same seed, same logs.
        cut_share
            Share of the paths that is cut, in expectation, in [0, 1).
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
            A scene does not tell where its objects stand.
        """
        scenes = [scenes] if isinstance(scenes, Scene) else list(scenes)
        cuts = self.record(scenes, policy, episodes, seed, cut_share, cut_kind)
        return to_logs(cuts, cut_kind, scenes, self.config.dirty_share, drop_out_cause)

    def record(
        self,
        scenes: Sequence[Scene],
        policy: TeamPolicy,
        episodes: int,
        seed: int,
        cut_share: float | int = 0.0,
        cut_kind: CutKind | str = "independent",
    ) -> CutEpisodes:
        """Do as `simulate`, but keep the arrays as they are."""
        config, layouts = self.team_config, self.team.layouts(scenes)
        check_fits(policy, config)
        return cut_at_share(
            lambda key, size: play(config, layouts, policy, key, size), episodes, seed, cut_share, cut_kind, _of_tables
        )

    def evaluate(self, scenes: Scene | Sequence[Scene], policy: TeamPolicy, episodes: int, seed: int) -> Totals:
        """Play episodes to their end and tell what each earned, by the time the table took; see `simulate`."""
        check_episodes(episodes)
        scenes = [scenes] if isinstance(scenes, Scene) else list(scenes)
        config, layouts = self.team_config, self.team.layouts(scenes)
        check_fits(policy, config)
        return evaluate(config, layouts, policy, jax.random.key(seed), episodes)


def _of_tables(played: TeamEpisodes) -> Episodes:
    """The same episodes, of whose states a cut sees the table alone."""
    return replace(played, states=played.states.table)
