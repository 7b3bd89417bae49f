"""What a look tells: the law of labels that the world takes, and the one that it assumes by default.

A law is drawn from (`SeeingLaw`); who computes ahead needs its probabilities as well (`KnownSeeing`). A law is a frozen
record of numbers, and answers for whole batches of tables.

A law of seeing whose errors persist as long as the view does: a stain that faces away stays hidden.

A look shows a share of an object's surface. The camera stands still, so views from it are nested, and what has been
seen of an object is the largest share v that a look has shown. By then a stain of a dirty object has been found with
probability sens(v), and a spot that looks like one on a clean object with probability fp(v). Both rise with v, and what
was not found at v is found by a look that shows v' > v with probability

    P(says DIRTY | dirty) = (sens(v') − sens(v)) / (1 − sens(v)),

and likewise by fp for a clean object. So labels are consistent without any latent variable: a look that shows no more
than was seen before finds nothing. Once something was found, no look is news.
"""

from itertools import pairwise
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from halfseen.arrays import Array, Number, library_of, record
from halfseen.errors import ArgumentError
from halfseen.shapes import Bool, Float
from halfseen.world import random
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
    """Share of its surface that has been in view before, as the law counts it; see `LookOutcome.seen`."""


class LookOutcome(NamedTuple):
    """What one look told; of what was not seen it may hold anything."""

    log_odds: Float[Array, "*B N"]
    seen: Float[Array, "*B N"]
    """Share of the surface in [0, 1] that looks have told of; 0 for a law to which every look is news."""
    latent: Any


@runtime_checkable
class SeeingLaw(Protocol):
    """What looks tell, of as many tables as a batch has.

    It is the law that decides what is news: evidence that a former look already gave must not be added again. What it
    needs for that and anyone may know is `LookOutcome.seen`. What makes errors persist and nobody sees (a stain that
    always misleads) is the law's latent variable: a record or array with an axis for the batch, or None. The law draws
    it when the table is set, is handed it at every look, and hands back what has become of it.
    """

    def draw_latent(self, num_objects: int, key: Key) -> Any:
        """Draw the latent variable of a table that is being set, as `GraspLaw.draw_latent` does."""
        ...

    def look(
        self, glimpse: Glimpse, log_odds: Float[Array, "*B N"], is_dirty: Bool[Array, "*B N"], latent: Any, key: Key
    ) -> LookOutcome:
        """Look once at every object on the table.

        Parameters
        ----------
        glimpse
            What the look reaches.
        log_odds
            Log-odds of DIRTY before it, the prior included.
        is_dirty
            The truth.
        latent
            The latent variable.
        key
            The only source of randomness.
        """
        ...


