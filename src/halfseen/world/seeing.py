"""Laws of seeing, which draw the labels of a look: the interface, and the default law of the world.

The world only samples from a law (`SeeingLaw`); planners also need its probabilities (`KnownSeeing`). A law is a frozen
record of numbers and handles batches of tables.

Under `PersistentSeeing`, errors persist as long as the view does: a stain that faces away stays hidden.

A look shows a share of an object's surface. The camera is fixed, so its views are nested, and the share of an object
seen so far is the largest share v that a look has shown. By then, a stain on a dirty object has been found with
probability sens(v), and an apparent stain on a clean object with probability fp(v). Both rise with v. If nothing was
found at v, a look that shows v' > v finds a stain with probability

    P(says DIRTY | dirty) = (sens(v') − sens(v)) / (1 − sens(v)),

and likewise with fp for a clean object. So labels are consistent without a latent variable: a look that shows nothing
new finds nothing. Once a stain was found, no further look is informative.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from halfseen.arrays import Array, Number, library_of, record
from halfseen.errors import ArgumentError
from halfseen.shapes import Bool, Float
from halfseen.world import random
from halfseen.world.random import Key


class Glimpse(NamedTuple):
    """View of one look at a table; N objects, padding included."""

    is_seen: Bool[Array, "*B N"]
    """False for objects that have left the table, and for padding."""
    occluded: Float[Array, "*B N"]
    """Hidden share of each object in this look; an object that is held up is fully visible and hides nothing."""
    is_held: Bool[Array, "*B N"]
    """Whether it is held up before the camera, which then sees all sides."""
    seen: Float[Array, "*B N"]
    """Share of its surface that was in view before, as counted by the law; see `LookOutcome.seen`."""


class LookOutcome(NamedTuple):
    """Outcome of one look; its values for objects that were not seen are undefined."""

    log_odds: Float[Array, "*B N"]
    seen: Float[Array, "*B N"]
    """Share of the surface in [0, 1] that looks have covered; 0 for a law under which every look is informative."""
    latent: Any


@runtime_checkable
class SeeingLaw(Protocol):
    """Law of the outcome of looks, for a batch of tables.

    The law must not add evidence twice: it decides which part of a look is new. The observed state that it needs for
    this is `LookOutcome.seen`. Unobserved causes of persistent errors (such as a misleading stain) are the law's latent
    variable: a record or array with a batch axis, or None. The law draws it when the table is set, receives it at every
    look, and returns its new value.
    """

    def draw_latent(self, num_objects: int, key: Key) -> Any:
        """Draw the latent variable of a table that is being set; see `GraspLaw.draw_latent`."""
        ...

    def look(
        self, glimpse: Glimpse, log_odds: Float[Array, "*B N"], is_dirty: Bool[Array, "*B N"], latent: Any, key: Key
    ) -> LookOutcome:
        """Look once at every object on the table.

        Parameters
        ----------
        glimpse
            View of the look.
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

    Each look labels each visible object as DIRTY or not. Given the truth, a label depends on former looks only through
    `LookOutcome.seen`, and not on other objects. If `seen` stays 0, labels are independent (`is_independent`). The
    methods return NumPy arrays (float64) for NumPy arrays, and JAX arrays for JAX arrays; arguments broadcast.
    """

    def positive(self, occluded: Any, seen: Any, is_held: Any = False) -> tuple[Any, Any]:
        """P(a look says DIRTY) for a dirty object, and for a clean one.

        Both are in (0, 1), or 0 if the look shows nothing new.

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
        """Share of the surface that counts as seen after a look with this label; in [0, 1], never falling."""
        ...


def is_independent(law: KnownSeeing) -> bool:
    """Whether every look is informative: after a look in full view, no surface counts as seen."""
    return not any(
        law.after(0.0, 0.0, says_dirty, is_held) for says_dirty in (False, True) for is_held in (False, True)
    )


