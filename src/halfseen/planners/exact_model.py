"""The table world with grip offsets on a grid, in float64, and what must be counted of a path to know all of it.

Given what is seen, objects are independent, and an object's labels say nothing of its grip. So all that a path tells of
an object that still stands on the table is counted (`CupTally`): what its labels take of the looks (`exact_labels`),
and how often it was grasped and missed at each occlusion. N objects can be occluded in no more than 2^(N−1) ways each,
so there are few occlusions to count at. What left the table is forgotten.

The looks and attempts make a `Tally`. Under one tally the labels form a full grid: an axis for each object, along which
everything that they may have said of it is one cell. Values are arrays over that grid.
"""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property, lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from halfseen.arrays import PerObject, mapped
from halfseen.planners.belief import known_grasping, known_seeing
from halfseen.planners.exact_labels import Cells, Labels, Look, Looks, dirty_in, labels_of, views_of
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import KnownGrasping
from halfseen.world.number import Number
from halfseen.world.scene import Scene
from halfseen.world.seeing import KnownSeeing

_SAME_OCCLUSION_DIGITS = 12
_MAX_CACHED = 8192

Counts: TypeAlias = tuple[int, ...]
"""One number for each occlusion that an object can have."""


class Result(IntEnum):
    """What came of an attempt; a WASH and a LIFT that fail tell the same."""

    FAILED = 0
    LIFTED = 1
    WASHED = 2


class CupTally(NamedTuple):
    """Looks at one object on the table, and attempts at each occlusion that it can have."""

    looks: Looks
    failures: Counts
    successes: Counts


Tally: TypeAlias = tuple[CupTally | None, ...]
"""One entry for each object; None once it has left the table."""
Held: TypeAlias = frozenset[int]
"""Objects that are up in the air."""
NOTHING: Held = frozenset()


@dataclass(frozen=True, eq=False)
class GridWorld:
    """One table of the world with each grip offset on Gauss–Hermite nodes of its prior.

    Parameters
    ----------
    scene
        The table.
    config
        The world.
    num_grip_nodes
        Number of grip offsets that an object can have.
    """

    scene: Scene
    config: WorldConfig
    num_grip_nodes: int

    @property
    def num_objects(self) -> int:
        """N."""
        return self.scene.num_objects

    @property
    def grip(self) -> PerObject:
        """Mean of each object's grip offset."""
        return np.asarray(self.scene.grip)

    @cached_property
    def grasping(self) -> KnownGrasping:
        """How attempts go, in float64."""
        return mapped(_in_float64, known_grasping(self.config))

    @cached_property
    def seeing(self) -> KnownSeeing:
        """What looks tell, in float64."""
        return mapped(_in_float64, known_seeing(self.config))

    @cached_property
    def grip_offsets(self) -> Float[np.ndarray, " G"]:
        """What is hidden of the grip offset that an object can have: what comes on top of its mean."""
        return float(self.grasping.offset_std) * np.polynomial.hermite_e.hermegauss(self.num_grip_nodes)[0]

    @cached_property
    def grip_prior(self) -> Float[np.ndarray, " G"]:
        """Prior probability of each of `grip_offsets`."""
        weights = np.polynomial.hermite_e.hermegauss(self.num_grip_nodes)[1]
        return weights / weights.sum()

    @cached_property
    def occlusions(self) -> tuple[Float[np.ndarray, " levels"], ...]:
        """For each object, the distinct occlusions that it can have, from 0 up."""
        return tuple(np.unique(row) for row in self._occlusion_by_subset)

    @cached_property
    def level_by_subset(self) -> Int[np.ndarray, "N subsets"]:
        """Index in `occlusions` of each object while the objects of a subset (bits) stand on the table."""
        rows = zip(self.occlusions, self._occlusion_by_subset, strict=True)
        return np.array([np.searchsorted(levels, row) for levels, row in rows])

    @cached_property
    def _occlusion_by_subset(self) -> Float[np.ndarray, "N subsets"]:
        is_there = np.arange(2**self.num_objects)[:, None] >> np.arange(self.num_objects) & 1
        seen = np.prod(1.0 - self.scene.hides[:, None] * is_there, axis=2)
        return np.round(1.0 - seen, _SAME_OCCLUSION_DIGITS)

    @cached_property
    def labels(self) -> tuple[Labels, ...]:
        """For each object, what its looks may say."""
        prior = float(np.log(self.config.dirty_share) - np.log1p(-self.config.dirty_share))
        return tuple(labels_of(self.seeing, views_of(self.seeing, levels), prior) for levels in self.occlusions)

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019 bounded, and the entries are small
    def dirty(self, cup: int, looks: Looks) -> Cells:
        """P(DIRTY) in each cell of an object's axis."""
        return dirty_in(self.labels[cup].log_odds(looks))

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019
    def attempt(self, cup: int, failures: Counts, successes: Counts, level: int) -> tuple[float, float]:
        """P(an attempt succeeds), and its expected time [s], given an object's past attempts."""
        occluded = self.occlusions[cup][:, None]
        offsets = self.grip[cup] + self.grip_offsets
        log_failure = self.grasping.log_failure(occluded, offsets)
        missed, caught = np.exp(log_failure), -np.expm1(log_failure)
        counts = np.array(failures)[:, None], np.array(successes)[:, None]
        likelihood = self.grip_prior * np.prod(missed ** counts[0] * caught ** counts[1], axis=0)
        grip = likelihood / likelihood.sum()
        expected_s = float(grip @ self.grasping.expected_s(occluded, offsets)[level])
        return float(grip @ caught[level]), float(self.config.transport_s) + expected_s


