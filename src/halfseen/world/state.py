"""Observed and hidden state of a table and of the robots at it."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from halfseen.arrays import Array, first_last, library_of, record
from halfseen.errors import ArgumentError, SceneError
from halfseen.shapes import Bool, Float, Int
from halfseen.world.config import WorldConfig
from halfseen.world.scene import Scene

NO_ATTEMPT = -1
_IN_CACHE = 65536
"""Array size that fits a core's cache; larger arrays are processed column by column."""


@record
class Robots:
    """What each of K robots is doing, known to all of them."""

    is_busy: Bool[Array, "*B K"]
    """Whether it carries out an action, WAIT included."""
    is_parked: Bool[Array, "*B K"]
    """Whether it has finished for good."""
    verb: Int[Array, "*B K"]
    """Verb of its action; undefined if it is not busy."""
    target: Int[Array, "*B K"]
    """Object of its action; 0 if it has none."""
    since_s: Float[Array, "*B K"]
    """Elapsed time of its action [s]."""
    decisions_to_go: Int[Array, "*B K"]
    """Decisions that it may still make."""
    is_out: Bool[Array, "*B K"] | None = None
    """Whether it has dropped out (battery, e-stop) for good; None if no robot can."""

    @property
    def num_robots(self) -> int:
        """K."""
        return self.is_busy.shape[-1]

    @property
    def is_gone(self) -> Bool[Array, "*B K"]:
        """Which robots are parked or have dropped out."""
        return self.is_parked if self.is_out is None else self.is_parked | self.is_out

    @property
    def is_undecided(self) -> Bool[Array, "*B K"]:
        """Which robots are free to decide."""
        return ~self.is_busy & ~self.is_gone & (self.decisions_to_go > 0)

    @property
    def is_done(self) -> Bool[Array, "*B K"]:
        """Which robots have ended: parked, dropped out, or idle without decisions left."""
        return ~self.is_busy & (self.is_gone | (self.decisions_to_go == 0))


@record
class Workspace:
    """Where robots can work on a table; padding is in no robot's reach and near nothing."""

    is_in_reach: Bool[Array, "*B K N"]
    """Which objects each robot reaches."""
    is_near: Bool[Array, "*B N N"]
    """Pairs of objects too near for two robots at once; True on the diagonal."""


@record
class TableState:
    """S_t: the observed state, on which a policy may depend.

    Objects are padded to N with `is_object` False; other entries of padding are undefined. For a single robot that
    reaches everything, `robots` is None; otherwise the lowest-numbered free robot decides.
    """

    hides: Float[Array, "*B N N"]
    """Share of object i's silhouette that object j alone hides."""
    is_object: Bool[Array, "*B N"]
    """False for padding."""
    is_on_table: Bool[Array, "*B N"]
    """Location: TABLE if True, else DISHWASHER (or padding)."""
    grip: Float[Array, "*B N"]
    """Mean of each object's grip offset, given what is observed of it; see `Arrangement.grip`."""
    log_odds: Float[Array, "*B N"]
    """Log-odds of DIRTY given all labels so far, the prior included."""
    seen: Float[Array, "*B N"]
    """Share of each object's surface in view so far, as counted by the law of seeing; see `LookOutcome.seen`."""
    lifts: Int[Array, "*B N"]
    """Number of successful LIFTs."""
    attempt_object: Int[Array, "*B T"]
    """Object of the k-th attempt that ended, or −1 if none (yet)."""
    attempt_occlusion: Float[Array, "*B T"]
    """Its occlusion at that time."""
    attempt_succeeded: Bool[Array, "*B T"]
    """Whether it was grasped."""
    steps_to_go: Int[Array, "*B"]
    """Number of actions that may still end, over all robots, including the one decided now."""
    attempt_robot: Int[Array, "*B T"] | None = None
    """Number of the robot that made the attempt; None for a single robot, or if unknown."""
    robots: Robots | None = None
    workspace: Workspace | None = None
    decider: Int[Array, "*B"] | None = None
    """Number of the robot that decides."""

    @property
    def num_objects(self) -> int:
        """N, padding included."""
        return self.is_object.shape[-1]

    @property
    def horizon(self) -> int:
        """T, the largest number of decisions of a trajectory."""
        return self.attempt_object.shape[-1]

    @property
    def num_robots(self) -> int:
        """K."""
        return 1 if self.robots is None else self.robots.num_robots


