"""A team's table behind Gymnasium's interface: one agent decides for whichever robot is free."""

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

from halfseen.errors import ArgumentError
from halfseen.team.recording import TEAM_VERBS
from halfseen.team.table_in_play import TableInPlay
from halfseen.team.team import Team
from halfseen.world.action_space import TARGETED
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CAUSES
from halfseen.world.gymnasium_env import Observation
from halfseen.world.scene import Scene


class TeamCupsEnv(gymnasium.Env[Observation, np.int64]):
    """A table of half-hidden cups before several robots, as ``gymnasium.make("halfseen/TeamCups-v0")`` makes it.

    Each step is one decision of one robot, ``info["robot"]``: the one that is free. Actions are numbered as in
    `halfseen.world.action_space`, and WAIT comes last; ``info["action_mask"]`` tells which are possible for that robot.
    An attempt that is not possible closes on nothing: it fails, takes the limit of an attempt, and is paid like a
    missed grasp. A WAIT for nothing lasts as long as going home.

    The reward is all that falls until the next decision, whichever robot makes it. ``terminated`` is the table's own
    end: cleared, or every robot parked, dropped out or out of decisions. ``truncated`` is a cut from outside the task,
    which ends the table for all; the stage in progress is lost. A robot that drops out alone ends nothing:
    observations tell that it is out.

    An observation holds what one of `CupsEnv` holds, and decider (number of the robot that decides); for each robot
    is_busy, is_parked, is_out, verb (0 FINISH, 1 WASH, 2 LIFT, 3 WAIT), target, since_s and decisions_to_go; and
    is_in_reach (of row r, what robot r reaches) and is_near (pairs at which two robots cannot be at once). Where robots
    have laws of grasping of their own, attempt_robot tells who made each attempt.

    Parameters
    ----------
    scenes
        Where episodes begin, with `places_m`: one is drawn at each reset, or chosen by ``options={"scene": k}``. None
        for six cups.
    team
        The robots; None for two, left and right of the table.
    num_objects
        N, padding included; by default that of the largest scene.
    config
        The numbers of the world.
    cut_rate
        Rate of cuts [1/s].
    render_mode
        None, or ``"ansi"`` for a text.

    Raises
    ------
    SceneError
        There is no scene, one has more objects than `num_objects`, or does not tell where they stand.
    ArgumentError
        `cut_rate` is negative or not finite, or `render_mode` unknown.

    Examples
    --------
    >>> env = TeamCupsEnv()
    >>> observation, info = env.reset(seed=0)
    >>> info["robot"], int(info["action_mask"].sum())
    (0, 9)
    >>> observation, reward, terminated, truncated, info = env.step(1)  # robot 0 washes cup 0, robot 1 decides next
    >>> info["robot"], reward, info["elapsed_s"]
    (1, 0.0, 0.0)
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["ansi"], "render_fps": 1}

    def __init__(
        self,
        scenes: Scene | Sequence[Scene] | None = None,
        team: Team | None = None,
        num_objects: int | None = None,
        config: WorldConfig | None = None,
        cut_rate: float | int = 0.0,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, "ansi"):
            raise ArgumentError(f"render_mode is {render_mode!r}; it is None or 'ansi'")
        self.table = TableInPlay(scenes, team, num_objects, config, cut_rate)
        self.render_mode = render_mode
        self.action_space = spaces.Discrete(self.table.num_actions)
        self.observation_space: spaces.Space[Observation] = self.table.space()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Set a table.

        ``info["episode_seed"]`` is the integer s with which `halfseen.team.episodes.play` plays this very table, from
        ``jax.random.key(s)``.
        """
        super().reset(seed=seed)
        episode_seed = self.table.reset(self.np_random, options)
        return self.table.observation(), {**self._info(), "episode_seed": episode_seed}

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Let the robot that decides begin an action, unless a cut comes before the next decision.

        Raises
        ------
        ArgumentError
            The path is over or not begun, or there is no such action.
        """
        end = self.table.step(int(action))
        info = {**self._info(), "cause": CAUSES["independent"]} if end.is_cut else self._info()
        return self.table.observation(), end.reward, end.is_over, end.is_cut, info

    def render(self) -> str | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Write the table as text, a line a robot and one an object; None unless the mode is ``"ansi"``."""
        return None if self.render_mode is None else as_text(self.table)

    def _info(self) -> dict[str, Any]:
        table = self.table
        return {"elapsed_s": table.elapsed_s, "robot": table.decider, "action_mask": table.action_mask()}


def as_text(table: TableInPlay) -> str:
    """Write a table and what its robots are at, a line each."""
    seen = table.observation()
    lines = [f"robot {table.decider} decides, {table.elapsed_s:.1f} s"]
    for r, robot in enumerate(table.team.robots):
        lines.append(f"{robot.name}: {_does(seen, r)}, {seen['decisions_to_go'][r]} decisions to go")
    for i in np.flatnonzero(seen["is_object"]):
        dirty = 1.0 / (1.0 + np.exp(-seen["log_odds"][i]))
        where = f"hidden {seen['occlusion'][i]:.0%}" if seen["is_on_table"][i] else "in the dishwasher"
        lines.append(f"cup {i}: dirty {dirty:.0%}, {where}")
    return "\n".join(lines)


def _does(seen: Observation, robot: int) -> str:
    if not seen["is_busy"][robot]:
        return "out" if seen["is_out"][robot] else "parked" if seen["is_parked"][robot] else "free"
    verb = int(seen["verb"][robot])
    what = f" {seen['target'][robot]}" if verb in TARGETED else ""
    return f"{TEAM_VERBS[verb]}{what} for {seen['since_s'][robot]:.1f} s"
