"""A law of grasping whose durations lie on a grid, so that a table before several robots can be solved exactly."""

from typing import Any

import numpy as np

from halfseen.arrays import Array, at, library_of, record
from halfseen.errors import ArgumentError
from halfseen.planners.belief import offset_prior
from halfseen.shapes import Float
from halfseen.world import random
from halfseen.world.grasping import Arrangement, AssumedGrasping, Attempt, KnownGrasping
from halfseen.world.number import Number, Which
from halfseen.world.random import Key

_SUM_TO_ONE = 1e-6


@record
class GridGrasping:
    """Attempts hold as another law has it, and take one of a few times that tell nothing of the grip.

    What is hidden of a grip lies on the nodes by which the planners' beliefs integrate, so that those are exact.

    Parameters
    ----------
    base
        Tells how likely an attempt holds.
    held_s
        Times that an attempt takes that holds [s].
    held_share
        Probability of each.
    limit_s
        Time of an attempt that misses, and the longest there is [s].

    Raises
    ------
    ArgumentError
        There are not as many shares as times, they do not sum to 1, or a time is not above 0 or above the limit.
    """

    base: KnownGrasping = AssumedGrasping()
    held_s: tuple[Number, ...] = (2.0, 4.0)
    held_share: tuple[Number, ...] = (0.5, 0.5)
    limit_s: Number = 6.0

    def __post_init__(self) -> None:
        numbers = (*self.held_s, *self.held_share, self.limit_s)
        # Under a transformation a number may be a placeholder without a value.
        if not all(isinstance(number, (int, float)) for number in numbers):
            return
        if len(self.held_s) != len(self.held_share) or abs(sum(self.held_share) - 1.0) > _SUM_TO_ONE:
            raise ArgumentError(f"held_share is {self.held_share}; give one share for each of held_s, that sum to 1")
        if not all(0.0 < time <= self.limit_s for time in self.held_s):
            raise ArgumentError(f"held_s is {self.held_s}; times lie above 0 and not above limit_s, {self.limit_s}")

    @property
    def offset_std(self) -> Number:
        """Of the law that tells how likely an attempt holds."""
        return self.base.offset_std

    def draw_latent(self, num_objects: int, key: Key) -> Float[Array, "*B N"]:
        """Draw u of each object, on the nodes of the planners' beliefs."""
        xp, (nodes, prior) = library_of(key), offset_prior()
        drawn = random.categorical(key, _log_shares(xp, prior, (*key.shape[:-1], num_objects)))
        return self.offset_std * xp.asarray(nodes, dtype=np.float32)[drawn]

    def attempt(
        self, table: Arrangement, latent: Float[Array, "*B N"], verb: Which, target: Which, key: Key
    ) -> Attempt:
        """Draw whether it holds, and then how long it takes; whatever is to be done with the object."""
        xp, (held_key, time_key) = library_of(key), random.split(key)
        log_failure = self.log_failure(at(table.occlusion, target), at(table.grip, target) + at(latent, target))
        is_held = random.log_uniform(held_key) >= log_failure
        share = _log_shares(xp, self.held_share, time_key.shape[:-1])
        time_s = xp.asarray(self.held_s, dtype=np.float32)[random.categorical(time_key, share)]
        return Attempt(is_held, xp.where(is_held, time_s, np.float32(self.limit_s)), table.hides, latent)

    def log_failure(self, occluded: Any, offset: Any) -> Any:
        """As the base has it."""
        return self.base.log_failure(occluded, offset)

    def expected_s(self, occluded: Any, offset: Any) -> Any:
        """Mean time over both results [s]."""
        log_failure = self.log_failure(occluded, offset)
        held_s = sum(time * share for time, share in zip(self.held_s, self.held_share, strict=True))
        return held_s + library_of(log_failure).exp(log_failure) * (self.limit_s - held_s)


def _log_shares(xp: Any, shares: Any, shape: tuple[int, ...]) -> Float[Array, "*S G"]:
    """Logarithms of shares, for each of so many draws."""
    logarithms = xp.log(xp.asarray(shares, dtype=np.float32))
    return xp.broadcast_to(logarithms, (*shape, *logarithms.shape))
