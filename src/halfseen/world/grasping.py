"""How an attempt to grasp goes: the law that the world takes, and the one that it assumes by default.

A law is drawn from (`GraspLaw`); the world, its logs and its Gymnasium face need no more. Who computes ahead instead of
drawing (the planners' beliefs, the exact optimum) needs its probabilities as well (`KnownGrasping`). A law is a frozen
pytree, so that it runs inside compiled calls.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.world.number import Number, namespace


class Arrangement(NamedTuple):
    """How the objects of one table stand when an attempt begins; N of them, padding included."""

    hides: Float[Array, "N N"]
    """Share of object i's silhouette that object j alone hides."""
    is_on_table: Bool[Array, " N"]
    """False in the dishwasher, and for padding."""
    occlusion: Float[Array, " N"]
    """Hidden share of each object now."""
    grip: Float[Array, " N"]
    """Mean of each object's grip offset, from what is seen of it; 0 where nothing sets it apart."""


class Attempt(NamedTuple):
    """How one attempt went."""

    is_held: Bool[Array, ""]
    """Whether the object was grasped (pushed, …: whether the verb worked)."""
    duration_s: Float[Array, ""]
    """Positive; without transport [s]."""
    hides: Float[Array, "N N"]
    """Who hides whom afterwards, as objects may have moved."""
    trait: Any
    """The hidden trait afterwards."""


@runtime_checkable
class GraspLaw(Protocol):
    """How attempts go on one table; `jax.vmap` makes it many.

    What is peculiar to the objects and never seen (how well each can be gripped, say) is the law's hidden trait: any
    pytree, or None. The law draws it when the table is set, is handed it at every attempt, and hands back what has
    become of it.
    """

    @property
    def limit_s(self) -> Number:
        """Longest duration of an attempt, and the duration of one that closes on nothing [s]."""
        ...

    def draw_trait(self, num_objects: int, key: Array) -> Any:
        """Draw the hidden trait of a table that is being set.

        Parameters
        ----------
        num_objects
            N, padding included.
        key
            The only source of randomness.
        """
        ...

    def attempt(
        self, table: Arrangement, trait: Any, verb: Int[Array, ""], target: Int[Array, ""], key: Array
    ) -> Attempt:
        """Attempt a verb on an object that stands on the table.

        Parameters
        ----------
        table
            How the objects stand.
        trait
            The hidden trait.
        verb
            As in `halfseen.world.action_space.Verb`. For FINISH the answer is ignored.
        target
            Number of the object.
        key
            The only source of randomness.
        """
        ...


@runtime_checkable
class KnownGrasping(GraspLaw, Protocol):
    """A `GraspLaw` whose probabilities are known, for planners.

    Its hidden trait is one number u for each object, from N(0, offset_std²), that no attempt changes. The grip offset
    of an object is `Arrangement.grip` + u: its mean shows, the rest does not. Attempts are independent given the offset
    and the occlusion, are the same for every verb, and move nothing. Of NumPy's arrays the methods make NumPy's
    (float64), of JAX's JAX's; arguments broadcast.
    """

    @property
    def offset_std(self) -> Number:
        """Standard deviation of u."""
        ...

    def log_failure(self, occluded: Any, offset: Any) -> Any:
        """Log probability that an attempt fails at a hidden share in [0, 1] and a grip offset."""
        ...

    def expected_s(self, occluded: Any, offset: Any) -> Any:
        """Expected duration of an attempt, held or not, without transport [s]."""
        ...


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class AssumedGrasping:
    """Time to grasp T = exp(a + b·occ − grip − u)·E with E ~ Exp(1) and a hidden u ~ N(0, σ²) of each object.

    `Arrangement.grip` is 0 unless the scene says more. An attempt holds when T ≤ τ and takes min(T, τ); nothing else
    moves. These numbers are this project's own choice.

    Parameters
    ----------
    offset_std
        σ, standard deviation of u.
    log_time, log_time_per_occlusion
        a and b [log s].
    limit_s
        τ [s].
    """

    offset_std: Number = 1.0
    log_time: Number = 0.6
    log_time_per_occlusion: Number = 2.2
    limit_s: Number = 6.0

    def draw_trait(self, num_objects: int, key: Array) -> Float[Array, " N"]:
        """Draw u of each object."""
        return self.offset_std * jax.random.normal(key, (num_objects,))

    def attempt(
        self,
        table: Arrangement,
        trait: Float[Array, " N"],
        verb: Int[Array, ""],
        target: Int[Array, ""],
        key: Array,
    ) -> Attempt:
        """Draw the time to grasp; whatever is to be done with the object."""
        offset = table.grip[target] + trait[target]
        grasp_s = jax.random.exponential(key) * self.scale_s(table.occlusion[target], offset)
        return Attempt(grasp_s <= self.limit_s, jnp.minimum(grasp_s, self.limit_s), table.hides, trait)

    def scale_s(self, occluded: Any, offset: Any) -> Any:
        """Mean time to grasp without a limit: exp(a + b·occ − offset) [s]."""
        exponent = self.log_time + self.log_time_per_occlusion * occluded - offset
        return namespace(exponent).exp(exponent)

    def log_failure(self, occluded: Any, offset: Any) -> Any:
        """Log P(T > τ | occ, offset) = −τ / scale."""
        # The scale is a product of occlusion and offset: no exponential for every pair of them.
        return -self.limit_s / self.scale_s(occluded, 0.0) * namespace(offset).exp(offset)

    def expected_s(self, occluded: Any, offset: Any) -> Any:
        """E min(T, τ) = scale·(1 − P(T > τ)) [s]."""
        log_failure = self.log_failure(occluded, offset)
        return -self.scale_s(occluded, offset) * namespace(log_failure).expm1(log_failure)
