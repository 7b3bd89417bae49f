"""The table world with grip offsets on a grid, in float64, and what must be counted of a path to know all of it.

Given what is seen, objects are independent, and an object's labels say nothing of its grip. So all that a path tells of
an object that still stands on the table is counted (`CupTally`): how often it was looked at from each occlusion, how
often each of those labels said DIRTY, and how often it was grasped and missed at each occlusion. N objects can be
occluded in no more than 2^(N−1) ways each, so there are few occlusions to count at. What left the table is forgotten.

The looks and attempts make a `Tally`. Under one tally the labels form a full grid: an axis for each object, along which
every combination of "how many of the looks at this occlusion said DIRTY" is one cell. Values are arrays over that grid.
"""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property, lru_cache
from math import prod
from typing import NamedTuple, TypeAlias

import jax
import numpy as np
from jaxtyping import Float, Int

from halfseen.arrays import Hides
from halfseen.planners.belief import known_grasping, known_seeing
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import KnownGrasping
from halfseen.world.number import Number
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
    """Looks and attempts of one object on the table, at each occlusion that it can have."""

    looks: Counts
    failures: Counts
    successes: Counts


Tally: TypeAlias = tuple[CupTally | None, ...]
"""One entry for each object; None once it has left the table."""


class Look(NamedTuple):
    """One more label of an object: where each cell of its axis goes, and how likely that is."""

    if_clean: Int[np.ndarray, " cells"]
    if_dirty: Int[np.ndarray, " cells"]
    says_dirty: Float[np.ndarray, " cells"]


@dataclass(frozen=True, eq=False)
class GridWorld:
    """One table of the world with each grip offset on Gauss–Hermite nodes of its prior.

    Parameters
    ----------
    hides
        ``hides[i, j]`` is the share of object i that j alone hides.
    config
        The world.
    num_grip_nodes
        Number of grip offsets that an object can have.
    """

    hides: Hides
    config: WorldConfig
    num_grip_nodes: int

    @property
    def num_objects(self) -> int:
        """N."""
        return len(self.hides)

    @cached_property
    def grasping(self) -> KnownGrasping:
        """How attempts go, in float64."""
        return jax.tree.map(_in_float64, known_grasping(self.config))

    @cached_property
    def seeing(self) -> KnownSeeing:
        """What looks tell, in float64."""
        return jax.tree.map(_in_float64, known_seeing(self.config))

    @cached_property
    def grip_offsets(self) -> Float[np.ndarray, " G"]:
        """The grip offsets that an object can have."""
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
        seen = np.prod(1.0 - self.hides[:, None] * is_there, axis=2)
        return np.round(1.0 - seen, _SAME_OCCLUSION_DIGITS)

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019 bounded, and the entries are small
    def log_odds(self, cup: int, looks: Counts) -> Float[np.ndarray, " cells"]:
        """Log-odds of DIRTY in each cell of an object's axis."""
        right = self.seeing.accuracy(self.occlusions[cup])
        evidence = np.log(right) - np.log1p(-right)
        prior = np.log(self.config.dirty_share) - np.log1p(-self.config.dirty_share)
        return prior + evidence @ (2 * _dirty_labels(looks) - np.array(looks)[:, None])

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019
    def dirty(self, cup: int, looks: Counts) -> Float[np.ndarray, " cells"]:
        """P(DIRTY) in each cell of an object's axis."""
        return 1.0 / (1.0 + np.exp(-self.log_odds(cup, looks)))

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019
    def look(self, cup: int, looks: Counts, level: int) -> Look:
        """One more label, at the occlusion of index `level`."""
        labels = _dirty_labels(looks)
        shape = tuple(count + 1 + (at == level) for at, count in enumerate(looks))
        one_more = labels + (np.arange(len(looks)) == level)[:, None]
        right = float(self.seeing.accuracy(self.occlusions[cup][level]))
        dirty = self.dirty(cup, looks)
        says_dirty = dirty * right + (1.0 - dirty) * (1.0 - right)
        if_clean, if_dirty = (np.asarray(np.ravel_multi_index(tuple(told), shape)) for told in (labels, one_more))
        return Look(if_clean, if_dirty, says_dirty)

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019
    def attempt(self, cup: int, failures: Counts, successes: Counts, level: int) -> tuple[float, float]:
        """P(an attempt succeeds), and its expected time [s], given an object's past attempts."""
        occluded = self.occlusions[cup][:, None]
        log_failure = self.grasping.log_failure(occluded, self.grip_offsets)
        missed, caught = np.exp(log_failure), -np.expm1(log_failure)
        counts = np.array(failures)[:, None], np.array(successes)[:, None]
        likelihood = self.grip_prior * np.prod(missed ** counts[0] * caught ** counts[1], axis=0)
        grip = likelihood / likelihood.sum()
        expected_s = float(self.config.transport_s) + float(
            grip @ self.grasping.expected_s(occluded, self.grip_offsets)[level]
        )
        return float(grip @ caught[level]), expected_s


