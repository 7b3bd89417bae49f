"""What a look tells: the law of labels that the world takes, and the one that it assumes by default.

A law is drawn from (`SeeingLaw`); who computes ahead needs its probabilities as well (`KnownSeeing`). A law is a frozen
pytree, so that it runs inside compiled calls.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from halfseen.world.number import Number


class Glimpse(NamedTuple):
    """What one look at one table reaches; N objects, padding included."""

    is_seen: Bool[Array, " N"]
    """False for what has left the table, and for padding."""
    occluded: Float[Array, " N"]
    """Hidden share of each object in this look; an object that is held up is seen whole and hides nothing."""


class Told(NamedTuple):
    """What one look told."""

    log_odds: Float[Array, " N"]
    """Log-odds of DIRTY given all looks so far; what was not seen may hold anything."""
    trait: Any
    """The hidden trait afterwards."""


@runtime_checkable
class SeeingLaw(Protocol):
    """What looks at one table tell; `jax.vmap` makes it many.

    What makes errors persist from look to look (a stain that always misleads, the last view that was counted) is the
    law's hidden trait: any pytree, or None. The law draws it when the table is set, is handed it at every look, and
    hands back what has become of it. So it is the law that decides what is news: evidence that a former look already
    gave must not be added again.
    """

    def draw_trait(self, num_objects: int, key: Array) -> Any:
        """Draw the hidden trait of a table that is being set, as `GraspLaw.draw_trait` does."""
        ...

    def look(
        self, glimpse: Glimpse, log_odds: Float[Array, " N"], is_dirty: Bool[Array, " N"], trait: Any, key: Array
    ) -> Told:
        """Look once at every object on the table.

        Parameters
        ----------
        glimpse
            What the look reaches.
        log_odds
            Log-odds of DIRTY before it, the prior included.
        is_dirty
            The truth.
        trait
            The hidden trait.
        key
            The only source of randomness.
        """
        ...


@runtime_checkable
class KnownSeeing(SeeingLaw, Protocol):
    """A `SeeingLaw` whose probabilities are known, for planners.

    Each look labels each object that it sees DIRTY or CLEAN, independently of all other labels given the truth. Of
    NumPy's arrays `accuracy` makes NumPy's (float64), of JAX's JAX's.
    """

    def accuracy(self, occluded: Any) -> Any:
        """Probability that a label is right at a hidden share in [0, 1]: inside (0, 1), not rising with it."""
        ...


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class AssumedSeeing:
    """A label is right with probability floor + gain·(1 − occ)^power, independently at every look.

    These numbers are this project's own choice.

    Parameters
    ----------
    floor
        Probability for an object that is wholly hidden.
    gain
        What is added to it for an object in full view.
    power
        How steeply that falls with occlusion.
    """

    floor: Number = 0.5
    gain: Number = 0.3
    power: Number = 1.5

    def draw_trait(self, num_objects: int, key: Array) -> None:
        """No trait: errors do not persist."""
        return

    def look(
        self, glimpse: Glimpse, log_odds: Float[Array, " N"], is_dirty: Bool[Array, " N"], trait: None, key: Array
    ) -> Told:
        """Label each object once; every label is news."""
        accuracy = self.accuracy(glimpse.occluded)
        is_right = jax.random.uniform(key, accuracy.shape) < accuracy
        evidence = jnp.log(accuracy) - jnp.log1p(-accuracy)
        return Told(log_odds + jnp.where(is_dirty == is_right, evidence, -evidence), trait)

    def accuracy(self, occluded: Any) -> Any:
        """Probability that a label is right."""
        return self.floor + self.gain * (1.0 - occluded) ** self.power
