"""A small table with grip offsets on a grid, in float64, and the sufficient statistics of its trajectories.

To solve a table before several robots exactly, durations lie on a grid, too (`GridGrasping`).

Given the observations, objects are independent, and an object's labels are independent of its grip. So the sufficient
statistics of an object on the table are counts (`Counted`): the record of its looks (`exact_labels`), and the numbers
of successful and failed attempts at each occlusion. Each of N objects has at most 2^(N−1) occlusions, so there are few
counts. Objects that left the table are dropped.
"""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.polynomial.hermite_e import hermegauss

from halfseen.arrays import Array, Number, PerObject, Which, at, library_of, mapped, record
from halfseen.errors import ArgumentError
from halfseen.planners.belief import known_grasping, known_seeing, offset_prior
from halfseen.planners.exact_labels import Grid, Labels, LabelTransitions, Looks, along, labels_of
from halfseen.shapes import Float, Int
from halfseen.world import random
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import Arrangement, AssumedGrasping, Attempt, KnownGrasping
from halfseen.world.random import Key
from halfseen.world.scene import Scene
from halfseen.world.seeing import KnownSeeing

_SUM_TO_ONE = 1e-6


@record
class GridGrasping:
    """Attempts succeed as under another law, with one of a few durations that are independent of the grip.

    The hidden grip offset lies on the quadrature nodes of the planners' beliefs, so that these are exact.

    Parameters
    ----------
    base
        Law of the success of an attempt.
    held_s
        Durations of a successful attempt [s].
    held_share
        Probability of each.
    limit_s
        Duration of a failed attempt, and the longest duration [s].

    Raises
    ------
    ArgumentError
        The numbers of shares and durations differ, the shares do not sum to 1, or a duration is not positive or exceeds
        the limit.
    """

    base: KnownGrasping = AssumedGrasping()
    held_s: tuple[Number, ...] = (2.0, 4.0)
    held_share: tuple[Number, ...] = (0.5, 0.5)
    limit_s: Number = 6.0

    def __post_init__(self) -> None:
        numbers = (*self.held_s, *self.held_share, self.limit_s)
        # Under a JAX transformation, a number may be a tracer without a value.
        if not all(isinstance(number, (int, float)) for number in numbers):
            return
        if len(self.held_s) != len(self.held_share) or abs(sum(self.held_share) - 1.0) > _SUM_TO_ONE:
            raise ArgumentError(f"held_share is {self.held_share}; give one share for each of held_s, with sum 1")
        if not all(0.0 < time <= self.limit_s for time in self.held_s):
            raise ArgumentError(f"held_s is {self.held_s}; give times above 0 and at most limit_s, {self.limit_s}")

    @property
    def offset_std(self) -> Number:
        """Standard deviation of u under the base law."""
        return self.base.offset_std

    def draw_latent(self, num_objects: int, key: Key) -> Float[Array, "*B N"]:
        """Draw u of each object, on the quadrature nodes of the planners' beliefs."""
        xp, (nodes, prior) = library_of(key), offset_prior()
        drawn = random.categorical(key, _log_shares(xp, prior, (*key.shape[:-1], num_objects)))
        return self.offset_std * xp.asarray(nodes, dtype=np.float32)[drawn]

    def attempt(
        self, table: Arrangement, latent: Float[Array, "*B N"], verb: Which, target: Which, key: Key
    ) -> Attempt:
        """Draw success, then duration; the same for all verbs."""
        xp, (held_key, time_key) = library_of(key), random.split(key)
        log_failure = self.log_failure(at(table.occlusion, target), at(table.grip, target) + at(latent, target))
        is_held = random.log_uniform(held_key) >= log_failure
        share = _log_shares(xp, self.held_share, time_key.shape[:-1])
        time_s = xp.asarray(self.held_s, dtype=np.float32)[random.categorical(time_key, share)]
        return Attempt(is_held, xp.where(is_held, time_s, np.float32(self.limit_s)), table.hides, latent)

    def log_failure(self, occluded: Any, offset: Any) -> Any:
        """Log P(an attempt fails) under the base law."""
        return self.base.log_failure(occluded, offset)

    def expected_s(self, occluded: Any, offset: Any) -> Any:
        """Mean duration over both outcomes [s]."""
        log_failure = self.log_failure(occluded, offset)
        held_s = sum(time * share for time, share in zip(self.held_s, self.held_share, strict=True))
        return held_s + library_of(log_failure).exp(log_failure) * (self.limit_s - held_s)


