"""A place of the map: a kind of tables in a kind of world; and random tables of each kind."""

from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import root_scalar

from halfseen.errors import ArgumentError
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import AssumedGrasping
from halfseen.world.scene import Scene
from halfseen.world.seeing import AssumedSeeing

RAW_SHAPE = 0.5
"""Of the gamma distribution of who hides whom; below 1, few pairs hide much and many hide next to nothing."""


@dataclass(frozen=True)
class Place:
    """One place of the map: N, the mean hidden share of an object while all stand, and three numbers of the world.

    These are `AssumedSeeing.gain`, `WorldConfig.reward_wash_clean` and `AssumedGrasping.offset_std`.
    """

    num_objects: int
    occlusion: float
    label_gain: float
    reward_wash_clean: float
    grip_offset_std: float

    @classmethod
    def of(cls, world: WorldConfig) -> "Place":
        """The place of a world's own numbers; its clutter means nothing."""
        grasping, seeing = assumed_laws(world)
        return cls(0, 0.0, float(seeing.gain), float(world.reward_wash_clean), float(grasping.offset_std))

    def world(self, base: WorldConfig) -> WorldConfig:
        """The world of this place; all other numbers are those of `base`."""
        grasping, seeing = assumed_laws(base)
        return replace(
            base,
            grasping=replace(grasping, offset_std=self.grip_offset_std),
            seeing=replace(seeing, gain=self.label_gain),
            reward_wash_clean=self.reward_wash_clean,
        )


def assumed_laws(world: WorldConfig) -> tuple[AssumedGrasping, AssumedSeeing]:
    """The laws that the map varies."""
    if not (isinstance(world.grasping, AssumedGrasping) and isinstance(world.seeing, AssumedSeeing)):
        raise ArgumentError("the map varies AssumedGrasping and AssumedSeeing; give a world that has them")
    return world.grasping, world.seeing


FACTORS = tuple(field.name for field in fields(Place))
"""What places differ in."""


def random_tables(num_objects: int, occlusion: float, num_tables: int, rng: np.random.Generator) -> tuple[Scene, ...]:
    """Random tables that all have the same mean occlusion.

    Objects stand one behind the other in a random order, and object i is hidden by every nearer j:
    hides[i, j] = 1 − exp(−s·r_ij) with r_ij ~ Gamma(0.5), so that few pairs hide much. The occlusion of i is
    1 − exp(−s·Σ_j r_ij), and s is such that its mean over the objects of the table is the one that is wanted. With
    the same `rng`, tables of another occlusion are these, denser or looser. The nearest object is in full view, so
    that the mean lies below (N − 1) / N.
    """
    check_clutter(num_objects, occlusion)
    return tuple(Scene(_scaled(_raw(num_objects, rng), occlusion), name=f"random table {k}") for k in range(num_tables))


def _raw(num_objects: int, rng: np.random.Generator) -> Float[np.ndarray, "N N"]:
    behind = np.tril(rng.gamma(RAW_SHAPE, size=(num_objects, num_objects)), -1)
    order = rng.permutation(num_objects)
    return behind[np.ix_(order, order)]


def _scaled(raw: Float[np.ndarray, "N N"], occlusion: float) -> Float[np.ndarray, "N N"]:
    if occlusion == 0.0:
        return np.zeros_like(raw)

    hidden = raw.sum(axis=1)

    def excess(log_scale: float) -> float:
        return float(np.mean(-np.expm1(-np.exp(log_scale) * hidden))) - occlusion

    # 1 − exp(−x) ≤ x, so the scale is at least occlusion / mean(hidden).
    least = float(np.log(occlusion) - np.log(np.mean(hidden))) - 1.0
    log_scale = root_scalar(excess, bracket=(least, 100.0), method="brentq").root
    return -np.expm1(-np.exp(log_scale) * raw)


def check_clutter(num_objects: int, occlusion: float) -> None:
    """Refuse a mean occlusion that no table of so many objects has."""
    largest = (num_objects - 1) / num_objects if num_objects > 0 else 0.0
    if num_objects < 1 or not (0.0 <= occlusion < largest or occlusion == 0.0):
        raise ArgumentError(
            f"a mean occlusion of {occlusion} with {num_objects} objects; the nearest is in full view, so it must be "
            f"0 or lie below {largest:.3g}"
        )
