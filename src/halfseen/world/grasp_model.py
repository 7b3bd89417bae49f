"""What the probability of a grasp may be taken from: one interface for what was learned and what is known."""

from typing import Protocol, runtime_checkable

from jaxtyping import Float

from halfseen.arrays import Array
from halfseen.world.state import TableState


@runtime_checkable
class GraspModel(Protocol):
    """Tells how likely an attempt on each object is to succeed now."""

    def probability(self, state: TableState) -> Float[Array, "*B N"]:
        """P(an attempt succeeds) for each object, given its occlusion and its past attempts."""
        ...
