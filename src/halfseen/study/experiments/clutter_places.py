"""The places of the map, each a kind of tables in a kind of world; and random tables of each kind."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from scipy.optimize import brentq

from halfseen.errors import ArgumentError
from halfseen.planners.belief import known_grasping
from halfseen.shapes import Float
from halfseen.study.setting import Setting
from halfseen.world.config import WorldConfig
from halfseen.world.scene import Scene

RAW_SHAPE = 0.5
"""Of the gamma distribution of who hides whom; below 1, few pairs hide much and many hide next to nothing."""


LawNumber = Literal["gain", "facing"]
"""What tells how good labels are: of `AssumedSeeing` its gain, of `PersistentSeeing` the surface that a look shows."""


@dataclass(frozen=True)
class Place:
    """One place of the map: N, the mean hidden share of an object while all stand, and three numbers of the world.

    These are the `LawNumber` of its law of seeing, `WorldConfig.reward_wash_clean`, and the spread of grip offsets. The
    last field says whether its laws are the assumed ones, whatever those of the study are.
    """

    num_objects: int
    occlusion: float
    labels: float
    reward_wash_clean: float
    grip_offset_std: float
    is_assumed: bool = False

    @classmethod
    def of(cls, world: WorldConfig, is_assumed: bool = False) -> "Place":
        """The place of a world's own numbers; its clutter means nothing."""
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


def label_number(world: WorldConfig) -> LawNumber:
    """What tells how good labels are in a world."""
    for name in get_args(LawNumber):
        if hasattr(world.seeing, name):
            return name
    raise ArgumentError(
        f"the map varies how good labels are, and {type(world.seeing).__name__} has none of "
        f"{', '.join(get_args(LawNumber))}; give a world with AssumedSeeing or PersistentSeeing"
    )


def label_share(number: float, world: WorldConfig) -> float:
    """What is told to people of a `label_number`: share of right labels in full view, or of the surface shown."""
    return number + float(getattr(world.seeing, "floor", 0.0))


def assumed(world: WorldConfig) -> WorldConfig:
    """The same world under the assumed laws."""
    own = WorldConfig()
    return replace(world, grasping=own.grasping, seeing=own.seeing, transport_s=own.transport_s)


FACTORS = ("num_objects", "occlusion", "labels", "reward_wash_clean", "grip_offset_std")
"""What places differ in, the laws apart."""


@dataclass(frozen=True)
class ClutterDesign:
    """The map: at every clutter the world's own numbers, and each of the variations below by itself.

    Clutter is the number of objects N and the mean hidden share of an object. In each repetition, policies are learned
    from `num_trajectories` over `num_tables` random tables, `cut_share` of them cut, independently of the task; by
    `laws` with the help of laws fitted to the same log. Learning is worth it where it gains more than
    `worthwhile_share` of what the best heuristic earns above FINISH at once. Scales multiply the world's own number of
    labels and spread of grip offsets.
    """

    num_objects: tuple[int, ...] = (3, 6, 9)
    occlusions: tuple[float, ...] = (0.1, 0.3, 0.5)
    label_scales: tuple[float, ...] = (0.5, 1.0, 1.5)
    wash_clean_rewards: tuple[float, ...] = (-5.0, -10.0, -20.0)
    grip_scales: tuple[float, ...] = (0.5, 1.0, 1.5)
    num_trajectories: int = 200
    cut_share: float = 1 / 2
    num_tables: int = 20
    episodes_per_table: int = 10
    worthwhile_share: float = 0.05
    laws: bool = True
    most_repetitions: int | None = 8

    def __post_init__(self) -> None:
        for num_objects in self.num_objects:
            for occlusion in self.occlusions:
                check_clutter(num_objects, occlusion)
        if not 0.0 < self.cut_share < 1.0:
            raise ArgumentError(f"cut_share of the map is {self.cut_share}; it lies between 0 and 1")

    def places(self, setting: Setting) -> list[Place]:
        """All places: every clutter in the world and in each of its variations; and under the assumed laws."""
        clutters = [(num_objects, occlusion) for num_objects in self.num_objects for occlusion in self.occlusions]
        kinds = dict.fromkeys(kind for panels in self.panels(setting) for kind in panels)
        return [replace(kind, num_objects=clutter[0], occlusion=clutter[1]) for kind in kinds for clutter in clutters]

    def panels(self, setting: Setting) -> list[list[Place]]:
        """Kinds of worlds, as the map has them in columns.

        Labels by cost of washing a clean object, a column for each cost; last the spread of grip offsets, and the
        assumed laws where the study's are others.
        """
        own = Place.of(setting.world)
        numbers = (min(_scaled_number(own.labels, scale), 1.0) for scale in sorted(self.label_scales))
        labels = [replace(own, labels=number) for number in numbers]
        columns = [
            [replace(each, reward_wash_clean=reward) for each in labels]
            for reward in sorted(self.wash_clean_rewards, reverse=True)
        ]
        spreads = (_scaled_number(own.grip_offset_std, scale) for scale in sorted(self.grip_scales))
        last = [replace(own, grip_offset_std=spread) for spread in spreads]
        others = [] if setting.law is None else [Place.of(assumed(setting.world), is_assumed=True)]
        return [*columns, [*last, *others]]


def _scaled_number(number: float, scale: float) -> float:
    # A product in binary would not be the number that people read; the world's own number stays as it is.
    return number if scale == 1.0 else float(f"{number * scale:.6g}")


def random_tables(
    num_objects: int, occlusion: float, num_tables: int, rng: np.random.Generator, grips: Sequence[float] = ()
) -> tuple[Scene, ...]:
    """Random tables that all have the same mean occlusion, with grip offsets that are drawn from `grips`, if any.

    Objects stand one behind the other in a random order, and object i is hidden by every nearer j:
    hides[i, j] = 1 − exp(−s·r_ij) with r_ij ~ Gamma(0.5), so that few pairs hide much. The occlusion of i is
    1 − exp(−s·Σ_j r_ij), and s is such that its mean over the objects of the table is the one that is wanted. With
    the same `rng`, tables of another occlusion are these, denser or looser. The nearest object is in full view, so
    that the mean lies below (N − 1) / N.
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
    """Refuse a mean occlusion that no table of so many objects has."""
    largest = (num_objects - 1) / num_objects if num_objects > 0 else 0.0
    if num_objects < 1 or not (0.0 <= occlusion < largest or occlusion == 0.0):
        raise ArgumentError(
            f"a mean occlusion of {occlusion} with {num_objects} objects; the nearest is in full view, so it must be "
            f"0 or lie below {largest:.3g}"
        )
