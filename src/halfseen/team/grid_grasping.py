"""A law of grasping whose durations lie on a grid, so that a table before a team can be solved exactly."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from halfseen.errors import ArgumentError
from halfseen.planners.belief import offset_prior
from halfseen.world.grasping import Arrangement, AssumedGrasping, Attempt, KnownGrasping
from halfseen.world.number import Number, namespace

_SUM_TO_ONE = 1e-6


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
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

    base: KnownGrasping = AssumedGrasping()  # noqa: RUF009 - frozen
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

    def draw_trait(self, num_objects: int, key: Array) -> Float[Array, " N"]:
        """Draw u of each object, on the nodes of the planners' beliefs."""
        nodes, prior = offset_prior()
        drawn = jax.random.categorical(key, jnp.log(jnp.asarray(prior, dtype=jnp.float32)), shape=(num_objects,))
        return self.offset_std * jnp.asarray(nodes, dtype=jnp.float32)[drawn]

    def attempt(
        self, table: Arrangement, trait: Float[Array, " N"], verb: Int[Array, ""], target: Int[Array, ""], key: Array
    ) -> Attempt:
        """Draw whether it holds, and then how long it takes; whatever is to be done with the object."""
        held_key, time_key = jax.random.split(key)
        log_failure = self.log_failure(table.occlusion[target], table.grip[target] + trait[target])
        is_held = jnp.log(jax.random.uniform(held_key)) >= log_failure
        share = jnp.log(jnp.asarray(self.held_share, dtype=jnp.float32))
        time_s = jnp.asarray(self.held_s, dtype=jnp.float32)[jax.random.categorical(time_key, share)]
        return Attempt(is_held, jnp.where(is_held, time_s, self.limit_s), table.hides, trait)

    def log_failure(self, occluded: Any, offset: Any) -> Any:
        """As the base has it."""
        return self.base.log_failure(occluded, offset)

    def expected_s(self, occluded: Any, offset: Any) -> Any:
        """Mean time over both results [s]."""
        log_failure = self.log_failure(occluded, offset)
        held_s = sum(time * share for time, share in zip(self.held_s, self.held_share, strict=True))
        return held_s + namespace(log_failure).exp(log_failure) * (self.limit_s - held_s)
