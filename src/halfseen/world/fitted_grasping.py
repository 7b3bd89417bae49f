"""A law of grasping whose numbers are fitted to attempts: logistic in the occlusion, with lognormal durations."""

import math
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from halfseen.arrays import Array, at, library_of, record
from halfseen.world import random
from halfseen.world.grasping import Arrangement, Attempt
from halfseen.world.number import Number
from halfseen.world.random import Key


@record
class FittedGrasping:
    """An attempt holds with probability expit(a + b·occ + grip + u), where u ~ N(0, σ²) of each object is hidden.

    The logarithm of its duration is normal, with one mean where it holds and another where it misses; none takes longer
    than the limit. Nothing else moves. The numbers are for attempts to tell, so none has a default.

    Parameters
    ----------
    log_odds
        a, log-odds that an attempt at an object in full view holds, its grip offset 0.
    log_odds_per_occlusion
        b, what is added to it for an object that is wholly hidden.
    offset_std
        σ, standard deviation of u.
    log_held_s, log_missed_s
        Mean logarithm of the duration of an attempt that holds, and of one that misses [log s].
    log_std
        Standard deviation of both, above 0.
    limit_s
        Longest duration of an attempt [s].
    """

    log_odds: Number
    log_odds_per_occlusion: Number
    offset_std: Number
    log_held_s: Number
    log_missed_s: Number
    log_std: Number
    limit_s: Number

    def draw_trait(self, num_objects: int, key: Key) -> Float[Array, "*B N"]:
        """Draw u of each object."""
        return self.offset_std * random.normal(key, num_objects)

    def attempt(
        self,
        table: Arrangement,
        trait: Float[Array, "*B N"],
        verb: Int[Array, "*B"],
        target: Int[Array, "*B"],
        key: Key,
    ) -> Attempt:
        """Draw whether it holds, and then how long it took; whatever is to be done with the object."""
        held_key, time_key = random.split(key)
        log_failure = self.log_failure(at(table.occlusion, target), at(table.grip, target) + at(trait, target))
        is_held, xp = random.log_uniform(held_key) >= log_failure, library_of(log_failure)
        noise = self.log_std * random.normal(time_key)
        log_s = noise + xp.where(is_held, self.log_held_s, self.log_missed_s).astype(noise.dtype)
        return Attempt(is_held, xp.minimum(xp.exp(log_s), self.limit_s), table.hides, trait)

    def log_failure(self, occluded: Any, offset: Any) -> Any:
        """Log P(an attempt misses | occ, offset) = −log(1 + exp(a + b·occ + offset))."""
        log_odds = self.log_odds + self.log_odds_per_occlusion * occluded
        xp = library_of(log_odds, offset)
        # A product, so that there is no exponential for every pair of occlusion and offset.
        return -xp.log1p(xp.exp(log_odds) * xp.exp(offset))

    def expected_s(self, occluded: Any, offset: Any) -> Any:
        """Mean duration over both results, each a lognormal time that is cut at the limit [s]."""
        log_failure = self.log_failure(occluded, offset)
        held_s, missed_s = (self._mean_s(log_s) for log_s in (self.log_held_s, self.log_missed_s))
        return held_s + library_of(log_failure).exp(log_failure) * (missed_s - held_s)

    def _mean_s(self, log_s: Number) -> Any:
        """E min(exp(log_s + log_std·Z), limit_s), with Z ~ N(0, 1) [s]."""
        xp = library_of(log_s, self.log_std, self.limit_s)
        limit = (xp.log(self.limit_s) - log_s) / self.log_std
        within_s = xp.exp(log_s + self.log_std**2 / 2.0) * _below(limit - self.log_std)
        mean_s = within_s + self.limit_s * _below(-limit)
        # A number of NumPy's would make float64 of all float32 that it meets.
        return float(mean_s) if xp is np else mean_s


def _below(limit: Any) -> Any:
    """P(Z < limit), Z ~ N(0, 1)."""
    if library_of(limit) is np:
        return math.erfc(-limit / math.sqrt(2.0)) / 2.0
    from jax.scipy.special import ndtr

    return ndtr(limit)
