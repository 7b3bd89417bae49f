"""The table world as a Gymnasium environment, for online learning; one robot or several."""

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

from halfseen.arrays import expit, mapped
from halfseen.errors import ArgumentError
from halfseen.shapes import Int
from halfseen.world import random
from halfseen.world.actions import TARGETED, VERB_NAMES, WAIT, possible_actions
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CAUSES
from halfseen.world.robots import Robot, Team
from halfseen.world.scene import Scene
from halfseen.world.seeing import KnownSeeing, is_independent, label_evidence
from halfseen.world.state import Layout, TableState, attempt_counts, initial_state, occlusion
from halfseen.world.table_world import TableWorld
from halfseen.world.transition import start, step

Observation = dict[str, Any]
"""Arrays by name; see `CupsEnv`."""
_OF_TABLE = ("is_object", "is_on_table", "grip", "seen", "lifts", "hides")
_OF_TABLE += ("attempt_object", "attempt_occlusion", "attempt_succeeded")


def observed(config: WorldConfig, state: TableState, robot: int | None = None) -> Observation:
    """S_t of one table as arrays, as seen by the deciding robot or by `robot`; padding and idle robots read 0."""
    successes, failures = attempt_counts(state)
    seen = {name: getattr(state, name) for name in _OF_TABLE}
    seen |= {
        "occlusion": occlusion(state),
        "log_odds": np.where(state.is_object, state.log_odds, np.float32(0.0)),
        "successes": successes.astype(np.int32),
        "failures": failures.astype(np.int32),
        "steps_to_go": np.asarray(state.steps_to_go)[None],
    }
    robots, space, decider = state.robots, state.workspace, state.decider
    if robots is not None and space is not None and decider is not None:
        at_work = {name: getattr(robots, name) for name in ("verb", "target", "since_s")}
        seen |= {name: np.where(robots.is_busy, each, 0).astype(each.dtype) for name, each in at_work.items()}
        seen |= {
            "decider": np.array([decider if robot is None else robot], dtype=np.int32),
            "is_busy": robots.is_busy,
            "is_parked": robots.is_parked,
            "is_out": np.zeros_like(robots.is_busy) if robots.is_out is None else robots.is_out,
            "decisions_to_go": robots.decisions_to_go,
            "is_in_reach": space.is_in_reach,
            "is_near": space.is_near,
            **({"attempt_robot": state.attempt_robot} if config.has_own_laws else {}),
        }
    return {name: each.astype(np.int8) if each.dtype == bool else each for name, each in seen.items()}


def space_of(config: WorldConfig, layouts: Layout) -> spaces.Space[Observation]:
    """Observation space of some tables: shapes, types and bounds."""
    example = observed(config, initial_state(config, mapped(lambda leaf: leaf[0], layouts)))
    firmest, surest = float(np.nanmax(np.abs(layouts.grip), initial=1.0)), _largest_log_odds(config)
    worlds = (config.as_robot(robot) for robot in range(config.num_robots))
    longest_s = (float(world.grasping.limit_s + world.transport_s) for world in worlds)
    bound_s = np.ceil(max(each / float(speed) for each, speed in zip(longest_s, config.speed, strict=True)))
    last_object, last_robot = layouts.is_object.shape[-1] - 1, config.num_robots - 1
    usual: dict[Any, tuple[Any, Any]] = {np.float32: (0.0, 1.0), np.int32: (0, config.num_stages)}
    bounds: dict[str, tuple[Any, Any]] = {
        "grip": (-firmest, firmest),
        "log_odds": (-surest, surest),
        "attempt_object": (-1, last_object),
        "decider": (0, last_robot),
        "verb": (0, WAIT),
        "target": (0, last_object),
        # Longest attempt, or a wait for it; seconds are added up event by event, with rounding errors.
        "since_s": (0.0, float(bound_s * (1.0 + 1e-5))),
        "decisions_to_go": (0, config.horizon),
        "attempt_robot": (0, last_robot),
    }

    def space(name: str, value: np.ndarray) -> spaces.Space[Any]:
        if value.dtype == np.int8:
            return spaces.MultiBinary(value.shape if value.ndim > 1 else len(value))
        low, high = bounds.get(name, usual[value.dtype.type])
        return spaces.Box(low, high, value.shape, dtype=value.dtype.type)

    return spaces.Dict({name: space(name, value) for name, value in example.items()})