@record
class Pending:
    """Outcome of each robot's action in progress, hidden until it ends."""

    left_s: Float[Array, "*B K"]
    """Remaining time; infinite for WAIT [s]."""
    duration_s: Float[Array, "*B K"]
    """Total duration [s]."""
    is_held: Bool[Array, "*B K"]
    """Whether the object is grasped."""
    occlusion: Float[Array, "*B K"]
    """Occlusion of the object when the attempt began."""
    hides: Float[Array, "*B K N N"]
    """Which object will hide which afterwards, where `is_moved`."""
    is_moved: Bool[Array, "*B K N N"]


@record
class HiddenState:
    """State hidden from policies: the attribute of each object, the laws' latents, and the pending outcomes."""

    is_dirty: Bool[Array, "*B N"]
    grasp_latent: Any
    """Latent of `WorldConfig.grasping`; for the assumed law, u of each object, axes (B, N)."""
    seeing_latent: Any = None
    """Latent of `WorldConfig.seeing`; None for the assumed law."""
    pending: Pending | None = None
    """None for a single robot."""
    until_out_s: Float[Array, "*B K"] | None = None
    """Time until each robot drops out, infinite if it never does; None if no robot can [s]."""


@record
class Layout:
    """Scenes padded to a common number of objects."""

    hides: Float[Array, "*B N N"]
    is_object: Bool[Array, "*B N"]
    grip: Float[Array, "*B N"]
    workspace: Workspace | None = None
    """None for a single robot."""


