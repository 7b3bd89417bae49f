"""One table, one decision at a time: what Gymnasium's and PettingZoo's faces are made of; for any number of robots."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from halfseen.arrays import mapped
from halfseen.errors import ArgumentError
from halfseen.shapes import Int
from halfseen.world import random
from halfseen.world.actions import TARGETED, VERB_NAMES, WAIT, possible_actions
from halfseen.world.config import WorldConfig
from halfseen.world.robots import Robot, Team
from halfseen.world.scene import Scene
from halfseen.world.seeing import KnownSeeing, is_independent, label_evidence
from halfseen.world.state import TableState, attempt_counts, initial_state, occlusion
from halfseen.world.table_world import TableWorld
from halfseen.world.transition import start, step

Observation = dict[str, Any]
"""Arrays by name; see `envs.CupsEnv`."""
_PLACES_M = ((-0.2, 0.0), (0.0, 0.0), (0.2, 0.0), (-0.1, 0.15), (0.1, 0.15), (0.3, 0.15))
_OF_TABLE = ("is_object", "is_on_table", "grip", "seen", "lifts", "hides")
_OF_TABLE += ("attempt_object", "attempt_occlusion", "attempt_succeeded")
_ROUNDED = 1e-5


def default_scene() -> Scene:
    """Six cups: three in front, and behind each gap one that two of them hide; the last stands almost free."""
    hides = np.zeros((6, 6))
    hides[3, 0], hides[3, 1] = 0.35, 0.25
    hides[4, 1], hides[4, 2] = 0.3, 0.3
    hides[5, 2] = 0.15
    return Scene(hides, name="default", places_m=np.array(_PLACES_M))


def default_team() -> Team:
    """Two robots, left and right of the table; each reaches four of the six cups, and three of those both."""
    return Team((Robot((-0.5, 0.05), 0.65, name="left"), Robot((0.5, 0.05), 0.65, name="right")))


class TableInPlay:
    """A table that is set, and then goes on from one decision to the next.

    Parameters
    ----------
    scenes
        Where episodes begin, for a team with `places_m`; None for `default_scene`.
    team
        The robots; None for one that reaches everything.
    num_objects
        N, padding included; by default that of the largest scene.
    config
        The numbers of the world.
    cut_rate
        Rate of cuts [1/s]; one ends the table for all.
    render_mode
        None, or ``"ansi"`` for a text.

    Attributes
    ----------
    elapsed_s
        The table's clock [s].
    is_over, is_cut
        Whether the table came to its own end, and whether a cut ended it for all robots.

    Raises
    ------
    SceneError
        There is no scene, one has more objects than `num_objects`, or does not tell a team where they stand.
    ArgumentError
        `cut_rate` is negative or not finite, or `render_mode` unknown.
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
        if not 0.0 <= cut_rate < np.inf:
            raise ArgumentError(f"cut_rate is {cut_rate}; give cuts per second, finite and ≥ 0")
        if render_mode not in (None, "ansi"):
            raise ArgumentError(f"render_mode is {render_mode!r}; it is None or 'ansi'")
        scenes, world = default_scene() if scenes is None else scenes, TableWorld.of(team, config)
        self.scenes = [scenes] if isinstance(scenes, Scene) else list(scenes)
        self.team, self.config, self.cut_rate, self.render_mode = team, world.played_config, cut_rate, render_mode
        self.layouts = world.layouts(self.scenes, num_objects)
        self.num_objects = int(self.layouts.is_object.shape[-1])
        self.num_actions = 1 + len(TARGETED) * self.num_objects + (team is not None)
        self.elapsed_s, self.is_over, self.is_cut = 0.0, False, False
        self._state: TableState | None = None

    @property
    def state(self) -> TableState:
        """S_t.

        Raises
        ------
        ArgumentError
            No table is set.
        """
        if self._state is None:
            raise ArgumentError("the trajectory has not begun; call reset")
        return self._state

    @property
    def decider(self) -> int:
        """Number of the robot that decides."""
        return 0 if self.state.decider is None else int(self.state.decider)

    @property
    def is_ended(self) -> bool:
        """Whether nothing is to be decided."""
        return self._state is None or self.is_over or self.is_cut

    def reset(self, rng: np.random.Generator, options: Mapping[str, Any] | None = None) -> int:
        """Set a table, and give the seed with which `halfseen.world.rollout.play` plays this very one."""
        which = (options or {}).get("scene", int(rng.integers(len(self.scenes))))
        if not 0 <= which < len(self.scenes):
            raise ArgumentError(f"scene is {which}; there are scenes 0 to {len(self.scenes) - 1}")
        episode_seed = int(rng.integers(2**31))
        self._cut_s = float(rng.exponential() / self.cut_rate) if self.cut_rate else np.inf
        start_key, self._world_key, _ = random.split(random.fold_in(random.key_of(episode_seed), 0), 3)
        self._state, self._hidden = start(self.config, mapped(lambda leaf: leaf[which], self.layouts), start_key)
        self._num_decisions, self.elapsed_s, self.is_over, self.is_cut = 0, 0.0, False, False
        return episode_seed

    def step(self, action: int | np.integer) -> float:
        """Let the robot that decides begin an action, unless a cut comes before the next decision.

        Returns
        -------
        float
            Reward of the stage; 0 where a cut took it.

        Raises
        ------
        ArgumentError
            The trajectory is over or not begun, or there is no such action.
        """
        state = self.state
        if self.is_ended:
            raise ArgumentError("the trajectory is over; call reset")
        if not (np.issubdtype(np.asarray(action).dtype, np.integer) and 0 <= action < self.num_actions):
            raise ArgumentError(f"action is {action}; it lies in 0 to {self.num_actions - 1}")
        key = random.fold_in(self._world_key, self._num_decisions)
        taken = np.asarray(action, dtype=np.int32)
        after, hidden, outcome = step(self.config, state, self._hidden, taken, key, any_action=True)
        end_s = self.elapsed_s + float(outcome.duration_s)
        if end_s > self._cut_s:
            self.is_cut, self.elapsed_s = True, self._cut_s
            return 0.0
        self._state, self._hidden, self._num_decisions = after, hidden, self._num_decisions + 1
        self.elapsed_s, self.is_over = end_s, bool(outcome.is_over)
        return float(outcome.reward)

    def observation(self, robot: int | None = None) -> Observation:
        """S_t as arrays, as the robot that decides sees it, or another."""
        # Whoever is given them may write into them: the state is not theirs.
        return mapped(np.copy, observed(self.config, self.state, robot))

    def info(self, robot: int | None = None) -> dict[str, Any]:
        """The clock, and what is possible, for the robot that decides or for another."""
        return {"elapsed_s": self.elapsed_s, "action_mask": self.action_mask(robot)}

    def action_mask(self, robot: int | None = None) -> Int[np.ndarray, " A"]:
        """Which actions are possible: of a robot that does not decide, none."""
        mask = possible_actions(self.state).astype(np.int8)
        return mask if robot is None or (robot == self.decider and not self.is_ended) else np.zeros_like(mask)

    def observation_space(self) -> spaces.Space[Observation]:
        """Space of the observations: their shapes and types, and how far their numbers reach."""
        config, num_robots = self.config, self.config.num_robots
        example = observed(config, initial_state(config, mapped(lambda leaf: leaf[0], self.layouts)))
        firmest, surest = float(np.nanmax(np.abs(self.layouts.grip), initial=1.0)), _largest_log_odds(config)
        usual: dict[Any, tuple[Any, Any]] = {np.float32: (0.0, 1.0), np.int32: (0, config.num_stages)}
        bounds: dict[str, tuple[Any, Any]] = {
            "grip": (-firmest, firmest),
            "log_odds": (-surest, surest),
            "attempt_object": (-1, self.num_objects - 1),
            "decider": (0, num_robots - 1),
            "verb": (0, WAIT),
            "target": (0, self.num_objects - 1),
            "since_s": (0.0, _longest_s(config)),
            "decisions_to_go": (0, config.horizon),
            "attempt_robot": (0, num_robots - 1),
        }

        def space_of(name: str, value: np.ndarray) -> spaces.Space[Any]:
            if value.dtype == np.int8:
                return spaces.MultiBinary(value.shape if value.ndim > 1 else len(value))
            low, high = bounds.get(name, usual[value.dtype.type])
            return spaces.Box(low, high, value.shape, dtype=value.dtype.type)

        return spaces.Dict({name: space_of(name, value) for name, value in example.items()})

    def as_text(self) -> str | None:
        """Write the table, a line an object, and what its robots are at, a line each; None unless it is rendered."""
        if self.render_mode is None:
            return None
        seen, team = self.observation(), self.team
        if team is None:
            lines = [f"{int(self.state.steps_to_go)} steps to go, {self.elapsed_s:.1f} s"]
        else:
            lines = [f"robot {self.decider} decides, {self.elapsed_s:.1f} s"]
            for r, robot in enumerate(team.robots):
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
    return f"{VERB_NAMES[verb]}{what} for {seen['since_s'][robot]:.1f} s"