def label_evidence(if_dirty: Any, if_clean: Any, says_dirty: Any) -> Any:
    """Log-likelihood ratio of a label, from `KnownSeeing.positive`; 0 if the look shows nothing new."""
    xp = library_of(if_dirty, if_clean, says_dirty)
    if_dirty, if_clean = (xp.where(says_dirty, positive, 1.0 - positive) for positive in (if_dirty, if_clean))
    # A label to which the law gives probability 0 carries no evidence: a look without news may still err.
    is_news = if_dirty + if_clean > 0.0
    return xp.log(xp.where(is_news, if_dirty, np.float32(1.0))) - xp.log(xp.where(is_news, if_clean, np.float32(1.0)))


def labelled(
    law: KnownSeeing, glimpse: Glimpse, log_odds: Float[Array, "*B N"], is_dirty: Bool[Array, "*B N"], key: Key
) -> LookOutcome:
    """Draw one label per object from a law's probabilities, given the truth and the share seen, without a latent."""
    if_dirty, if_clean = law.positive(glimpse.occluded, glimpse.seen, glimpse.is_held)
    positive = library_of(is_dirty).where(is_dirty, if_dirty, if_clean)
    says_dirty = random.uniform(key, is_dirty.shape[-1]) < positive
    seen = law.after(glimpse.occluded, glimpse.seen, says_dirty, glimpse.is_held)
    return LookOutcome(log_odds + label_evidence(if_dirty, if_clean, says_dirty), seen, None)


@record
class AssumedSeeing:
    """A label is right with probability floor + gain·(1 − occ)^power, independently at every look.

    The default parameters are this project's own choice.

    Parameters
    ----------
    floor
        Probability for an object that is wholly hidden.
    gain
        Increase for an object in full view.
    power
        Exponent of the visible share, 0 or above.

    Raises
    ------
    ArgumentError
        A label would be right with a probability outside [0, 1].
    """

    floor: Number = 0.5
    gain: Number = 0.3
    power: Number = 1.5

    def __post_init__(self) -> None:
        # Under a JAX transformation, a number may be a tracer without a value.
        if not all(isinstance(number, (int, float)) for number in (self.floor, self.gain, self.power)):
            return
        chances = (self.floor, self.floor + self.gain)
        if not (all(0.0 <= chance <= 1.0 for chance in chances) and 0.0 <= self.power < np.inf):
            raise ArgumentError(
                f"floor is {self.floor}, gain {self.gain} and power {self.power}; give floor and floor + gain in "
                "[0, 1], the probabilities that a label is right, and a power of 0 or above"
            )

    def draw_latent(self, num_objects: int, key: Key) -> None:
        """No latent variable: errors do not persist."""
        return

    def look(
        self, glimpse: Glimpse, log_odds: Float[Array, "*B N"], is_dirty: Bool[Array, "*B N"], latent: None, key: Key
    ) -> LookOutcome:
        """Label each object once; every label is informative."""
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
        """P(a look says DIRTY) for a dirty object, and for a clean one."""
        accuracy = self.accuracy(occluded)
        return accuracy, 1.0 - accuracy

    def after(self, occluded: Any, seen: Any, says_dirty: Any, is_held: Any = False) -> Any:
        """Nothing counts as seen: the next look is as good as this one."""
        return seen


SAME_VIEW = 1e-6
"""Tolerance within which shares are the same view, as occlusions are rounded."""
LEAST_DOUBT = 1e-6
"""Least probability of finding, and of missing, a new stain, so that no label makes the truth certain."""


