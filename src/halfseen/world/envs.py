"""The table world behind Gymnasium's interface, for agents that learn while they act; one robot or several."""

from collections.abc import Sequence
from functools import partial
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

from halfseen.errors import ArgumentError
from halfseen.world.actions import WAIT
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CAUSES
from halfseen.world.robots import Team
from halfseen.world.scene import Scene
from halfseen.world.seeing import KnownSeeing, is_independent, label_evidence
from halfseen.world.table_in_play import Observation, TableInPlay, default_team

_ROUNDED = 1e-5


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
        Rate of cuts [1/s]; `halfseen.world.cuts.cut_rate` finds the one that cuts a wanted share of a policy's paths.
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
        self._set_up(TableInPlay(scenes, None, num_objects, config, cut_rate), render_mode)

    def _set_up(self, table: TableInPlay, render_mode: str | None) -> None:
        check_render_mode(render_mode)
        self.table, self.render_mode = table, render_mode
        self.action_space = spaces.Discrete(table.num_actions)
        self.observation_space: spaces.Space[Observation] = observation_space(table)

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
            The path is over or not begun, or there is no such action.
        """
        end = self.table.step(action)
        info = {**self._info(), "cause": CAUSES["independent"]} if end.is_cut else self._info()
        return self.table.observation(), end.reward, end.is_over, end.is_cut, info

    def render(self) -> str | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Write the table as text, a line a robot and one an object; None unless the mode is ``"ansi"``."""
        return None if self.render_mode is None else self.table.as_text()

    def _info(self) -> dict[str, Any]:
        return {"elapsed_s": self.table.elapsed_s, "action_mask": self.table.action_mask()}


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
        self._set_up(
            TableInPlay(scenes, default_team() if team is None else team, num_objects, config, cut_rate), render_mode
        )

    def _info(self) -> dict[str, Any]:
        return {**super()._info(), "robot": self.table.decider}


def check_render_mode(render_mode: str | None) -> None:
    """Refuse a way to render that there is not."""
    if render_mode not in (None, "ansi"):
        raise ArgumentError(f"render_mode is {render_mode!r}; it is None or 'ansi'")


def observation_space(table: TableInPlay) -> spaces.Space[Observation]:
    """Space of `TableInPlay.observation`."""
    return spaces.Dict(_table_spaces(table) | ({} if table.team is None else _robot_spaces(table)))


def _table_spaces(table: TableInPlay) -> dict[str, Any]:
    num_objects, horizon, config = table.num_objects, table.config.num_stages, table.config
    share = partial(spaces.Box, 0.0, 1.0, dtype=np.float32)
    count = partial(spaces.Box, 0, horizon, dtype=np.int32)
    bound, firmest = _largest_log_odds(config, horizon), float(np.nanmax(np.abs(table.layouts.grip), initial=1.0))
    return {
        "is_object": spaces.MultiBinary(num_objects),
        "is_on_table": spaces.MultiBinary(num_objects),
        "occlusion": share((num_objects,)),
        "grip": spaces.Box(-firmest, firmest, (num_objects,), dtype=np.float32),
        "log_odds": spaces.Box(-bound, bound, (num_objects,), dtype=np.float32),
        "seen": share((num_objects,)),
        "successes": count((num_objects,)),
        "failures": count((num_objects,)),
        "lifts": count((num_objects,)),
        "hides": share((num_objects, num_objects)),
        "attempt_object": spaces.Box(-1, num_objects - 1, (horizon,), dtype=np.int32),
        "attempt_occlusion": share((horizon,)),
        "attempt_succeeded": spaces.MultiBinary(horizon),
        "steps_to_go": count((1,)),
    }


def _robot_spaces(table: TableInPlay) -> dict[str, Any]:
    config, num_robots, num_objects = table.config, table.config.num_robots, table.num_objects
    by_robot = {"attempt_robot": spaces.Box(0, num_robots - 1, (config.num_stages,), dtype=np.int32)}
    return {
        "decider": spaces.Box(0, num_robots - 1, (1,), dtype=np.int32),
        "is_busy": spaces.MultiBinary(num_robots),
        "is_parked": spaces.MultiBinary(num_robots),
        "is_out": spaces.MultiBinary(num_robots),
        "verb": spaces.Box(0, WAIT, (num_robots,), dtype=np.int32),
        "target": spaces.Box(0, num_objects - 1, (num_robots,), dtype=np.int32),
        "since_s": spaces.Box(0.0, _longest_s(config), (num_robots,), dtype=np.float32),
        "decisions_to_go": spaces.Box(0, config.horizon, (num_robots,), dtype=np.int32),
        "is_in_reach": spaces.MultiBinary((num_robots, num_objects)),
        "is_near": spaces.MultiBinary((num_objects, num_objects)),
        **(by_robot if config.has_own_laws else {}),
    }


def _longest_s(config: WorldConfig) -> float:
    """Bound on what a robot may be at: the longest attempt of one, or a wait for it [s]."""
    worlds = (config.as_robot(robot) for robot in range(config.num_robots))
    longest_s = (float(world.grasping.limit_s + world.transport_s) for world in worlds)
    bound_s = np.ceil(max(each / float(speed) for each, speed in zip(longest_s, config.speed, strict=True)))
    # Seconds are added up event by event, and rounded.
    return float(bound_s * (1.0 + _ROUNDED))


def _largest_log_odds(config: WorldConfig, num_looks: int) -> float:
    """Bound on |log-odds|: the prior's, and as many labels as there are, each the surest that a label can be.

    There is none where it is not known how sure a label can be, or labels are not independent.
    """
    if not (isinstance(config.seeing, KnownSeeing) and is_independent(config.seeing)):
        return np.inf
    in_full_view = config.seeing.positive(0.0, 0.0)
    surest = max(abs(label_evidence(*in_full_view, says_dirty)) for says_dirty in (False, True))
    prior = np.abs(np.log(config.dirty_share) - np.log1p(-config.dirty_share))
    return float(np.ceil(prior + (num_looks + 1) * surest))