def _in_float64(leaf: Number | np.ndarray) -> float | np.ndarray:
    return np.asarray(leaf, dtype=np.float64) if np.ndim(leaf) else float(np.asarray(leaf))


def _dirty_labels(looks: Counts) -> Int[np.ndarray, "levels cells"]:
    """How many of the looks at each occlusion said DIRTY, cell by cell."""
    return np.indices([count + 1 for count in looks]).reshape(len(looks), -1)


def is_there(tally: Tally) -> list[int]:
    """Return the objects that stand on the table."""
    return [cup for cup, told in enumerate(tally) if told is not None]


def num_cells(tally: Tally) -> int:
    """Return the number of cells of a tally's grid."""
    return prod(count + 1 for told in tally if told is not None for count in told.looks)


def first_tally(world: GridWorld) -> Tally:
    """Return the tally before anything was seen."""
    nothing = (tuple(0 for _ in levels) for levels in world.occlusions)
    return tuple(CupTally(none, none, none) for none in nothing)


def current_levels(world: GridWorld, tally: Tally, held: int | None = None) -> list[int]:
    """Index of the occlusion of each object now; one that is held hides nothing and is seen whole."""
    subset = sum(1 << cup for cup in is_there(tally) if cup != held)
    levels = world.level_by_subset[:, subset].tolist()
    return [0 if cup == held else level for cup, level in enumerate(levels)]


def after_attempt(world: GridWorld, tally: Tally, target: int, result: Result) -> Tally:
    """Return the tally after an attempt, before the look that follows it."""
    told, level = tally[target], current_levels(world, tally)[target]
    assert told is not None, "only what stands on the table is attempted"
    if result is Result.WASHED:
        after = None
    elif result is Result.LIFTED:
        after = told._replace(successes=_counted(told.successes, level))
    else:
        after = told._replace(failures=_counted(told.failures, level))
    return (*tally[:target], after, *tally[target + 1 :])


def after_look(world: GridWorld, tally: Tally, held: int | None = None) -> Tally:
    """Return the tally after every object on the table was looked at once."""
    levels = current_levels(world, tally, held)
    return tuple(
        None if told is None else told._replace(looks=_counted(told.looks, level))
        for told, level in zip(tally, levels, strict=True)
    )


def looks_of(world: GridWorld, tally: Tally, held: int | None = None) -> tuple[Look | None, ...]:
    """Return what `after_look` does to each axis of the grid."""
    levels = current_levels(world, tally, held)
    return tuple(
        None if told is None else world.look(cup, told.looks, level)
        for cup, (told, level) in enumerate(zip(tally, levels, strict=True))
    )


def _counted(counts: Counts, level: int) -> Counts:
    return (*counts[:level], counts[level] + 1, *counts[level + 1 :])
