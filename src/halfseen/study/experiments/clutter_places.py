"""Places of the map of clutter: their worlds, and random tables of one mean occlusion."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from halfseen.errors import ArgumentError
from halfseen.planners.belief import known_grasping
from halfseen.shapes import Float
from halfseen.world.config import WorldConfig
from halfseen.world.scene import Scene

RAW_SHAPE = 0.5
"""Shape of the gamma distribution of pairwise occlusion; below 1, few pairs hide much and many hide next to nothing."""
LABEL_NUMBERS = ("gain", "facing")
"""Quality of labels: the gain of `AssumedSeeing`, or the surface that a look shows in `PersistentSeeing`."""
FACTORS = ("num_objects", "occlusion", "labels", "reward_wash_clean", "grip_offset_std")
"""Factors in which places differ, besides the laws."""


@dataclass(frozen=True)
class Place:
    """One place of the map: N, the mean hidden share of an object while all stand, and three numbers of the world.

    These are the `label_number` of its law of seeing, `WorldConfig.reward_wash_clean`, and the spread of grip offsets.
    The last field is whether its laws are the assumed ones, whatever the study's are.
    """

    num_objects: int
    occlusion: float
    labels: float
    reward_wash_clean: float
    grip_offset_std: float
    is_assumed: bool = False

    @classmethod
    def of(cls, world: WorldConfig, is_assumed: bool = False) -> "Place":
        """The place with a world's own numbers; its clutter is arbitrary."""
        spread = float(known_grasping(world).offset_std)
        number = float(getattr(world.seeing, label_number(world)))
        return cls(0, 0.0, number, float(world.reward_wash_clean), spread, is_assumed)

    def world(self, base: WorldConfig) -> WorldConfig:
        """The world of this place; all other numbers are those of `base`, or of the assumed laws."""
        base = assumed(base) if self.is_assumed else base
        grasping: Any = base.grasping
        seeing: Any = base.seeing
        return replace(
            base,
            grasping=replace(grasping, offset_std=self.grip_offset_std),
            seeing=replace(seeing, **{label_number(base): self.labels}),
            reward_wash_clean=self.reward_wash_clean,
        )


def label_number(world: WorldConfig) -> str:
    """Name of the number for the quality of labels in a world."""
    found = [name for name in LABEL_NUMBERS if hasattr(world.seeing, name)]
    if not found:
        raise ArgumentError(
            f"the map varies how good labels are, but {type(world.seeing).__name__} has none of "
            f"{', '.join(LABEL_NUMBERS)}; give a world with AssumedSeeing or PersistentSeeing"
        )
    return found[0]


def label_share(number: float, world: WorldConfig) -> float:
    """A `label_number` as shown to readers: share of right labels in full view, or of the surface shown."""
    return number + float(getattr(world.seeing, "floor", 0.0))


def assumed(world: WorldConfig) -> WorldConfig:
    """The same world under the assumed laws."""
    own = WorldConfig()
    return replace(world, grasping=own.grasping, seeing=own.seeing, transport_s=own.transport_s)


def random_tables(
    num_objects: int, occlusion: float, num_tables: int, rng: np.random.Generator, grips: Sequence[float] = ()
) -> tuple[Scene, ...]:
    """Random tables with the same mean occlusion, with grip offsets drawn from `grips`, if any.

    Objects stand one behind the other in a random order, and object i is hidden by every nearer j:
    hides[i, j] = 1 − exp(−s·r_ij) with r_ij ~ Gamma(0.5), so that few pairs hide much. The occlusion of i is
    1 − exp(−s·Σ_j r_ij), and s is chosen so that its mean over the objects of the table is `occlusion`. With the same
    `rng`, tables of another occlusion are these, denser or looser. The nearest object is in full view, so the mean is
    below (N − 1) / N.
    """
    check_clutter(num_objects, occlusion)
    hides = [_scaled(_raw(num_objects, rng), occlusion) for _ in range(num_tables)]
    grip = rng.choice(grips, (num_tables, num_objects)) if len(grips) else np.zeros((num_tables, num_objects))
    return tuple(Scene(hides[k], f"random table {k}", grip[k]) for k in range(num_tables))


def _raw(num_objects: int, rng: np.random.Generator) -> Float[np.ndarray, "N N"]:
    behind = np.tril(rng.gamma(RAW_SHAPE, size=(num_objects, num_objects)), -1)
    order = rng.permutation(num_objects)
    return behind[np.ix_(order, order)]


def _scaled(raw: Float[np.ndarray, "N N"], occlusion: float) -> Float[np.ndarray, "N N"]:
    if occlusion == 0.0:
        return np.zeros_like(raw)
    hidden = raw.sum(axis=1)
    # 1 − exp(−x) ≤ x, so the scale is at least occlusion / mean(hidden).
    least = float(np.log(occlusion) - np.log(np.mean(hidden))) - 1.0
    log_scale: Any = brentq(lambda log: float(np.mean(-np.expm1(-np.exp(log) * hidden))) - occlusion, least, 100.0)
    return -np.expm1(-np.exp(log_scale) * raw)


def check_clutter(num_objects: int, occlusion: float) -> None:
    """Refuse a mean occlusion that no table with this number of objects has."""
    largest = (num_objects - 1) / num_objects if num_objects > 0 else 0.0
    if num_objects < 1 or not (0.0 <= occlusion < largest or occlusion == 0.0):
        raise ArgumentError(
            f"a mean occlusion of {occlusion} with {num_objects} objects; the nearest is in full view, so it must be "
            f"0 or lie below {largest:.3g}"
        )