def _largest_log_odds(config: WorldConfig) -> float:
    """Bound on |log-odds|: that of the prior plus the largest evidence of a label times the number of labels.

    It is infinite if label probabilities are unknown, or labels are not independent.
    """
    if not (isinstance(config.seeing, KnownSeeing) and is_independent(config.seeing)):
        return np.inf
    in_full_view = config.seeing.positive(0.0, 0.0)
    surest = max(abs(label_evidence(*in_full_view, says_dirty)) for says_dirty in (False, True))
    prior = np.abs(np.log(config.dirty_share) - np.log1p(-config.dirty_share))
    return float(np.ceil(prior + (config.num_stages + 1) * surest))


def _object_line(seen: Observation, cup: int) -> str:
    """Text line of an object: its probability of DIRTY and its location."""
    where = f"hidden {seen['occlusion'][cup]:.0%}" if seen["is_on_table"][cup] else "in the dishwasher"
    return f"cup {cup}: dirty {expit(seen['log_odds'][cup]):.0%}, {where}"


def _doing_of(seen: Observation, robot: int) -> str:
    """Text for what a robot is doing."""
    if not seen["is_busy"][robot]:
        return "out" if seen["is_out"][robot] else "parked" if seen["is_parked"][robot] else "free"
    verb = int(seen["verb"][robot])
    what = f" {seen['target'][robot]}" if verb in TARGETED else ""
    return f"{VERB_NAMES[verb]}{what} for {seen['since_s'][robot]:.1f} s"


def default_scene() -> Scene:
    """Six cups: three in front, one behind each gap that two of them hide, and one almost in full view."""
    hides = np.zeros((6, 6))
    hides[3, 0], hides[3, 1] = 0.35, 0.25
    hides[4, 1], hides[4, 2] = 0.3, 0.3
    hides[5, 2] = 0.15
    places_m = [(-0.2, 0.0), (0.0, 0.0), (0.2, 0.0), (-0.1, 0.15), (0.1, 0.15), (0.3, 0.15)]
    return Scene(hides, name="default", places_m=np.array(places_m))


def default_team() -> Team:
    """Two robots, left and right of the table; they reach four and five of the six cups, three of them in common."""
    return Team((Robot((-0.5, 0.05), 0.65, name="left"), Robot((0.5, 0.05), 0.65, name="right")))


