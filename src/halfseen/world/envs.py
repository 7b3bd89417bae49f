"""The table world behind Gymnasium's interface, for agents that learn while they act; one robot or several."""

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CAUSES
from halfseen.world.robots import Team
from halfseen.world.scene import Scene
from halfseen.world.table_in_play import Observation, TableInPlay, default_team


class CupsEnv(gymnasium.Env[Observation, np.int64]):
    """A table of half-hidden cups (design, §3), as ``gymnasium.make("halfseen/Cups-v0")`` makes it.

    Actions are numbered as in `halfseen.world.actions`; ``info["action_mask"]`` tells which are possible. One that
    is not possible (the object is in the dishwasher, or padding) is an attempt that closes on nothing: it fails, takes
    the limit of an attempt, and is paid like a missed grasp.

    ``terminated`` is the table's own end: FINISH, cleared, or the horizon. ``truncated`` is a cut from outside the
    task: the stage in progress is lost, so the reward is 0, S_t stays, and ``info`` gives the clock of the cut and its
    cause. They never come together, as a stage that ends at the very moment of a cut is completed.

    An observation holds S_t: for each object is_object, is_on_table (else in the dishwasher), occlusion, grip (mean of
    its grip offset), log_odds (of DIRTY), seen (share of its surface that labels have told of), successes, failures and
    lifts; hides (of row i, the share that each object hides alone); the attempts in the order of the steps (object or
    -1, occlusion, succeeded); and steps_to_go. Padding reads 0.

    Parameters
    ----------
    scenes
        Where episodes begin: one is drawn at each reset, or chosen by ``options={"scene": k}``. None for
        `default_scene`.
    num_objects
        N, padding included; by default that of the largest scene.
    config
        The numbers of the world.
    cut_rate
        Rate of cuts [1/s]; `halfseen.world.cuts.cut_rate` finds the one that cuts a wanted share of a policy's
        trajectories.
    render_mode
        None, or ``"ansi"`` for a text.

    Raises
    ------
    SceneError
        There is no scene, or one has more objects than `num_objects`.
    ArgumentError
        `cut_rate` is negative or not finite, or `render_mode` unknown.

    Examples
    --------
    >>> env = CupsEnv()
    >>> observation, info = env.reset(seed=0)
    >>> observation["occlusion"].round(2)
    array([0.  , 0.  , 0.  , 0.51, 0.51, 0.15], dtype=float32)
    >>> int(info["action_mask"].sum())
    13
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["ansi"], "render_fps": 1}

    def __init__(
        self,
        scenes: Scene | Sequence[Scene] | None = None,
        num_objects: int | None = None,
        config: WorldConfig | None = None,
        cut_rate: float | int = 0.0,
        render_mode: str | None = None,
    ) -> None:
        self._play(TableInPlay(scenes, None, num_objects, config, cut_rate, render_mode))

    def _play(self, table: TableInPlay) -> None:
        self.table, self.render_mode = table, table.render_mode
        self.action_space = spaces.Discrete(table.num_actions)
        self.observation_space: spaces.Space[Observation] = table.observation_space()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Set a table.

        ``info["episode_seed"]`` is the integer s with which `halfseen.world.rollout.play` plays this very table, from
        ``halfseen.world.random.key_of(s)``.
        """
        super().reset(seed=seed)
        episode_seed = self.table.reset(self.np_random, options)
        return self.table.observation(), {**self._info(), "episode_seed": episode_seed}

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Let the robot that decides begin an action, unless a cut comes before the next decision.

        Raises
        ------
        ArgumentError
            The trajectory is over or not begun, or there is no such action.
        """
        table, reward = self.table, self.table.step(action)
        info = {**self._info(), "cause": CAUSES["independent"]} if table.is_cut else self._info()
        return table.observation(), reward, table.is_over, table.is_cut, info

    def render(self) -> str | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Write the table as text, a line a robot and one an object; None unless the mode is ``"ansi"``."""
        return self.table.as_text()

    def _info(self) -> dict[str, Any]:
        return self.table.info()


class TeamCupsEnv(CupsEnv):
    """A table of half-hidden cups before several robots, as ``gymnasium.make("halfseen/TeamCups-v0")`` makes it.

    Each step is one decision of one robot, ``info["robot"]``: the one that is free. Actions are numbered as in
    `halfseen.world.actions`, and WAIT comes last; ``info["action_mask"]`` tells which are possible for that robot.
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

    def __init__(
        self,
        scenes: Scene | Sequence[Scene] | None = None,
        team: Team | None = None,
        num_objects: int | None = None,
        config: WorldConfig | None = None,
        cut_rate: float | int = 0.0,
        render_mode: str | None = None,
    ) -> None:
        robots = default_team() if team is None else team
        self._play(TableInPlay(scenes, robots, num_objects, config, cut_rate, render_mode))

    def _info(self) -> dict[str, Any]:
        return {**self.table.info(), "robot": self.table.decider}
