"""A team's table as a PettingZoo environment of agents that act in turn (AEC), one agent per robot."""

from copy import deepcopy
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from pettingzoo import AECEnv

from halfseen.errors import ArgumentError
from halfseen.world.cuts import CAUSES, DROP_OUT_CAUSE
from halfseen.world.envs import Observation, TeamCupsEnv


class TeamCupsAEC(AECEnv[str, Observation, np.integer | int | None]):
    """A table of half-hidden cups before several robots: agents ``robot_0``, ``robot_1`` and so on.

    The selected agent is the robot that is free (of several, the lowest number). It begins its action, and time passes
    until the next decision. Every agent receives the table's reward until then, since they work as a team.

    An agent *terminates* with the table: cleared, or every robot parked, dropped out or out of decisions. A parked
    robot stays an agent until then and receives the same rewards, so that its return includes all effects of its
    FINISH. An agent is *truncated* if something outside the task ended it: its robot dropped out while the others go
    on, or a cut ended the table for all. ``infos[agent]["cause"]`` then gives the cause.

    An observation is a dictionary: ``"observation"``, as in `TeamCupsEnv` (decider is the agent's own robot), and
    ``"action_mask"``, also in the infos, which is 0 for an agent that is not selected.

    Parameters
    ----------
    scenes, team, num_objects, config, cut_rate, render_mode
        As in `TeamCupsEnv`.

    Raises
    ------
    SceneError
        There is no scene, or one has more objects than `num_objects` or lacks their places.
    ArgumentError
        `cut_rate` is negative or not finite, or `render_mode` is unknown.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": ["ansi"],
        "name": "halfseen_team_cups_v0",
        "is_parallelizable": False,
        "render_fps": 1,
    }

    def __init__(self, *settings: Any, **named: Any) -> None:
        super().__init__()
        self.table = TeamCupsEnv(*settings, **named)
        self.render_mode, self.agents = self.table.render_mode, []
        self.possible_agents = [f"robot_{r}" for r in range(self.table.config.num_robots)]
        mask = spaces.MultiBinary(self.table.num_actions)
        seen = spaces.Dict({"observation": self.table.observation_space, "action_mask": mask})
        # Copies, so that each agent's spaces can be seeded and sampled separately.
        self._spaces = {agent: deepcopy((seen, self.table.action_space)) for agent in self.possible_agents}

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Observation space of an agent."""
        return self._spaces[agent][0]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Action space of an agent: FINISH, WASH and LIFT of each object, WAIT."""
        return self._spaces[agent][1]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Set a table; ``infos[agent]["episode_seed"]`` is the seed with which `world.rollout.play` plays it."""
        episode_seed = self.table.reset(seed=seed, options=options)[1]["episode_seed"]
        self.agents = list(self.possible_agents)
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self._skip_agent_selection = None
        self.agent_selection = self.possible_agents[self.table.decider]
        self.infos = {agent: {**self.table.info(r), "episode_seed": episode_seed} for r, agent in self._all()}

    def observe(self, agent: str) -> Observation:
        """Return an agent's current observation."""
        robot = self.possible_agents.index(agent)
        return {"observation": self.table.observation(robot), "action_mask": self.table.action_mask(robot)}

    def step(self, action: np.integer | int | None) -> None:
        """Let the selected robot begin an action; for an agent that has ended, the action is None.

        Raises
        ------
        ArgumentError
            The trajectory is over or not begun, or there is no such action.
        """
        if not self.agents:
            raise ArgumentError("the trajectory is over or has not begun; call reset")
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            self._was_dead_step(action)
            return
        if action is None:
            raise ArgumentError(f"action of {agent} is None, but the agent is still active; give an action in its mask")
        self._cumulative_rewards[agent] = 0.0
        seen, reward, is_over, is_cut, _ = self.table.step(action)
        self.rewards = dict.fromkeys(self.agents, reward)
        is_out = seen["is_out"]
        for robot, each in self._all():
            self.infos[each] = self.table.info(robot)
            self.truncations[each] = is_cut or bool(is_out[robot])
            self.terminations[each] = is_over and not is_out[robot]
            if self.truncations[each]:
                self.infos[each]["cause"] = DROP_OUT_CAUSE if is_out[robot] else CAUSES["independent"]
        if not self.table.is_ended:
            self.agent_selection = self.possible_agents[self.table.decider]
        self._accumulate_rewards()
        self._deads_step_first()

    def render(self) -> str | None:
        """Render the table as text, one line per robot and object; None unless the mode is ``"ansi"``."""
        return self.table.render()

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def _all(self) -> list[tuple[int, str]]:
        """Active agents with the numbers of their robots."""
        return [(r, agent) for r, agent in enumerate(self.possible_agents) if agent in self.agents]
