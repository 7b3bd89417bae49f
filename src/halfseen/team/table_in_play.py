"""One table before a team, one decision at a time: what both faces, Gymnasium's and PettingZoo's, are made of."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from jaxtyping import Array, Int

from halfseen.errors import ArgumentError
from halfseen.team.actions import WAIT, possible_actions, wait_of
from halfseen.team.config import TeamConfig
from halfseen.team.dynamics import start, step_any
from halfseen.team.robots import Robot
from halfseen.team.state import TeamState
from halfseen.team.team import Team
from halfseen.world.config import WorldConfig
from halfseen.world.gymnasium_env import Observation, default_scene, observe_table, table_spaces
from halfseen.world.scene import Scene

_PLACES_M = ((-0.2, 0.0), (0.0, 0.0), (0.2, 0.0), (-0.1, 0.15), (0.1, 0.15), (0.3, 0.15))


def default_places() -> Scene:
    """The six cups of `default_scene`, with where they stand."""
    scene = default_scene()
    return Scene(scene.hides, scene.name, places_m=np.array(_PLACES_M))


def default_team() -> Team:
    """Two robots, left and right of the table; each reaches four of the six cups, and three of those both."""
    return Team((Robot((-0.5, 0.05), 0.65, name="left"), Robot((0.5, 0.05), 0.65, name="right")))


@dataclass(frozen=True)
class StageEnd:
    """What a decision brought.

    Parameters
    ----------
    reward
        Of the stage; 0 where a cut took it.
    is_over
        Whether the table came to its own end.
    is_cut
        Whether a cut ended it for all robots.
    """

    reward: float
    is_over: bool
    is_cut: bool


class TableInPlay:
    """A table that is set, and then goes on from one decision to the next.

    Parameters
    ----------
    scenes
        Where episodes begin, with `places_m`; None for `default_places`.
    team
        The robots; None for `default_team`.
    num_objects
        N, padding included; by default that of the largest scene.
    config
        The numbers of the world.
    cut_rate
        Rate of cuts [1/s]; one ends the table for all.

    Raises
    ------
    SceneError
        There is no scene, one has more objects than `num_objects`, or does not tell where they stand.
    ArgumentError
        `cut_rate` is negative or not finite.
    """

    def __init__(
        self,
        scenes: Scene | Sequence[Scene] | None = None,
        team: Team | None = None,
        num_objects: int | None = None,
        config: WorldConfig | None = None,
        cut_rate: float | int = 0.0,
    ) -> None:
        if not 0.0 <= cut_rate < np.inf:
            raise ArgumentError(f"cut_rate is {cut_rate}; give cuts per second, finite and ≥ 0")
        scenes = default_places() if scenes is None else scenes
        self.scenes = [scenes] if isinstance(scenes, Scene) else list(scenes)
        self.team = default_team() if team is None else team
        self.config: TeamConfig = self.team.config(WorldConfig() if config is None else config)
        self.cut_rate = cut_rate
        self.layouts = self.team.layouts(self.scenes, num_objects)
        self.num_objects = int(self.layouts.table.is_object.shape[-1])
        self.num_actions = wait_of(self.num_objects) + 1
        self.elapsed_s, self.is_ended = 0.0, True
        self._state: TeamState | None = None

    @property
    def state(self) -> TeamState:
        """S_t.

        Raises
        ------
        ArgumentError
            No table is set.
        """
        if self._state is None:
            raise ArgumentError("the path has not begun; call reset")
        return self._state

    @property
    def decider(self) -> int:
        """Number of the robot that decides."""
        return int(self.state.decider)

    def reset(self, rng: np.random.Generator, options: Mapping[str, Any] | None = None) -> int:
        """Set a table, and give the seed with which `team.episodes.play` plays this very one."""
        which = (options or {}).get("scene", int(rng.integers(len(self.scenes))))
        if not 0 <= which < len(self.scenes):
            raise ArgumentError(f"scene is {which}; there are scenes 0 to {len(self.scenes) - 1}")
        episode_seed = int(rng.integers(2**31))
        self._cut_s = float(rng.exponential() / self.cut_rate) if self.cut_rate else np.inf
        key = jax.random.fold_in(jax.random.key(episode_seed), 0)
        start_key, self._world_key, _ = jax.random.split(key, 3)
        layout = jax.tree.map(lambda leaf: leaf[which], self.layouts)
        self._state, self._hidden = _start(self.config, layout, start_key)
        self._num_decisions, self.elapsed_s, self.is_ended = 0, 0.0, False
        return episode_seed

    def step(self, action: int) -> StageEnd:
        """Let the robot that decides begin an action, unless a cut comes before the next decision.

        Raises
        ------
        ArgumentError
            The path is over or not begun, or there is no such action.
        """
        state = self.state
        if self.is_ended:
            raise ArgumentError("the path is over; call reset")
        if not 0 <= action < self.num_actions:
            raise ArgumentError(f"action is {action}; it lies in 0 to {self.num_actions - 1}")
        key = jax.random.fold_in(self._world_key, self._num_decisions)
        after, hidden, outcome = _step(self.config, state, self._hidden, jnp.asarray(action, dtype=jnp.int32), key)
        end_s = self.elapsed_s + float(outcome.duration_s)
        if end_s > self._cut_s:
            self.is_ended, self.elapsed_s = True, self._cut_s
            return StageEnd(0.0, is_over=False, is_cut=True)
        self._state, self._hidden, self._num_decisions = after, hidden, self._num_decisions + 1
        self.elapsed_s, self.is_ended = end_s, bool(outcome.is_over)
        return StageEnd(float(outcome.reward), is_over=self.is_ended, is_cut=False)

    def observation(self, robot: int | None = None) -> Observation:
        """S_t as arrays, as the robot that decides sees it, or another."""
        decider = self.decider if robot is None else robot
        seen = observe_table(self.state.table) | _observe_robots(self.state)
        return {"decider": np.array([decider], dtype=np.int32)} | {name: np.asarray(one) for name, one in seen.items()}

    def action_mask(self, robot: int | None = None) -> Int[np.ndarray, " A"]:
        """Which actions are possible: of a robot that does not decide, none."""
        mask = np.asarray(_mask(self.state))
        return mask if robot is None or (robot == self.decider and not self.is_ended) else np.zeros_like(mask)

    def space(self) -> spaces.Space[Observation]:
        """Space of `observation`."""
        num_robots, horizon = self.config.num_robots, self.config.world.horizon
        by_robot = {"attempt_robot": spaces.Box(0, num_robots - 1, (self.config.num_stages,), dtype=np.int32)}
        return spaces.Dict(
            {
                **table_spaces(self.layouts.table, self.config.world, self.config.num_stages),
                "decider": spaces.Box(0, num_robots - 1, (1,), dtype=np.int32),
                "is_busy": spaces.MultiBinary(num_robots),
                "is_parked": spaces.MultiBinary(num_robots),
                "is_out": spaces.MultiBinary(num_robots),
                "verb": spaces.Box(0, WAIT, (num_robots,), dtype=np.int32),
                "target": spaces.Box(0, self.num_objects - 1, (num_robots,), dtype=np.int32),
                "since_s": spaces.Box(0.0, self._longest_s(), (num_robots,), dtype=np.float32),
                "decisions_to_go": spaces.Box(0, horizon, (num_robots,), dtype=np.int32),
                "is_in_reach": spaces.MultiBinary((num_robots, self.num_objects)),
                "is_near": spaces.MultiBinary((self.num_objects, self.num_objects)),
                **(by_robot if self.config.has_own_laws else {}),
            }
        )

    def _longest_s(self) -> float:
        """Bound on what a robot may be at: the longest attempt of one, or a wait for it [s]."""
        worlds = (self.config.world.as_robot(robot) for robot in range(self.config.num_robots))
        longest_s = (float(world.grasping.limit_s + world.transport_s) for world in worlds)
        return float(
            np.ceil(max(each / float(speed) for each, speed in zip(longest_s, self.config.speed, strict=True)))
        )


_start, _step = jax.jit(start), jax.jit(step_any)


@jax.jit
def _mask(state: TeamState) -> Int[Array, " A"]:
    return possible_actions(state).astype(jnp.int8)


@jax.jit
def _observe_robots(state: TeamState) -> dict[str, Array]:
    """What each robot is at, 0 where it is at nothing; who reaches what, and who made each attempt, if that matters."""
    robots, space = state.robots, state.workspace
    is_out = jnp.zeros_like(robots.is_busy) if robots.is_out is None else robots.is_out
    return {
        "is_busy": robots.is_busy.astype(jnp.int8),
        "is_parked": robots.is_parked.astype(jnp.int8),
        "is_out": is_out.astype(jnp.int8),
        "verb": jnp.where(robots.is_busy, robots.verb, 0).astype(jnp.int32),
        "target": jnp.where(robots.is_busy, robots.target, 0).astype(jnp.int32),
        "since_s": jnp.where(robots.is_busy, robots.since_s, 0.0),
        "decisions_to_go": robots.decisions_to_go,
        "is_in_reach": space.is_in_reach.astype(jnp.int8),
        "is_near": space.is_near.astype(jnp.int8),
        **({} if state.table.attempt_robot is None else {"attempt_robot": state.table.attempt_robot}),
    }
