"""What the policy sees of a table, and what it does not."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from halfseen.arrays import on_device
from halfseen.errors import ArgumentError, SceneError
from halfseen.world.config import WorldConfig
from halfseen.world.scene import Scene

NO_ATTEMPT = -1


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TableState:
    """S_t: all that a policy may look at (a pytree; `jax.vmap` adds batch axes).

    Objects are padded to N with `is_object` False; their other entries mean nothing.
    """

    hides: Float[Array, "*B N N"]
    """Share of object i's silhouette that object j alone hides."""
    is_object: Bool[Array, "*B N"]
    """False for padding."""
    is_on_table: Bool[Array, "*B N"]
    """Location: TABLE if True, else DISHWASHER (or padding)."""
    grip: Float[Array, "*B N"]
    """Mean of each object's grip offset, from what is seen of it; see `Arrangement.grip`."""
    log_odds: Float[Array, "*B N"]
    """Log-odds of DIRTY given all labels so far, the prior included."""
    seen: Float[Array, "*B N"]
    """Share of each object's surface that has been in view so far, as the law of seeing counts it; see `Told.seen`."""
    lifts: Int[Array, "*B N"]
    """Number of LIFT attempts that succeeded."""
    attempt_object: Int[Array, "*B T"]
    """Object that the k-th step tried to grasp, or -1 if none (yet)."""
    attempt_occlusion: Float[Array, "*B T"]
    """Its occlusion at that time."""
    attempt_succeeded: Bool[Array, "*B T"]
    """Whether it was grasped."""
    steps_to_go: Int[Array, "*B"]
    """Actions left, this one included."""
    attempt_robot: Int[Array, "*B T"] | None = None
    """Number of the robot that made it; None where that does not matter, as all have one law, or is not known."""

    @property
    def num_objects(self) -> int:
        """N, padding included."""
        return self.is_object.shape[-1]

    @property
    def horizon(self) -> int:
        """T, the number of steps that a path may have."""
        return self.attempt_object.shape[-1]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class HiddenState:
    """What no policy sees: the attribute of each object, and what the laws of the world keep to themselves."""

    is_dirty: Bool[Array, "*B N"]
    grasp_trait: Any
    """Of `WorldConfig.grasping`; u of each object, axes (B, N), of the assumed one."""
    seeing_trait: Any = None
    """Of `WorldConfig.seeing`; none of the assumed one."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Layout:
    """Scenes padded to a common number of objects."""

    hides: Float[Array, "*B N N"]
    is_object: Bool[Array, "*B N"]
    grip: Float[Array, "*B N"]


def pad_scenes(scenes: Sequence[Scene], num_objects: int | None = None) -> Layout:
    """Stack scenes of different sizes into one batch, padded with NaN and masked.

    Raises
    ------
    SceneError
        There is no scene, one has no object, or more than `num_objects`.
    """
    if not scenes:
        raise SceneError("no scenes: give at least one")
    for scene in scenes:
        if scene.num_objects == 0:
            raise SceneError(f"{scene.name}: no object is on the table, so there is nothing to decide; leave it out")
    largest = max(scene.num_objects for scene in scenes)
    size = largest if num_objects is None else num_objects
    if size < largest:
        raise SceneError(f"a scene has {largest} objects, more than num_objects={size}; raise num_objects")
    hides = np.full((len(scenes), size, size), np.nan, dtype=np.float32)
    grip = np.full((len(scenes), size), np.nan, dtype=np.float32)
    for k, scene in enumerate(scenes):
        hides[k, : scene.num_objects, : scene.num_objects] = scene.hides
        grip[k, : scene.num_objects] = scene.grip
    is_object = np.arange(size) < np.array([[scene.num_objects] for scene in scenes])
    return Layout(*on_device((hides, is_object, grip)))


def initial_state(config: WorldConfig, layout: Layout) -> TableState:
    """State before anything was seen: all objects on the table, all labels at the prior; one table."""
    num_objects = layout.is_object.shape[-1]
    is_pair = layout.is_object[:, None] & layout.is_object[None, :]
    prior = jnp.log(config.dirty_share) - jnp.log1p(-config.dirty_share)
    return TableState(
        hides=jnp.where(is_pair, layout.hides, 0.0),
        is_object=layout.is_object,
        is_on_table=layout.is_object,
        grip=jnp.where(layout.is_object, layout.grip, 0.0),
        log_odds=jnp.full(num_objects, prior, dtype=jnp.float32),
        seen=jnp.zeros(num_objects, dtype=jnp.float32),
        lifts=jnp.zeros(num_objects, dtype=jnp.int32),
        attempt_object=jnp.full(config.horizon, NO_ATTEMPT, dtype=jnp.int32),
        attempt_occlusion=jnp.zeros(config.horizon, dtype=jnp.float32),
        attempt_succeeded=jnp.zeros(config.horizon, dtype=bool),
        steps_to_go=jnp.asarray(config.horizon, dtype=jnp.int32),
    )


def check_goes_on(state: TableState) -> None:
    """Refuse a state in which nothing is left to decide.

    Raises
    ------
    ArgumentError
        The path is over.
    """
    if int(state.steps_to_go) < 1 or not np.asarray(state.is_on_table).any():
        raise ArgumentError("the path is over: no step to go or no object left; give a state before its end")


def draw_hidden(config: WorldConfig, num_objects: int, key: Array) -> HiddenState:
    """Draw attributes of one table from the prior, and the traits of the laws."""
    dirty_key, grasp_key = jax.random.split(key)
    return HiddenState(
        is_dirty=jax.random.uniform(dirty_key, (num_objects,)) < config.dirty_share,
        grasp_trait=config.grasping.draw_trait(num_objects, grasp_key),
        seeing_trait=config.seeing.draw_trait(num_objects, jax.random.fold_in(key, 2)),
    )


def occlusion(state: TableState) -> Float[Array, " N"]:
    """Hidden share of each object now: 1 − Π_j (1 − hides[i, j]·present_j); one table."""
    return occlusion_without(state, jnp.zeros_like(state.is_on_table))


def occlusion_without(state: TableState, is_taken: Bool[Array, " N"]) -> Float[Array, " N"]:
    """Occlusion if the objects in `is_taken` were not there to hide anything; one table."""
    is_hiding = state.is_on_table & ~is_taken
    return 1.0 - jnp.prod(jnp.where(is_hiding[None, :], 1.0 - state.hides, 1.0), axis=1)


def attempt_counts(state: TableState) -> tuple[Float[Array, " N"], Float[Array, " N"]]:
    """Past grasp successes and failures of each object; one table."""
    is_mine = state.attempt_object[None, :] == jnp.arange(state.num_objects)[:, None]
    successes = jnp.sum(is_mine & state.attempt_succeeded[None, :], axis=1)
    failures = jnp.sum(is_mine & ~state.attempt_succeeded[None, :], axis=1)
    return successes.astype(jnp.float32), failures.astype(jnp.float32)
