"""A team's table behind PettingZoo's interface of agents that act in turn (AEC): an agent a robot."""

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from pettingzoo import AECEnv

from halfseen.errors import ArgumentError
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CAUSES
from halfseen.world.envs import check_render_mode, observation_space
from halfseen.world.robot_logs import DROP_OUT_CAUSE
from halfseen.world.robots import Team
from halfseen.world.scene import Scene
from halfseen.world.table_in_play import Observation, StageEnd, TableInPlay, default_team


class TeamCupsAEC(AECEnv[str, Observation, np.integer | int | None]):
    """A table of half-hidden cups before several robots: agents ``robot_0``, ``robot_1`` and so on.

    The agent that is selected is the robot that is free (of several, the lowest number); it begins its action, and time
    passes until the next decision. All that is paid until then is the reward of every agent: they work for one table.

    An agent *terminates* with the table: cleared, or every robot parked, dropped out or out of decisions. A robot that
    has parked stays an agent until then, and is paid as the others are, so that all that its FINISH led to is in its
    return. An agent is *truncated* where something outside the task ended it: when its robot drops out alone, while the
    others go on, or when a cut ends the table for all. ``infos[agent]["cause"]`` then tells why.

    An observation is a dictionary: ``"observation"``, as of `TeamCupsEnv` (decider is the agent's own robot), and
    ``"action_mask"``, which stands in the infos, too; of an agent that is not selected it is 0.

    Parameters
    ----------
    scenes, team, num_objects, config, cut_rate, render_mode
        As of `TeamCupsEnv`.

    Raises
    ------
    SceneError
        There is no scene, one has more objects than `num_objects`, or does not tell where they stand.
    ArgumentError
        `cut_rate` is negative or not finite, or `render_mode` unknown.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": ["ansi"],
        "name": "halfseen_team_cups_v0",
        "is_parallelizable": False,
        "render_fps": 1,
    }

    def __init__(
        self,
        scenes: Scene | Sequence[Scene] | None = None,
        team: Team | None = None,
        num_objects: int | None = None,
        config: WorldConfig | None = None,
        cut_rate: float | int = 0.0,
        render_mode: str | None = None,
    ) -> None:
        super().__init__()
        check_render_mode(render_mode)
        self.table = TableInPlay(scenes, default_team() if team is None else team, num_objects, config, cut_rate)
        self.render_mode = render_mode
        self.possible_agents = [f"robot_{r}" for r in range(self.table.config.num_robots)]
        self.agents = []
        mask = spaces.MultiBinary(self.table.num_actions)
        self._observation_spaces: dict[str, spaces.Space[Observation]] = {
            agent: spaces.Dict({"observation": observation_space(self.table), "action_mask": mask})
            for agent in self.possible_agents
        }
        self._action_spaces = {agent: spaces.Discrete(self.table.num_actions) for agent in self.possible_agents}
        self._rng: np.random.Generator | None = None

    def observation_space(self, agent: str) -> spaces.Space[Observation]:
        """Space of an agent's observations."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Space of an agent's actions: FINISH, WASH and LIFT of each object, WAIT."""
        return self._action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Set a table; ``infos[agent]["episode_seed"]`` is the seed with which `world.rollout.play` plays it."""
        if seed is not None or self._rng is None:
            self._rng, _ = seeding.np_random(seed)
        episode_seed = self.table.reset(self._rng, options)
        self.agents = list(self.possible_agents)
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self._skip_agent_selection = None
        self.agent_selection = self.possible_agents[self.table.decider]
        self.infos = {agent: {**self._info(agent), "episode_seed": episode_seed} for agent in self.agents}

    def observe(self, agent: str) -> Observation:
        """Give what an agent sees now."""
        robot = self.possible_agents.index(agent)
        return {"observation": self.table.observation(robot), "action_mask": self.table.action_mask(robot)}

    def step(self, action: np.integer | int | None) -> None:
        """Let the selected robot begin an action; of an agent that has ended, the action is None.

        Raises
        ------
        ArgumentError
            The path is over or not begun, or there is no such action.
        """
        if not self.agents:
            raise ArgumentError("the path is over or has not begun; call reset")
        if self.terminations[self.agent_selection] or self.truncations[self.agent_selection]:
            self._was_dead_step(action)
            return
        if action is None:
            raise ArgumentError(f"action of {self.agent_selection} is None, and it goes on; give one in its mask")
        self._cumulative_rewards[self.agent_selection] = 0.0
        end = self.table.step(action)
        self.rewards = dict.fromkeys(self.agents, end.reward)
        self.infos = {agent: self._info(agent) for agent in self.agents}
        self._end_agents(end)
        if not self.table.is_ended:
            self.agent_selection = self.possible_agents[self.table.decider]
        self._accumulate_rewards()
        self._deads_step_first()

    def _end_agents(self, end: StageEnd) -> None:
        is_out = self.table.observation()["is_out"]
        for agent in self.agents:
            dropped_out = bool(is_out[self.possible_agents.index(agent)])
            self.truncations[agent] = end.is_cut or dropped_out
            self.terminations[agent] = end.is_over and not dropped_out
            if self.truncations[agent]:
                self.infos[agent]["cause"] = DROP_OUT_CAUSE if dropped_out else CAUSES["independent"]

    def render(self) -> str | None:
        """Write the table as text, a line a robot and one an object; None unless the mode is ``"ansi"``."""
        return None if self.render_mode is None else self.table.as_text()

    def close(self) -> None:
        """There is nothing to close."""

    def _info(self, agent: str) -> dict[str, Any]:
        robot = self.possible_agents.index(agent)
        return {"elapsed_s": self.table.elapsed_s, "action_mask": self.table.action_mask(robot)}
