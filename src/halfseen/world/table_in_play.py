"""One table, one decision at a time: what Gymnasium's and PettingZoo's faces are made of; for any number of robots."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Int

from halfseen.arrays import mapped
from halfseen.errors import ArgumentError
from halfseen.world import random
from halfseen.world.actions import TARGETED, VERB_NAMES, possible_actions
from halfseen.world.config import WorldConfig
from halfseen.world.robots import Robot, Team
from halfseen.world.scene import Scene
from halfseen.world.state import TableState, attempt_counts, occlusion
from halfseen.world.table_world import TableWorld
from halfseen.world.transition import start, step_any

Observation = dict[str, Any]
"""Arrays by name; see `envs.CupsEnv`."""
_PLACES_M = ((-0.2, 0.0), (0.0, 0.0), (0.2, 0.0), (-0.1, 0.15), (0.1, 0.15), (0.3, 0.15))


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
        Where episodes begin, for a team with `places_m`; None for `default_scene`.
    team
        The robots; None for one that reaches everything.
    num_objects
        N, padding included; by default that of the largest scene.
    config
        The numbers of the world.
    cut_rate
        Rate of cuts [1/s]; one ends the table for all.

    Raises
    ------
    SceneError
        There is no scene, one has more objects than `num_objects`, or does not tell a team where they stand.
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
        scenes, world = default_scene() if scenes is None else scenes, TableWorld.of(team, config)
        self.scenes = [scenes] if isinstance(scenes, Scene) else list(scenes)
        self.team, self.config, self.cut_rate = team, world.played_config, cut_rate
        self.layouts = world.layouts(self.scenes, num_objects)
        self.num_objects = int(self.layouts.is_object.shape[-1])
        self.num_actions = 1 + len(TARGETED) * self.num_objects + (team is not None)
        self.elapsed_s, self.is_ended = 0.0, True
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
            raise ArgumentError("the path has not begun; call reset")
        return self._state

    @property
    def decider(self) -> int:
        """Number of the robot that decides."""
        return 0 if self.state.decider is None else int(self.state.decider)

    def reset(self, rng: np.random.Generator, options: Mapping[str, Any] | None = None) -> int:
        """Set a table, and give the seed with which `halfseen.world.rollout.play` plays this very one."""
        which = (options or {}).get("scene", int(rng.integers(len(self.scenes))))
        if not 0 <= which < len(self.scenes):
            raise ArgumentError(f"scene is {which}; there are scenes 0 to {len(self.scenes) - 1}")
        episode_seed = int(rng.integers(2**31))
        self._cut_s = float(rng.exponential() / self.cut_rate) if self.cut_rate else np.inf
        start_key, self._world_key, _ = random.split(random.fold_in(random.key_of(episode_seed), 0), 3)
        self._state, self._hidden = start(self.config, mapped(lambda leaf: leaf[which], self.layouts), start_key)
        self._num_decisions, self.elapsed_s, self.is_ended = 0, 0.0, False
        return episode_seed

    def step(self, action: int | np.integer) -> StageEnd:
        """Let the robot that decides begin an action, unless a cut comes before the next decision.

        Raises
        ------
        ArgumentError
            The path is over or not begun, or there is no such action.
        """
        state = self.state
        if self.is_ended:
            raise ArgumentError("the path is over; call reset")
        if not (np.issubdtype(np.asarray(action).dtype, np.integer) and 0 <= action < self.num_actions):
            raise ArgumentError(f"action is {action}; it lies in 0 to {self.num_actions - 1}")
        key = random.fold_in(self._world_key, self._num_decisions)
        after, hidden, outcome = step_any(self.config, state, self._hidden, np.asarray(action, dtype=np.int32), key)
        end_s = self.elapsed_s + float(outcome.duration_s)
        if end_s > self._cut_s:
            self.is_ended, self.elapsed_s = True, self._cut_s
            return StageEnd(0.0, is_over=False, is_cut=True)
        self._state, self._hidden, self._num_decisions = after, hidden, self._num_decisions + 1
        self.elapsed_s, self.is_ended = end_s, bool(outcome.is_over)
        return StageEnd(float(outcome.reward), is_over=self.is_ended, is_cut=False)

    def observation(self, robot: int | None = None) -> Observation:
        """S_t as arrays, as the robot that decides sees it, or another."""
        seen = observe_table(self.state)
        if self.state.robots is not None:
            decider = self.decider if robot is None else robot
            seen = {"decider": np.array([decider], dtype=np.int32)} | seen | _observe_robots(self.state)
        # Whoever is given them may write into them: the state is not theirs.
        return mapped(np.copy, seen)

    def action_mask(self, robot: int | None = None) -> Int[np.ndarray, " A"]:
        """Which actions are possible: of a robot that does not decide, none."""
        mask = possible_actions(self.state).astype(np.int8)
        return mask if robot is None or (robot == self.decider and not self.is_ended) else np.zeros_like(mask)

    def as_text(self) -> str:
        """Write the table, a line an object, and what its robots are at, a line each."""
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


def observe_table(state: TableState) -> Observation:
    """S_t of one table as arrays; padding reads 0."""
    successes, failures = attempt_counts(state)
    return {
        "is_object": state.is_object.astype(np.int8),
        "is_on_table": state.is_on_table.astype(np.int8),
        "occlusion": occlusion(state),
        "grip": state.grip,
        "log_odds": np.where(state.is_object, state.log_odds, np.float32(0.0)),
        "seen": state.seen,
        "successes": successes.astype(np.int32),
        "failures": failures.astype(np.int32),
        "lifts": state.lifts,
        "hides": state.hides,
        "attempt_object": state.attempt_object,
        "attempt_occlusion": state.attempt_occlusion,
        "attempt_succeeded": state.attempt_succeeded.astype(np.int8),
        "steps_to_go": np.asarray(state.steps_to_go)[None],
    }


def _observe_robots(state: TableState) -> Observation:
    """What each robot is at, 0 where it is at nothing; who reaches what, and who made each attempt, if that matters."""
    robots, space = state.robots, state.workspace
    assert robots is not None
    assert space is not None
    is_out = np.zeros_like(robots.is_busy) if robots.is_out is None else robots.is_out
    return {
        "is_busy": robots.is_busy.astype(np.int8),
        "is_parked": robots.is_parked.astype(np.int8),
        "is_out": is_out.astype(np.int8),
        "verb": np.where(robots.is_busy, robots.verb, 0).astype(np.int32),
        "target": np.where(robots.is_busy, robots.target, 0).astype(np.int32),
        "since_s": np.where(robots.is_busy, robots.since_s, np.float32(0.0)),
        "decisions_to_go": robots.decisions_to_go,
        "is_in_reach": space.is_in_reach.astype(np.int8),
        "is_near": space.is_near.astype(np.int8),
        **({} if state.attempt_robot is None else {"attempt_robot": state.attempt_robot}),
    }