def _in_float64(leaf: Number | np.ndarray) -> float | np.ndarray:
    return np.asarray(leaf, dtype=np.float64) if np.ndim(leaf) else float(np.asarray(leaf))


def is_there(tally: Tally) -> list[int]:
    """Return the objects that stand on the table."""
    return [cup for cup, told in enumerate(tally) if told is not None]


def grid_shape(world: GridWorld, tally: Tally) -> tuple[int, ...]:
    """Return the length of each object's axis; 1 once it has left."""
    pairs = zip(world.labels, tally, strict=True)
    return tuple(1 if told is None else labels.num_cells(told.looks) for labels, told in pairs)


def first_tally(world: GridWorld) -> Tally:
    """Return the tally before anything was seen."""
    pairs = zip(world.labels, world.occlusions, strict=True)
    return tuple(CupTally(labels.nothing, *[(0,) * len(levels)] * 2) for labels, levels in pairs)


def current_levels(world: GridWorld, tally: Tally, held: Held = NOTHING) -> list[int]:
    """Index of the occlusion of each object now; what is held hides nothing."""
    subset = sum(1 << cup for cup in is_there(tally) if cup not in held)
    return world.level_by_subset[:, subset].tolist()


def current_views(world: GridWorld, tally: Tally, held: Held = NOTHING) -> list[int]:
    """How each object is seen now."""
    views = current_levels(world, tally, held)
    return [world.labels[cup].views.held if cup in held else view for cup, view in enumerate(views)]


def after_attempt(world: GridWorld, tally: Tally, target: int, result: Result) -> Tally:
    """Return the tally after an attempt, before the look that follows it."""
    return after_attempt_at(tally, target, result, current_levels(world, tally)[target])


def after_attempt_at(tally: Tally, target: int, result: Result, level: int) -> Tally:
    """Return the tally after an attempt that began at one of its object's occlusions, before the look that follows."""
    told = tally[target]
    assert told is not None, "only what stands on the table is attempted"
    if result is Result.WASHED:
        after = None
    elif result is Result.LIFTED:
        after = told._replace(successes=_counted(told.successes, level))
    else:
        after = told._replace(failures=_counted(told.failures, level))
    return (*tally[:target], after, *tally[target + 1 :])


def after_look(world: GridWorld, tally: Tally, held: Held = NOTHING) -> Tally:
    """Return the tally after every object on the table was looked at once."""
    return tuple(
        None if told is None else told._replace(looks=labels.after(told.looks, view))
        for told, labels, view in zip(tally, world.labels, current_views(world, tally, held), strict=True)
    )


def looks_of(world: GridWorld, tally: Tally, held: Held = NOTHING) -> tuple[Look | None, ...]:
    """Return what `after_look` does to each axis of the grid; None where nothing new is seen."""
    return tuple(
        None if told is None else labels.look(told.looks, view)
        for told, labels, view in zip(tally, world.labels, current_views(world, tally, held), strict=True)
    )


def _counted(counts: Counts, level: int) -> Counts:
    return (*counts[:level], counts[level] + 1, *counts[level + 1 :])
