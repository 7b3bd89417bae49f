"""How an attempt to grasp goes: the law that the world takes, and the one that it assumes by default.

A law is drawn from (`GraspLaw`); the world, its logs and its Gymnasium face need no more. Who computes ahead instead of
drawing (the planners' beliefs, the exact optimum) needs its probabilities as well (`KnownGrasping`). A law is a frozen
record of numbers, and answers for whole batches of tables.
"""

from typing import Any, NamedTuple, Protocol, runtime_checkable

from jaxtyping import Bool, Float, Int

from halfseen.arrays import Array, at, library_of, record
from halfseen.world import random
from halfseen.world.number import Number
from halfseen.world.random import Key


class Arrangement(NamedTuple):
    """How the objects of a table stand when an attempt begins; N of them, padding included."""

    hides: Float[Array, "*B N N"]
    """Share of object i's silhouette that object j alone hides."""
    is_on_table: Bool[Array, "*B N"]
    """False in the dishwasher, and for padding."""
    occlusion: Float[Array, "*B N"]
    """Hidden share of each object now."""
    grip: Float[Array, "*B N"]
    """Mean of each object's grip offset, from what is seen of it; 0 where nothing sets it apart."""


class Attempt(NamedTuple):
    """How one attempt went."""

    is_held: Bool[Array, "*B"]
    """Whether the object was grasped (pushed, …: whether the verb worked)."""
    duration_s: Float[Array, "*B"]
    """Positive; without transport [s]."""
    hides: Float[Array, "*B N N"]
    """Who hides whom afterwards, as objects may have moved."""
    trait: Any
    """The hidden trait afterwards."""


@runtime_checkable
class GraspLaw(Protocol):
    """How attempts go, on as many tables as a batch has.

    What is peculiar to the objects and never seen (how well each can be gripped, say) is the law's hidden trait: a
    record or array with an axis for the batch, or None. The law draws it when the table is set, is handed it at every
    attempt, and hands back what has become of it.
    """

    @property
    def limit_s(self) -> Number:
        """Longest duration of an attempt, and the duration of one that closes on nothing [s]."""
        ...

    def draw_trait(self, num_objects: int, key: Key) -> Any:
        """Draw the hidden trait of a table that is being set.

        Parameters
        ----------
        num_objects
            N, padding included.
        key
            Of each table: the only source of randomness.
        """
        ...

    def attempt(
        self, table: Arrangement, trait: Any, verb: Int[Array, "*B"], target: Int[Array, "*B"], key: Key
    ) -> Attempt:
        """Attempt a verb on an object that stands on the table.

        Parameters
        ----------
        table
            How the objects stand.
        trait
            The hidden trait.
        verb
            As in `halfseen.world.actions.Verb`. For FINISH the answer is ignored.
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
    and the occlusion, are the same for every verb, and move nothing. The methods take arrays that broadcast.
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


@record
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
        """Draw the time to grasp; whatever is to be done with the object."""
        offset = at(table.grip, target) + at(trait, target)
        grasp_s = random.exponential(key) * self.scale_s(at(table.occlusion, target), offset)
        is_held = grasp_s <= self.limit_s
        return Attempt(is_held, library_of(grasp_s).minimum(grasp_s, self.limit_s), table.hides, trait)

    def scale_s(self, occluded: Any, offset: Any) -> Any:
        """Mean time to grasp without a limit: exp(a + b·occ − offset) [s]."""
        exponent = self.log_time + self.log_time_per_occlusion * occluded - offset
        return library_of(exponent).exp(exponent)

    def log_failure(self, occluded: Any, offset: Any) -> Any:
        """Log P(T > τ | occ, offset) = −τ / scale."""
        # The scale is a product of occlusion and offset: no exponential for every pair of them.
        return -self.limit_s / self.scale_s(occluded, 0.0) * library_of(offset).exp(offset)

    def expected_s(self, occluded: Any, offset: Any) -> Any:
        """E min(T, τ) = scale·(1 − P(T > τ)) [s]."""
        log_failure = self.log_failure(occluded, offset)
        return -self.scale_s(occluded, offset) * library_of(log_failure).expm1(log_failure)