def observed(config: WorldConfig, state: TableState, robot: int | None = None) -> Observation:
    """S_t of one table as arrays, as the robot that decides sees it, or another; padding, and who is idle, read 0."""
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


def _longest_s(config: WorldConfig) -> float:
    """Bound on what a robot may be at: the longest attempt of one, or a wait for it [s]."""
    worlds = (config.as_robot(robot) for robot in range(config.num_robots))
    longest_s = (float(world.grasping.limit_s + world.transport_s) for world in worlds)
    bound_s = np.ceil(max(each / float(speed) for each, speed in zip(longest_s, config.speed, strict=True)))
    # Seconds are added up event by event, and rounded.
    return float(bound_s * (1.0 + _ROUNDED))


def _largest_log_odds(config: WorldConfig) -> float:
    """Bound on |log-odds|: the prior's, and as many labels as there are, each the surest that a label can be.

    There is none where it is not known how sure a label can be, or labels are not independent.
    """
    if not (isinstance(config.seeing, KnownSeeing) and is_independent(config.seeing)):
        return np.inf
    in_full_view = config.seeing.positive(0.0, 0.0)
    surest = max(abs(label_evidence(*in_full_view, says_dirty)) for says_dirty in (False, True))
    prior = np.abs(np.log(config.dirty_share) - np.log1p(-config.dirty_share))
    return float(np.ceil(prior + (config.num_stages + 1) * surest))
