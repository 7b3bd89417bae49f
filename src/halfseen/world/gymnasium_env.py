"""The table world behind Gymnasium's interface, for agents that learn while they act."""

from collections.abc import Sequence
from functools import partial
from typing import Any, ClassVar

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from jaxtyping import Array, Int

from halfseen.errors import ArgumentError
from halfseen.world.action_space import ActionSpace, possible_actions
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CAUSES
from halfseen.world.dynamics import start, step
from halfseen.world.scene import Scene
from halfseen.world.seeing import KnownSeeing, is_independent, label_evidence
from halfseen.world.state import Layout, TableState, attempt_counts, occlusion, pad_scenes

Observation = dict[str, Any]
"""Arrays by name; see `CupsEnv`."""


def default_scene() -> Scene:
    """Six cups: three in front, and behind each gap one that two of them hide; the last stands almost free."""
    hides = np.zeros((6, 6))
    hides[3, 0], hides[3, 1] = 0.35, 0.25
    hides[4, 1], hides[4, 2] = 0.3, 0.3
    hides[5, 2] = 0.15
    return Scene(hides, name="default")


class CupsEnv(gymnasium.Env[Observation, np.int64]):
    """A table of half-hidden cups (design, §3), as ``gymnasium.make("halfseen/Cups-v0")`` makes it.

    Actions are numbered as in `halfseen.world.action_space`; ``info["action_mask"]`` tells which are possible. One that
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
        if not 0.0 <= cut_rate < np.inf:
            raise ArgumentError(f"cut_rate is {cut_rate}; give cuts per second, finite and ≥ 0")
        if render_mode not in (None, "ansi"):
            raise ArgumentError(f"render_mode is {render_mode!r}; it is None or 'ansi'")
        scenes = default_scene() if scenes is None else scenes
        self.scenes = [scenes] if isinstance(scenes, Scene) else list(scenes)
        self.config = WorldConfig() if config is None else config
        self.cut_rate = cut_rate
        self.render_mode = render_mode
        self._layouts = pad_scenes(self.scenes, num_objects)
        self.num_objects = int(self._layouts.is_object.shape[-1])
        self.action_space = spaces.Discrete(ActionSpace(self.num_objects).num_actions)
        self.observation_space: spaces.Space[Observation] = spaces.Dict(
            table_spaces(self._layouts, self.config, self.config.horizon)
        )
        self._state: TableState | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Set a table.

        ``info["episode_seed"]`` is the integer s with which ``play(config, layout, policy, jax.random.key(s), 1)``
        plays this very table.
        """
        super().reset(seed=seed)
        which = (options or {}).get("scene", int(self.np_random.integers(len(self.scenes))))
        if not 0 <= which < len(self.scenes):
            raise ArgumentError(f"scene is {which}; there are scenes 0 to {len(self.scenes) - 1}")
        episode_seed = int(self.np_random.integers(2**31))
        self._cut_s = float(self.np_random.exponential() / self.cut_rate) if self.cut_rate else np.inf
        key = jax.random.fold_in(jax.random.key(episode_seed), 0)
        start_key, self._world_key, _ = jax.random.split(key, 3)
        layout = jax.tree.map(lambda leaf: leaf[which], self._layouts)
        self._state, self._hidden = _start(self.config, layout, start_key)
        self._elapsed_s = 0.0
        self._is_over = False
        return self._observation(), {**self._info(), "episode_seed": episode_seed}

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Carry out an action, unless a cut comes first.

        Raises
        ------
        ArgumentError
            The path is over or not begun, or there is no such action.
        """
        if self._state is None or self._is_over:
            raise ArgumentError(f"the path {'is over' if self._state else 'has not begun'}; call reset")
        if not self.action_space.contains(action):
            raise ArgumentError(f"action is {action}; it lies in 0 to {ActionSpace(self.num_objects).num_actions - 1}")
        now = self._state.horizon - int(self._state.steps_to_go)
        key = jax.random.fold_in(self._world_key, now)
        taken = jnp.asarray(action, dtype=jnp.int32)
        after, hidden, outcome = _step(self.config, self._state, self._hidden, taken, key)
        end_s = self._elapsed_s + float(outcome.duration_s)
        if end_s > self._cut_s:
            self._is_over, self._elapsed_s = True, self._cut_s
            return self._observation(), 0.0, False, True, {**self._info(), "cause": CAUSES["independent"]}
        self._state, self._hidden = after, hidden
        self._elapsed_s, self._is_over = end_s, bool(outcome.is_over)
        return self._observation(), float(outcome.reward), self._is_over, False, self._info()

    def render(self) -> str | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Write the table as text, one line an object; None unless the mode is ``"ansi"``."""
        if self.render_mode is None or self._state is None:
            return None
        seen = self._observation()
        lines = [f"{int(self._state.steps_to_go)} steps to go, {self._elapsed_s:.1f} s"]
        for i in np.flatnonzero(seen["is_object"]):
            dirty = 1.0 / (1.0 + np.exp(-seen["log_odds"][i]))
            where = f"hidden {seen['occlusion'][i]:.0%}" if seen["is_on_table"][i] else "in the dishwasher"
            lines.append(f"cup {i}: dirty {dirty:.0%}, {where}")
        return "\n".join(lines)

    def _observation(self) -> Observation:
        assert self._state is not None
        return {name: np.asarray(value) for name, value in observe_table(self._state).items()}

    def _info(self) -> dict[str, Any]:
        assert self._state is not None
        return {"elapsed_s": self._elapsed_s, "action_mask": np.asarray(_mask(self._state))}


_start, _step = jax.jit(start), jax.jit(step)


@jax.jit
def _mask(state: TableState) -> Int[Array, " A"]:
    return possible_actions(state).astype(jnp.int8)


@jax.jit
def observe_table(state: TableState) -> dict[str, Array]:
    """S_t of one table as arrays; padding reads 0."""
    successes, failures = attempt_counts(state)
    return {
        "is_object": state.is_object.astype(jnp.int8),
        "is_on_table": state.is_on_table.astype(jnp.int8),
        "occlusion": occlusion(state),
        "grip": state.grip,
        "log_odds": jnp.where(state.is_object, state.log_odds, 0.0),
        "seen": state.seen,
        "successes": successes.astype(jnp.int32),
        "failures": failures.astype(jnp.int32),
        "lifts": state.lifts,
        "hides": state.hides,
        "attempt_object": state.attempt_object,
        "attempt_occlusion": state.attempt_occlusion,
        "attempt_succeeded": state.attempt_succeeded.astype(jnp.int8),
        "steps_to_go": state.steps_to_go[None],
    }


def table_spaces(layouts: Layout, config: WorldConfig, horizon: int) -> dict[str, Any]:
    """Space of each array that `observe_table` gives, of tables on which so many attempts may be made."""
    num_objects = layouts.is_object.shape[-1]
    share = partial(spaces.Box, 0.0, 1.0, dtype=np.float32)
    count = partial(spaces.Box, 0, horizon, dtype=np.int32)
    bound, firmest = _largest_log_odds(config, horizon), float(np.nanmax(np.abs(layouts.grip), initial=1.0))
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