@record
class PersistentSeeing:
    """A look finds stains only on newly visible surface, with error rates that depend on the share seen.

    Both curves are piecewise linear between the given points and start at 0 where nothing was seen. The parameters are
    fitted to labels, so they have no defaults.

    Parameters
    ----------
    facing
        Share of the surface that an unoccluded object on the table shows, in (0, 1]; an object that is held up shows
        all.
    views
        Shares of the surface, rising, in (0, 1], at which the curves are given.
    sensitivity
        sens at each of `views`: share of dirty objects on which a stain was found by then; non-decreasing, in [0, 1].
    false_alarms
        fp at each of `views`: share of clean objects on which a stain was reported by then; likewise.

    Raises
    ------
    ArgumentError
        A parameter is out of range, or a curve has the wrong length or falls.
    """

    facing: Number
    views: tuple[Number, ...]
    sensitivity: tuple[Number, ...]
    false_alarms: tuple[Number, ...]

    def __post_init__(self) -> None:
        # Under a JAX transformation, a number may be a tracer without a value.
        for name in ("views", "sensitivity", "false_alarms"):
            values = getattr(self, name)
            if all(isinstance(value, (int, float)) for value in values):
                _check_curve(name, values, len(self.views), is_rising=name == "views")
        if isinstance(self.facing, (int, float)) and not 0.0 < self.facing <= 1.0:
            raise ArgumentError(f"facing is {self.facing}; give the share that an object shows, in (0, 1]")

    def draw_latent(self, num_objects: int, key: Key) -> None:
        """No latent variable: the share seen so far is observed."""
        return

    def look(
        self, glimpse: Glimpse, log_odds: Float[Array, "*B N"], is_dirty: Bool[Array, "*B N"], latent: None, key: Key
    ) -> LookOutcome:
        """Label each object once, by its newly visible surface."""
        return labelled(self, glimpse, log_odds, is_dirty, key)

    def in_view(self, occluded: Any, is_held: Any = False) -> Any:
        """Share of the surface that a look shows: `facing` for an unoccluded object on the table, 1 for a held one."""
        return library_of(occluded, is_held).where(is_held, 1.0, self.facing * (1.0 - occluded))

    def positive(self, occluded: Any, seen: Any, is_held: Any = False) -> tuple[Any, Any]:
        """P(a look says DIRTY) for a dirty object, and for a clean one; 0 if it shows nothing new."""
        shown = self.in_view(occluded, is_held)
        before, now, is_new = self._found_by(seen), self._found_by(shown), shown > seen + SAME_VIEW
        return _found_now(is_new, before[0], now[0]), _found_now(is_new, before[1], now[1])

    def after(self, occluded: Any, seen: Any, says_dirty: Any, is_held: Any = False) -> Any:
        """Share of the surface that has been in view; 1 once a stain was found."""
        shown = self.in_view(occluded, is_held)
        xp = library_of(shown, seen, says_dirty)
        return xp.where(says_dirty, 1.0, xp.maximum(seen, shown))

    def found_by(self, share: Float[Array, "..."]) -> Float[Array, "2 ..."]:
        """Shares of dirty objects (sens), and of clean ones (fp), with a stain found by these shares of the surface."""
        return library_of(share).stack(self._found_by(share))

    def _found_by(self, share: Any) -> tuple[Any, Any]:
        """Both curves at a share of the surface; each linear piece adds its rise as far as the share covers it."""
        clip, knots = library_of(share).clip, (0.0, *self.views)
        covered = [clip((share - begin) / (end - begin), 0.0, 1.0) for begin, end in pairwise(knots)]
        return _height(self.sensitivity, covered), _height(self.false_alarms, covered)


def _height(curve: tuple[Number, ...], covered: Sequence[Any]) -> Any:
    rises = zip((0.0, *curve), curve, covered, strict=False)
    return sum((high - low) * each for low, high, each in rises)


def _found_now(is_new: Any, was: Any, then: Any) -> Any:
    """Probability that a look finds what the looks before did not."""
    xp = library_of(is_new, was, then)
    found = (then - was) / xp.maximum(1.0 - was, LEAST_DOUBT)
    return xp.where(is_new, xp.clip(found, LEAST_DOUBT, 1.0 - LEAST_DOUBT), 0.0)


def _check_curve(name: str, values: tuple[Number, ...], length: int, is_rising: bool) -> None:
    steps = np.diff(np.array([0.0, *values]))
    if len(values) != length or not values or values[-1] > 1.0 or (steps <= 0.0 if is_rising else steps < 0.0).any():
        how = "rising from above 0" if is_rising else f"one for each of the {length} views, never falling from 0"
        raise ArgumentError(f"{name} is {values}; give numbers in [0, 1], {how}")