class CupsEnv(gymnasium.Env[Observation, np.int64]):
    """A table of half-hidden cups (design, §3), registered as ``gymnasium.make("halfseen/Cups-v0")``.

    Actions are numbered as in `halfseen.world.actions`; ``info["action_mask"]`` marks the possible ones. An impossible
    action (its object is in the dishwasher, or padding) is an attempt that closes on nothing: it fails, takes the time
    limit of an attempt, and is rewarded like a missed grasp.

    ``terminated`` is the table's own end: FINISH, cleared, or the horizon. ``truncated`` is a cut from outside the
    task: the stage in progress is lost, so the reward is 0, S_t stays, and ``info`` gives the clock of the cut and its
    cause. They are never both true: a stage that ends at the very moment of a cut is completed.

    An observation holds S_t: for each object is_object, is_on_table (else in the dishwasher), occlusion, grip (mean of
    its grip offset), log_odds (of DIRTY), seen (share of its surface that labels have covered), successes, failures and
    lifts; hides (row i: the share of object i that each object hides alone); the attempts in step order (object or -1,
    occlusion, succeeded); and steps_to_go. Padding reads 0.

    Parameters
    ----------
    scenes
        Initial scenes: one is drawn at each reset, or chosen by ``options={"scene": k}``. None for `default_scene`.
    num_objects
        N, padding included; by default that of the largest scene.
    config
        Parameters of the world.
    cut_rate
        Rate of cuts [1/s]; `halfseen.world.cuts.cut_rate` computes the rate that cuts a wanted share of a policy's
        trajectories.
    render_mode
        None, or ``"ansi"`` for text.
    team
        Robots, each with a reach of its own; see `TeamCupsEnv`.

    Raises
    ------
    SceneError
        There is no scene, or one has more objects than `num_objects`.
    ArgumentError
        `cut_rate` is negative or not finite, or `render_mode` is unknown.

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
        team: Team | None = None,
    ) -> None:
        if not 0.0 <= cut_rate < np.inf:
            raise ArgumentError(f"cut_rate is {cut_rate}; give cuts per second, finite and ≥ 0")
        if render_mode not in (None, "ansi"):
            raise ArgumentError(f"render_mode is {render_mode!r}; give None or 'ansi'")
        scenes, world = default_scene() if scenes is None else scenes, TableWorld.of(team, config)
        self.scenes = [scenes] if isinstance(scenes, Scene) else list(scenes)
        self.team, self.config, self.cut_rate, self.render_mode = team, world.played_config, cut_rate, render_mode
        self.layouts = world.layouts(self.scenes, num_objects)
        self.num_objects = int(self.layouts.is_object.shape[-1])
        self.num_actions = 1 + len(TARGETED) * self.num_objects + (team is not None)
        self.action_space = spaces.Discrete(self.num_actions)
        self.observation_space: spaces.Space[Observation] = space_of(self.config, self.layouts)
        self.elapsed_s, self.is_over, self.is_cut = 0.0, False, False
        self._state: TableState | None = None

    @property
    def state(self) -> TableState:
        """S_t; raises `ArgumentError` before the first reset."""
        if self._state is None:
            raise ArgumentError("the trajectory has not begun; call reset")
        return self._state

    @property
    def decider(self) -> int:
        """Number of the robot that decides."""
        return 0 if self.state.decider is None else int(self.state.decider)

    @property
    def is_ended(self) -> bool:
        """Whether there is no decision to make: before a reset, or after the end."""
        return self._state is None or self.is_over or self.is_cut

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Set a table; raises `ArgumentError` if `options` names a scene that does not exist.

        ``info["episode_seed"]`` is the integer s such that `halfseen.world.rollout.play` with the key
        ``halfseen.world.random.key_of(s)`` plays this same table.
        """
        super().reset(seed=seed)
        rng = self.np_random
        which = (options or {}).get("scene", int(rng.integers(len(self.scenes))))
        if not 0 <= which < len(self.scenes):
            raise ArgumentError(f"scene is {which}; give 0 to {len(self.scenes) - 1}")
        episode_seed = int(rng.integers(2**31))
        self._cut_s = float(rng.exponential() / self.cut_rate) if self.cut_rate else np.inf
        start_key, self._world_key, _ = random.split(random.fold_in(random.key_of(episode_seed), 0), 3)
        self._state, self._hidden = start(self.config, mapped(lambda leaf: leaf[which], self.layouts), start_key)
        self._num_decisions, self.elapsed_s, self.is_over, self.is_cut = 0, 0.0, False, False
        return self.observation(), {**self.info(), "episode_seed": episode_seed}

    def step(self, action: np.integer | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Let the deciding robot begin an action, and advance to the next decision or to a cut before it.

        Raises
        ------
        ArgumentError
            The trajectory is over or not begun, or there is no such action.
        """
        state = self.state
        if self.is_ended:
            raise ArgumentError("the trajectory is over; call reset")
        if not (np.issubdtype(np.asarray(action).dtype, np.integer) and 0 <= action < self.num_actions):
            raise ArgumentError(f"action is {action}; give 0 to {self.num_actions - 1}")
        key = random.fold_in(self._world_key, self._num_decisions)
        taken = np.asarray(action, dtype=np.int32)
        after, hidden, outcome = step(self.config, state, self._hidden, taken, key, any_action=True)
        reward, end_s = float(outcome.reward), self.elapsed_s + float(outcome.duration_s)
        if end_s > self._cut_s:
            self.is_cut, self.elapsed_s = True, self._cut_s
            return self.observation(), 0.0, False, True, {**self.info(), "cause": CAUSES["independent"]}
        self._state, self._hidden, self._num_decisions = after, hidden, self._num_decisions + 1
        self.elapsed_s, self.is_over = end_s, bool(outcome.is_over)
        return self.observation(), reward, self.is_over, False, self.info()

    def observation(self, robot: int | None = None) -> Observation:
        """S_t as arrays, as seen by the deciding robot or by `robot`."""
        # Copies, so that a caller who writes into them does not change the state.
        return mapped(np.copy, observed(self.config, self.state, robot))

    def info(self, robot: int | None = None) -> dict[str, Any]:
        """Clock and action mask of `robot`, or of the robot that decides, which is named in a team."""
        who = {} if self.team is None or robot is not None else {"robot": self.decider}
        return {"elapsed_s": self.elapsed_s, "action_mask": self.action_mask(robot), **who}

    def action_mask(self, robot: int | None = None) -> Int[np.ndarray, " A"]:
        """Which actions are possible; none for a robot that does not decide."""
        mask = possible_actions(self.state).astype(np.int8)
        return mask if robot is None or (robot == self.decider and not self.is_ended) else np.zeros_like(mask)

    def render(self) -> str | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Render the table as text, one line per robot and object; None unless the mode is ``"ansi"``."""
        if self.render_mode is None:
            return None
        seen = self.observation()
        if self.team is None:
            lines = [f"{int(self.state.steps_to_go)} steps to go, {self.elapsed_s:.1f} s"]
        else:
            lines = [f"robot {self.decider} decides, {self.elapsed_s:.1f} s"]
            for r, robot in enumerate(self.team.robots):
                lines.append(f"{robot.name}: {_doing_of(seen, r)}, {seen['decisions_to_go'][r]} decisions to go")
        return "\n".join([*lines, *(_object_line(seen, cup) for cup in np.flatnonzero(seen["is_object"]).tolist())])


class TeamCupsEnv(CupsEnv):
    """A table of half-hidden cups before several robots, registered as ``gymnasium.make("halfseen/TeamCups-v0")``.

    It differs from `CupsEnv` in that each step is one decision of the robot that is free, ``info["robot"]``. WAIT is
    the last action; with nothing to wait for, it lasts as long as going home.

    The reward sums all rewards until the next decision of any robot. The table's own end comes when it is cleared, or
    every robot is parked, dropped out or out of decisions. A cut ends it for all robots. A single drop-out does not end
    it: observations mark the robot as out.

    An observation adds to that of `CupsEnv` decider (number of the deciding robot); for each robot is_busy, is_parked,
    is_out, verb (0 FINISH, 1 WASH, 2 LIFT, 3 WAIT), target, since_s and decisions_to_go; is_in_reach (row r: the
    objects that robot r reaches) and is_near (pairs of objects too close for two robots at once). If robots have their
    own laws of grasping, attempt_robot gives the robot that made each attempt.

    Parameters
    ----------
    scenes, num_objects, config, cut_rate, render_mode
        As in `CupsEnv`; scenes have `places_m`.
    team
        The robots; None for two, left and right of the table.

    Raises
    ------
    SceneError, ArgumentError
        As in `CupsEnv`; or a scene lacks the places of its objects.

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
        super().__init__(scenes, num_objects, config, cut_rate, render_mode, default_team() if team is None else team)