def pad_scenes(scenes: Sequence[Scene], num_objects: int | None = None) -> Layout:
    """Stack scenes of different sizes into one batch, padded with NaN and masked.

    Raises
    ------
    SceneError
        There is no scene, or one has no object or more than `num_objects`.
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
    hides = padded([scene.hides for scene in scenes], (size, size), np.float32(np.nan))
    grip = padded([scene.grip for scene in scenes], (size,), np.float32(np.nan))
    is_object = np.arange(size) < np.array([[scene.num_objects] for scene in scenes])
    return Layout(hides, is_object, grip)


def padded(arrays: Sequence[Any], shape: tuple[int, ...], fill: Any) -> np.ndarray:
    """Stack arrays, each padded at the end to a shape with `fill`."""
    found = np.full((len(arrays), *shape), fill)
    for k, values in enumerate(arrays):
        found[(k, *map(slice, values.shape))] = values
    return found


def initial_state(config: WorldConfig, layout: Layout) -> TableState:
    """State before the first look: all objects on the table, log-odds at the prior, all robots free."""
    is_object, num_stages = batch_last(layout.is_object), config.num_stages
    xp = library_of(is_object, config.dirty_share)
    batch = is_object.shape[:-1]
    none = xp.zeros_like(is_object, dtype=np.float32)
    prior = xp.log(config.dirty_share) - xp.log1p(-config.dirty_share)
    is_team = layout.workspace is not None
    return TableState(
        hides=xp.where(is_object[..., :, None] & is_object[..., None, :], batch_last(layout.hides, 2), np.float32(0.0)),
        is_object=is_object,
        is_on_table=is_object,
        grip=xp.where(is_object, batch_last(layout.grip), np.float32(0.0)),
        log_odds=none + xp.asarray(prior, dtype=np.float32),
        seen=none,
        lifts=xp.zeros_like(is_object, dtype=np.int32),
        attempt_object=batch_last(xp.full((*batch, num_stages), NO_ATTEMPT, dtype=np.int32)),
        attempt_occlusion=batch_last(xp.zeros((*batch, num_stages), dtype=np.float32)),
        attempt_succeeded=batch_last(xp.zeros((*batch, num_stages), dtype=bool)),
        steps_to_go=xp.full(batch, num_stages, dtype=np.int32),
        attempt_robot=xp.zeros((*batch, num_stages), dtype=np.int32) if is_team else None,
        robots=_free_robots(config, batch, xp) if is_team else None,
        workspace=layout.workspace,
        decider=xp.zeros(batch, dtype=np.int32) if is_team else None,
    )


def _free_robots(config: WorldConfig, batch: tuple[int, ...], xp: Any) -> Robots:
    shape = (*batch, config.num_robots)
    false = xp.zeros(shape, dtype=bool)
    return Robots(
        is_busy=false,
        is_parked=false,
        verb=xp.zeros(shape, dtype=np.int32),
        target=xp.zeros(shape, dtype=np.int32),
        since_s=xp.zeros(shape, dtype=np.float32),
        decisions_to_go=xp.full(shape, config.horizon, dtype=np.int32),
        is_out=None if config.drop_out_rate is None else false,
    )


def nothing_pending(num_robots: int, is_object: Bool[Array, "*B N"]) -> Pending:
    """Pending outcomes of idle robots."""
    xp, (*batch, num_objects) = library_of(is_object), is_object.shape
    none = xp.zeros((*batch, num_robots), dtype=np.float32)
    pairs = (*batch, num_robots, num_objects, num_objects)
    return Pending(
        left_s=none + np.float32(np.inf),
        duration_s=none,
        is_held=none > 0,
        occlusion=none,
        hides=xp.zeros(pairs, dtype=np.float32),
        is_moved=xp.zeros(pairs, dtype=bool),
    )


def batch_last(values: Array, num_axes: int = 1) -> Array:
    """Copy an array to a memory layout with the long batch axes last, behind the short other axes.

    NumPy keeps this layout in its results, and its inner loops then run over the batch.
    """
    if library_of(values) is not np or values.ndim == num_axes:
        return values
    own, last = tuple(range(-num_axes, 0)), tuple(range(num_axes))
    return np.moveaxis(np.ascontiguousarray(np.moveaxis(values, own, last)), last, own)


def numbered(number: Int[Array, "*B"], num: int) -> Bool[Array, "*B k"]:
    """One-hot encoding of each number among 0 to num − 1."""
    xp = library_of(number)
    number = xp.asarray(number)
    return first_last(xp.arange(num).reshape((num,) + (1,) * number.ndim) == number)


def check_goes_on(state: TableState) -> None:
    """Check that a state leaves a decision to make.

    Raises
    ------
    ArgumentError
        The trajectory is over.
    """
    if int(state.steps_to_go) < 1 or not np.asarray(state.is_on_table).any():
        raise ArgumentError("the trajectory is over: no steps to go or no objects left; give a state before its end")


def occlusion(state: TableState) -> Float[Array, "*B N"]:
    """Hidden share of each object now: 1 − Π_j (1 − hides[i, j]·present_j)."""
    return occlusion_by(state.hides, state.is_on_table)


def occlusion_by(hides: Float[Array, "*#B N N"], is_hiding: Bool[Array, "*#B N"]) -> Float[Array, "*B N"]:
    """Hidden share of each object when only the objects in `is_hiding` hide others."""
    xp = library_of(hides, is_hiding)
    # An object that does not hide others counts as a share of 0, even if its share is padding (NaN).
    is_idle = (~is_hiding).astype(np.float32)
    if xp is np and hides.size > _IN_CACHE:
        visible = np.fmax(np.float32(1.0) - hides[..., 0], is_idle[..., 0, None])
        for j in range(1, hides.shape[-1]):
            of_one = np.float32(1.0) - hides[..., j]
            visible *= np.fmax(of_one, is_idle[..., j, None], of_one)
        return np.subtract(np.float32(1.0), visible, visible)
    return np.float32(1.0) - xp.prod(xp.fmax(np.float32(1.0) - hides, is_idle[..., None, :]), axis=-1)


def attempt_counts(state: TableState) -> tuple[Float[Array, "*B N"], Float[Array, "*B N"]]:
    """Numbers of past grasp successes and failures of each object."""
    xp = library_of(state.attempt_object)
    is_mine = state.attempt_object[..., None, :] == xp.arange(state.num_objects)[:, None]
    succeeded = state.attempt_succeeded[..., None, :]
    each = (xp.sum(is_mine & succeeded, axis=-1), xp.sum(is_mine & ~succeeded, axis=-1))
    return each[0].astype(np.float32), each[1].astype(np.float32)
