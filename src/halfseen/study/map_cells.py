"""The grid of the map: kinds of tables and of worlds, and random tables of each kind."""

from dataclasses import dataclass, replace

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
class MapCell:
    """One place of the map.

    Parameters
    ----------
    num_objects
        N.
    occlusion
        Hidden share of an object while all stand on the table, mean over the objects.
    label_gain, reward_wash_clean, grip_offset_std
        `AssumedSeeing.gain`, `WorldConfig.reward_wash_clean`, `AssumedGrasping.offset_std`.
    """

    num_objects: int
    occlusion: float
    label_gain: float
    reward_wash_clean: float
    grip_offset_std: float

    def world(self, base: WorldConfig) -> WorldConfig:
        """The world of this place; all other numbers are those of `base`."""
        grasping, seeing = assumed_laws(base)
        return replace(
            base,
            grasping=replace(grasping, offset_std=self.grip_offset_std),
            seeing=replace(seeing, gain=self.label_gain),
            reward_wash_clean=self.reward_wash_clean,
        )


@dataclass(frozen=True)
class MapDesign:
    """Where the map looks, and how closely.

    At every clutter (N and occlusion) stand the world's own numbers, and each of the variations below by itself.

    Parameters
    ----------
    num_objects, occlusions
        The clutter: N, and mean hidden share of an object.
    label_gains, wash_clean_rewards, grip_offset_stds
        Variations of the world, one at a time.
    num_paths, cut_share
        Of each log; cuts are independent of the task.
    num_tables
        Random tables in each repetition.
    episodes_per_table
        Evaluation episodes of each table.
    worthwhile_share
        The learned policy must gain more than this share of what the best heuristic earns above FINISH at once.
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

    def __post_init__(self) -> None:
        for num_objects in self.num_objects:
            for occlusion in self.occlusions:
                _check_clutter(num_objects, occlusion)
        if not 0.0 < self.cut_share < 1.0:
            raise ArgumentError(f"cut_share of the map is {self.cut_share}; it lies between 0 and 1")


def assumed_laws(world: WorldConfig) -> tuple[AssumedGrasping, AssumedSeeing]:
    """The laws that the map varies."""
    if not (isinstance(world.grasping, AssumedGrasping) and isinstance(world.seeing, AssumedSeeing)):
        raise ArgumentError("the map varies AssumedGrasping and AssumedSeeing; give a world that has them")
    return world.grasping, world.seeing


def map_cells(map_design: MapDesign, base: WorldConfig) -> list[MapCell]:
    """All places: every clutter in the world `base` and in each of its variations."""
    grasping, seeing = assumed_laws(base)
    spread = float(grasping.offset_std)
    worlds = [
        (label_gain, reward, spread)
        for label_gain in map_design.label_gains
        for reward in map_design.wash_clean_rewards
    ]
    worlds += [(float(seeing.gain), float(base.reward_wash_clean), value) for value in map_design.grip_offset_stds]
    clutters = [
        (num_objects, occlusion) for num_objects in map_design.num_objects for occlusion in map_design.occlusions
    ]
    return list(dict.fromkeys(MapCell(*clutter, *world) for world in worlds for clutter in clutters))


def random_tables(num_objects: int, occlusion: float, num_tables: int, rng: np.random.Generator) -> tuple[Scene, ...]:
    """Random tables that all have the same mean occlusion.

    Objects stand one behind the other in a random order, and object i is hidden by every nearer j:
    hides[i, j] = 1 − exp(−s·r_ij) with r_ij ~ Gamma(0.5), so that few pairs hide much. The occlusion of i is
    1 − exp(−s·Σ_j r_ij), and s is such that its mean over the objects of the table is the one that is wanted. With
    the same `rng`, tables of another occlusion are these, denser or looser.

    Parameters
    ----------
    num_objects
        N.
    occlusion
        Mean over the objects of each table, in [0, (N − 1) / N): the nearest object is in full view.
    num_tables
        How many.
    rng
        The only source of chance.

    Raises
    ------
    ArgumentError
        No table of N objects has this mean occlusion.
    """
    _check_clutter(num_objects, occlusion)
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


def _check_clutter(num_objects: int, occlusion: float) -> None:
    largest = (num_objects - 1) / num_objects if num_objects > 0 else 0.0
    if num_objects < 1 or not (0.0 <= occlusion < largest or occlusion == 0.0):
        raise ArgumentError(
            f"a mean occlusion of {occlusion} with {num_objects} objects; the nearest is in full view, so it must be "
            f"0 or lie below {largest:.3g}"
        )
