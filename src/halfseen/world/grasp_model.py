"""What the probability of a grasp may be taken from: one interface for what was learned and what is known."""

from typing import Protocol, runtime_checkable

from jaxtyping import Array, Float

from halfseen.world.state import TableState


@runtime_checkable
class GraspModel(Protocol):
    """Tells how likely an attempt on each object is to succeed now; a pytree, so that it runs inside a policy."""

    def probability(self, state: TableState) -> Float[Array, " N"]:
        """P(an attempt succeeds) for each object of one table, given its occlusion and its past attempts."""
        ...
