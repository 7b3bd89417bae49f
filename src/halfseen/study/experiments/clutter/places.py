"""The places of the map, each a kind of tables in a kind of world; and random tables of each kind."""

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


@dataclass(frozen=True)
class ClutterDesign:
    """The map: at every clutter the world's own numbers, and each of the variations below by itself.

    Clutter is the number of objects N and the mean hidden share of an object. In each repetition, policies are learned
    from `num_paths` over `num_tables` random tables, `cut_share` of them cut, independently of the task. Learning is
    worth it where it gains more than `worthwhile_share` of what the best heuristic earns above FINISH at once.
    """

    num_objects: tuple[int, ...] = (3, 6, 9)
    occlusions: tuple[float, ...] = (0.1, 0.3, 0.5)
    label_gains: tuple[float, ...] = (0.15, 0.3, 0.45)
    wash_clean_rewards: tuple[float, ...] = (-5.0, -10.0, -20.0)
    grip_offset_stds: tuple[float, ...] = (0.5, 1.0, 1.5)
    num_paths: int = 200
    cut_share: float = 1 / 2
    num_tables: int = 20
    episodes_per_table: int = 10
    worthwhile_share: float = 0.05
    most_repetitions: int | None = 8

    def __post_init__(self) -> None:
        for num_objects in self.num_objects:
            for occlusion in self.occlusions:
                check_clutter(num_objects, occlusion)
        if not 0.0 < self.cut_share < 1.0:
            raise ArgumentError(f"cut_share of the map is {self.cut_share}; it lies between 0 and 1")

    def places(self, world: WorldConfig) -> list[Place]:
        """All places: every clutter in the world and in each of its variations."""
        own = Place.of(world)
        worlds = [
            (label_gain, reward, own.grip_offset_std)
            for label_gain in self.label_gains
            for reward in self.wash_clean_rewards
        ]
        worlds += [(own.label_gain, own.reward_wash_clean, spread) for spread in self.grip_offset_stds]
        clutters = [(num_objects, occlusion) for num_objects in self.num_objects for occlusion in self.occlusions]
        return list(dict.fromkeys(Place(*clutter, *numbers) for numbers in worlds for clutter in clutters))


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
