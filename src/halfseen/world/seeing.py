"""What a look tells: the law of labels that the world takes, and the one that it assumes by default.

A law is drawn from (`SeeingLaw`); who computes ahead needs its probabilities as well (`KnownSeeing`). A law is a frozen
record of numbers, and answers for whole batches of tables.
"""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from halfseen.arrays import Array, library_of, record
from halfseen.world import random
from halfseen.world.number import Number
from halfseen.world.random import Key


class Glimpse(NamedTuple):
    """What one look at a table reaches; N objects, padding included."""

    is_seen: Bool[Array, "*B N"]
    """False for what has left the table, and for padding."""
    occluded: Float[Array, "*B N"]
    """Hidden share of each object in this look; an object that is held up is seen whole and hides nothing."""
    is_held: Bool[Array, "*B N"]
    """Whether it is held up before the camera, which then sees it from all sides."""
    seen: Float[Array, "*B N"]
    """Share of its surface that has been in view before, as the law counts it; see `Told.seen`."""


class Told(NamedTuple):
    """What one look told; of what was not seen it may hold anything."""

    log_odds: Float[Array, "*B N"]
    """Log-odds of DIRTY given all looks so far."""
    seen: Float[Array, "*B N"]
    """Share of the surface in [0, 1] that looks have told of; 0 for a law to which every look is news."""
    trait: Any
    """The hidden trait afterwards."""


@runtime_checkable
class SeeingLaw(Protocol):
    """What looks tell, of as many tables as a batch has.

    It is the law that decides what is news: evidence that a former look already gave must not be added again. What it
    needs for that and anyone may know is `Told.seen`. What makes errors persist and nobody sees (a stain that always
    misleads) is the law's hidden trait: a record or array with an axis for the batch, or None. The law draws it when
    the table is set, is handed it at every look, and hands back what has become of it.
    """

    def draw_trait(self, num_objects: int, key: Key) -> Any:
        """Draw the hidden trait of a table that is being set, as `GraspLaw.draw_trait` does."""
        ...

    def look(
        self, glimpse: Glimpse, log_odds: Float[Array, "*B N"], is_dirty: Bool[Array, "*B N"], trait: Any, key: Key
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

    Each look labels each object that it sees: it says DIRTY, or it does not. Given the truth, a label depends on former
    looks through `Told.seen` alone, and on nothing that concerns other objects. Where `seen` is 0 and stays so, labels
    are independent (`is_independent`). Of NumPy's arrays the methods make NumPy's (float64), of JAX's JAX's; arguments
    broadcast.
    """

    def positive(self, occluded: Any, seen: Any, is_held: Any = False) -> tuple[Any, Any]:
        """Probabilities that a look says DIRTY of an object that is dirty, and of one that is clean.

        Both lie inside (0, 1), or are 0 where the look shows nothing new.

        Parameters
        ----------
        occluded
            Hidden share in this look, in [0, 1].
        seen
            Share of the surface that was in view before.
        is_held
            Whether the object is held up before the camera; then `occluded` is 0.
        """
        ...

    def after(self, occluded: Any, seen: Any, says_dirty: Any, is_held: Any = False) -> Any:
        """Share of the surface that counts as seen after a look, given what it says; in [0, 1], never falling."""
        ...


def is_independent(law: KnownSeeing) -> bool:
    """Whether every look is news: after one in full view, no surface counts as seen."""
    return not any(
        law.after(0.0, 0.0, says_dirty, is_held) for says_dirty in (False, True) for is_held in (False, True)
    )


def label_evidence(if_dirty: Any, if_clean: Any, says_dirty: Any) -> Any:
    """What a label adds to the log-odds of DIRTY, by the probabilities of `KnownSeeing.positive`; 0 without news."""
    xp = library_of(if_dirty, if_clean, says_dirty)
    if_dirty, if_clean = (xp.where(says_dirty, positive, 1.0 - positive) for positive in (if_dirty, if_clean))
    # A look that shows nothing new may still err: what cannot be said by the law tells nothing.
    is_news = if_dirty + if_clean > 0.0
    return xp.log(xp.where(is_news, if_dirty, np.float32(1.0))) - xp.log(xp.where(is_news, if_clean, np.float32(1.0)))


@record
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

    def draw_trait(self, num_objects: int, key: Key) -> None:
        """No trait: errors do not persist."""
        return

    def look(
        self, glimpse: Glimpse, log_odds: Float[Array, "*B N"], is_dirty: Bool[Array, "*B N"], trait: None, key: Key
    ) -> Told:
        """Label each object once; every label is news."""
        accuracy = self.accuracy(glimpse.occluded)
        is_right = random.uniform(key, accuracy.shape[-1]) < accuracy
        xp = library_of(accuracy)
        evidence = xp.log(accuracy) - xp.log(1.0 - accuracy)
        sign = np.float32(2.0) * (is_dirty == is_right) - np.float32(1.0)
        return Told(log_odds + sign * evidence, glimpse.seen, trait)

    def accuracy(self, occluded: Any) -> Any:
        """Probability that a label is right."""
        return self.floor + self.gain * (1.0 - occluded) ** self.power

    def positive(self, occluded: Any, seen: Any, is_held: Any = False) -> tuple[Any, Any]:
        """Probabilities that a look says DIRTY of a dirty object, and of a clean one."""
        accuracy = self.accuracy(occluded)
        return accuracy, 1.0 - accuracy

    def after(self, occluded: Any, seen: Any, says_dirty: Any, is_held: Any = False) -> Any:
        """Nothing counts as seen: the next look is as good as this one."""
        return seen