def _log_shares(xp: Any, shares: Any, shape: tuple[int, ...]) -> Float[Array, "*S G"]:
    """Log shares, broadcast to the shape of the draws."""
    logarithms = xp.log(xp.asarray(shares, dtype=np.float32))
    return xp.broadcast_to(logarithms, (*shape, *logarithms.shape))


_SAME_OCCLUSION_DIGITS = 12
Counts: TypeAlias = tuple[int, ...]
"""One count for each possible occlusion of an object."""


@dataclass(frozen=True, eq=False, slots=True)
class Counted:
    """Sufficient statistics of one object; `GridWorld.counted` makes each only once, so identity serves as a key."""

    cup: int
    looks: Looks
    failures: Counts
    """Failed attempts at each possible occlusion of the object."""
    successes: Counts


Tally: TypeAlias = tuple[Counted | None, ...]
"""One entry for each object; None once it has left the table."""
Held: TypeAlias = frozenset[int]
"""Objects that are held up in the air."""
NOTHING: Held = frozenset()
_GONE = None, None


@dataclass(frozen=True, eq=False)
class GridWorld:
    """One table of the world with each grip offset on Gauss–Hermite nodes of its prior."""

    scene: Scene
    config: WorldConfig
    num_grip_nodes: int

    def __post_init__(self) -> None:
        # Cache these methods for the lifetime of the table.
        for name in ("counted", "tried", "seen", "attempt", "washed", "price"):
            object.__setattr__(self, name, cache(getattr(self, name)))

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
        """Law of grasping, in float64."""
        return mapped(_in_float64, known_grasping(self.config))

    @cached_property
    def seeing(self) -> KnownSeeing:
        """Law of seeing, in float64."""
        return mapped(_in_float64, known_seeing(self.config))

    @cached_property
    def grip_offsets(self) -> Float[np.ndarray, " G"]:
        """Nodes of the hidden part of a grip offset, added to its mean."""
        return float(self.grasping.offset_std) * hermegauss(self.num_grip_nodes)[0]

    @cached_property
    def grip_prior(self) -> Float[np.ndarray, " G"]:
        """Prior probability of each of `grip_offsets`."""
        weights = hermegauss(self.num_grip_nodes)[1]
        return weights / weights.sum()

    @cached_property
    def occlusions(self) -> tuple[Float[np.ndarray, " levels"], ...]:
        """For each object, its distinct possible occlusions, from 0 up."""
        return tuple(np.unique(row) for row in self._occlusion_by_subset)

    @cached_property
    def level_by_subset(self) -> Int[np.ndarray, "N subsets"]:
        """Index in `occlusions` of each object when the objects of a subset (bits) are on the table."""
        rows = zip(self.occlusions, self._occlusion_by_subset, strict=True)
        return np.array([np.searchsorted(levels, row) for levels, row in rows])

    @cached_property
    def _occlusion_by_subset(self) -> Float[np.ndarray, "N subsets"]:
        is_there = np.arange(2**self.num_objects)[:, None] >> np.arange(self.num_objects) & 1
        seen = np.prod(1.0 - self.scene.hides[:, None] * is_there, axis=2)
        return np.round(1.0 - seen, _SAME_OCCLUSION_DIGITS)

    @cached_property
    def _levels(self) -> list[list[int]]:
        return self.level_by_subset.T.tolist()

    @cached_property
    def labels(self) -> tuple[Labels, ...]:
        """For each object, its possible labels.

        Raises
        ------
        ArgumentError
            The prior or a label is certain.
        """
        dirty_share = float(self.config.dirty_share)
        _check_between("dirty_share", np.array([dirty_share]))
        labels = tuple(labels_of(self.seeing, levels, dirty_share) for levels in self.occlusions)
        for cup, each in enumerate(labels):
            positive = np.stack(self.seeing.positive(each.views.occluded, 0.0, each.views.is_held))
            # Exclude looks that show nothing: they never say DIRTY and carry no evidence.
            _check_between(f"a label's probability of object {cup}", positive[:, (positive != 0.0).any(axis=0)].ravel())
        return labels

    def counted(self, cup: int, looks: Looks, failures: Counts, successes: Counts) -> Counted:
        """Return the one `Counted` of these statistics."""
        return Counted(cup, looks, failures, successes)

    @property
    def first(self) -> Tally:
        """The tally before the first look."""
        none = [(0,) * len(levels) for levels in self.occlusions]
        return tuple(self.counted(cup, each.nothing, none[cup], none[cup]) for cup, each in enumerate(self.labels))

    def shape(self, tally: Tally) -> tuple[int, ...]:
        """Length of each object's axis; 1 once it has left."""
        pairs = zip(self.labels, tally, strict=True)
        return tuple([1 if each is None else len(labels.cells(each.looks).seen) for labels, each in pairs])

    def levels(self, tally: Tally, held: Held = NOTHING) -> list[int]:
        """Index of the occlusion of each object now; held objects hide nothing."""
        return self._levels[sum([1 << each.cup for each in tally if each is not None and each.cup not in held])]

    def tried(self, counted: Counted, level: int, is_held: bool) -> Counted:
        """Update an object that stays on the table by the outcome of an attempt at one of its occlusions."""
        failures, successes = list(counted.failures), list(counted.successes)
        (successes if is_held else failures)[level] += 1
        return self.counted(counted.cup, counted.looks, tuple(failures), tuple(successes))

    def looked(self, tally: Tally, held: Held) -> tuple[Tally, tuple[LabelTransitions | None, ...]]:
        """Look once at every object on the table: the next tally, and each axis's transition, None if unchanged."""
        levels = self.levels(tally, held)
        seen = [_GONE if each is None else self.seen(each, levels[each.cup], each.cup in held) for each in tally]
        after, looks = zip(*seen, strict=True)
        return after, looks

    def seen(self, counted: Counted, level: int, is_held: bool) -> tuple[Counted, LabelTransitions | None]:
        """Look once at one object, which is occluded by `level` or held up."""
        labels = self.labels[counted.cup]
        look = labels.look(counted.looks, labels.views.held if is_held else level)
        if look is None:
            return counted, None
        return self.counted(counted.cup, look.looks, counted.failures, counted.successes), look

    def attempt(self, cup: int, failures: Counts, successes: Counts, level: int) -> tuple[float, float]:
        """P(an attempt succeeds), and its expected duration with transport [s].

        The arguments are the object, its past failures and successes at each occlusion, and the index of the occlusion
        now.
        """
        occluded = self.occlusions[cup][:, None]
        offsets = self.grip[cup] + self.grip_offsets
        log_failure = self.grasping.log_failure(occluded, offsets)
        missed, caught = np.exp(log_failure), -np.expm1(log_failure)
        counts = np.array(failures)[:, None], np.array(successes)[:, None]
        likelihood = self.grip_prior * np.prod(missed ** counts[0] * caught ** counts[1], axis=0)
        # A past that the law rules out is never reached, but its value must be finite.
        grip = likelihood / likelihood.sum() if likelihood.any() else self.grip_prior
        expected_s = float(grip @ self.grasping.expected_s(occluded, offsets)[level])
        return float(grip @ caught[level]), float(self.config.transport_s) + expected_s

    def washed(self, cup: int, looks: Looks) -> Grid:
        """Expected reward of having washed an object, along its axis of the grid."""
        return self._by_dirt(cup, looks, float(self.config.reward_wash_dirty), float(self.config.reward_wash_clean))

    def price(self, cup: int, looks: Looks) -> Grid:
        """Expected penalty for leaving an object, along its axis of the grid."""
        return self._by_dirt(cup, looks, float(self.config.reward_dirty_left), 0.0)

    def _by_dirt(self, cup: int, looks: Looks, if_dirty: float, if_clean: float) -> Grid:
        dirty = along(self.labels[cup].cells(looks).dirty, cup, self.num_objects)
        return dirty * if_dirty + (1.0 - dirty) * if_clean

    def price_of_left(self, looks: tuple[Looks | None, ...]) -> Grid:
        """Expected penalty for dirty objects left at the end, given the records of looks at the objects left."""
        prices = [self.price(cup, each) for cup, each in enumerate(looks) if each is not None]
        return sum(prices[1:], prices[0]) if prices else np.zeros((1,) * self.num_objects)


def _in_float64(leaf: Number | np.ndarray) -> float | np.ndarray:
    return np.asarray(leaf, dtype=np.float64) if np.ndim(leaf) else float(np.asarray(leaf))


def _check_between(name: str, probabilities: Float[np.ndarray, " k"]) -> None:
    """Check that probabilities are in (0, 1), so that log-odds are finite."""
    wrong = probabilities[~((probabilities > 0.0) & (probabilities < 1.0))]
    if len(wrong):
        raise ArgumentError(f"{name} is {wrong[0]:g}; it must lie strictly between 0 and 1; change config")