@runtime_checkable
class KnownSeeing(SeeingLaw, Protocol):
    """A `SeeingLaw` whose probabilities are known, for planners.

    Each look labels each object that it sees: it says DIRTY, or it does not. Given the truth, a label depends on former
    looks through `LookOutcome.seen` alone, and on nothing that concerns other objects. Where `seen` is 0 and stays so,
    labels are independent (`is_independent`). Of NumPy's arrays the methods make NumPy's (float64), of JAX's JAX's;
    arguments broadcast.
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


def labelled(
    law: KnownSeeing, glimpse: Glimpse, log_odds: Float[Array, "*B N"], is_dirty: Bool[Array, "*B N"], key: Key
) -> LookOutcome:
    """Label each object once by the probabilities of a law, given the truth and what is known: no latent is needed."""
    if_dirty, if_clean = law.positive(glimpse.occluded, glimpse.seen, glimpse.is_held)
    positive = library_of(is_dirty).where(is_dirty, if_dirty, if_clean)
    says_dirty = random.uniform(key, is_dirty.shape[-1]) < positive
    seen = law.after(glimpse.occluded, glimpse.seen, says_dirty, glimpse.is_held)
    return LookOutcome(log_odds + label_evidence(if_dirty, if_clean, says_dirty), seen, None)


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

    def draw_latent(self, num_objects: int, key: Key) -> None:
        """No latent variable: errors do not persist."""
        return

    def look(
        self, glimpse: Glimpse, log_odds: Float[Array, "*B N"], is_dirty: Bool[Array, "*B N"], latent: None, key: Key
    ) -> LookOutcome:
        """Label each object once; every label is news."""
        accuracy = self.accuracy(glimpse.occluded)
        is_right = random.uniform(key, accuracy.shape[-1]) < accuracy
        xp = library_of(accuracy)
        evidence = xp.log(accuracy) - xp.log(1.0 - accuracy)
        sign = np.float32(2.0) * (is_dirty == is_right) - np.float32(1.0)
        return LookOutcome(log_odds + sign * evidence, glimpse.seen, latent)

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


SAME_VIEW = 1e-6
"""Shares that differ by less are the same view: occlusions are rounded."""
LEAST_DOUBT = 1e-6
"""What is new is found, and missed, with at least this probability, so that no label makes the truth certain."""


@record
class PersistentSeeing:
    """A look finds what it shows for the first time, with a share of errors that grows with what was seen.

    Between the numbers given, both curves are straight lines, and they begin at 0 where nothing was seen. The numbers
    are for labels to tell, so none has a default.

    Parameters
    ----------
    facing
        Share of the surface that an object on the table shows when nothing hides it, in (0, 1]; an object that is held
        up shows all.
    views
        Shares of the surface, rising, in (0, 1], at which the curves are given.
    sensitivity
        sens at each of `views`: share of dirty objects on which a stain was found by then; never falling, in [0, 1].
    false_alarms
        fp at each of `views`: share of clean objects on which one was seemingly found by then; likewise.

    Raises
    ------
    ArgumentError
        The numbers are not as above.
    """

    facing: Number
    views: tuple[Number, ...]
    sensitivity: tuple[Number, ...]
    false_alarms: tuple[Number, ...]

    def __post_init__(self) -> None:
        # Under a transformation a number may be a placeholder without a value.
        for name in ("views", "sensitivity", "false_alarms"):
            values = getattr(self, name)
            if all(isinstance(value, (int, float)) for value in values):
                _check_curve(name, values, len(self.views), is_rising=name == "views")
        if isinstance(self.facing, (int, float)) and not 0.0 < self.facing <= 1.0:
            raise ArgumentError(f"facing is {self.facing}; the share that an object shows lies in (0, 1]")

    def draw_latent(self, num_objects: int, key: Key) -> None:
        """No latent variable: what was seen so far is known."""
        return

    def look(
        self, glimpse: Glimpse, log_odds: Float[Array, "*B N"], is_dirty: Bool[Array, "*B N"], latent: None, key: Key
    ) -> LookOutcome:
        """Look for what is shown for the first time."""
        return labelled(self, glimpse, log_odds, is_dirty, key)

    def in_view(self, occluded: Any, is_held: Any = False) -> Any:
        """Share of the surface that a look shows: of what nothing hides on the table `facing`, of what is held all."""
        return library_of(occluded, is_held).where(is_held, 1.0, self.facing * (1.0 - occluded))

    def positive(self, occluded: Any, seen: Any, is_held: Any = False) -> tuple[Any, Any]:
        """Probabilities that a look says DIRTY of a dirty object, and of a clean one; 0 where it shows nothing new."""
        shown = self.in_view(occluded, is_held)
        xp, before, now = library_of(shown, seen), self._found_by(seen), self._found_by(shown)
        is_new = shown > seen + SAME_VIEW

        def found_now(was: Any, then: Any) -> Any:
            found = (then - was) / xp.maximum(1.0 - was, LEAST_DOUBT)
            return xp.where(is_new, xp.clip(found, LEAST_DOUBT, 1.0 - LEAST_DOUBT), 0.0)

        return found_now(before[0], now[0]), found_now(before[1], now[1])

    def after(self, occluded: Any, seen: Any, says_dirty: Any, is_held: Any = False) -> Any:
        """Share of the surface that has been in view; all of it counts once something was found."""
        shown = self.in_view(occluded, is_held)
        xp = library_of(shown, seen, says_dirty)
        return xp.where(says_dirty, 1.0, xp.maximum(seen, shown))

    def found_by(self, share: Float[Array, "..."]) -> Float[Array, "2 ..."]:
        """Shares of dirty objects, and of clean ones, on which something was found by these shares of the surface."""
        return library_of(share).stack(self._found_by(share))

    def _found_by(self, share: Any) -> tuple[Any, Any]:
        """Both curves at a share of the surface: each piece adds its rise, as far as the share covers it."""
        clip, knots = library_of(share).clip, (0.0, *self.views)
        covered = [clip((share - begin) / (end - begin), 0.0, 1.0) for begin, end in pairwise(knots)]

        def height(curve: tuple[Number, ...]) -> Any:
            heights = (0.0, *curve)
            rises = zip(heights[:-1], heights[1:], covered, strict=True)
            return sum((high - low) * each for low, high, each in rises)

        return height(self.sensitivity), height(self.false_alarms)


def _check_curve(name: str, values: tuple[Number, ...], length: int, is_rising: bool) -> None:
    steps = np.diff(np.array([0.0, *values]))
    if len(values) != length or not values or values[-1] > 1.0 or (steps <= 0.0 if is_rising else steps < 0.0).any():
        how = "rising from above 0" if is_rising else f"{length} as there are views, never falling from 0"
        raise ArgumentError(f"{name} is {values}; give numbers in [0, 1], {how}")
