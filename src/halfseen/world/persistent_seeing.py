"""A law of seeing whose errors persist as long as the view does: a stain that faces away stays hidden.

A look shows a share of an object's surface. The camera stands still, so views from it are nested, and what has been
seen of an object is the largest share v that a look has shown. By then a stain of a dirty object has been found with
probability sens(v), and a spot that looks like one on a clean object with probability fp(v). Both rise with v, and what
was not found at v is found by a look that shows v' > v with probability

    P(says DIRTY | dirty) = (sens(v') − sens(v)) / (1 − sens(v)),

and likewise by fp for a clean object. So labels are consistent without any hidden trait: a look that shows no more than
was seen before finds nothing. Once something was found, no look is news.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from halfseen.arrays import Array, library_of, record
from halfseen.errors import ArgumentError
from halfseen.world import random
from halfseen.world.number import Number
from halfseen.world.random import Key
from halfseen.world.seeing import Glimpse, Told, label_evidence

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

    def draw_trait(self, num_objects: int, key: Key) -> None:
        """No trait: what was seen so far is known."""
        return

    def look(
        self, glimpse: Glimpse, log_odds: Float[Array, "*B N"], is_dirty: Bool[Array, "*B N"], trait: None, key: Key
    ) -> Told:
        """Look for what is shown for the first time."""
        view = glimpse.occluded, glimpse.seen
        if_dirty, if_clean = self.positive(*view, glimpse.is_held)
        positive = library_of(is_dirty).where(is_dirty, if_dirty, if_clean)
        says_dirty = random.uniform(key, positive.shape[-1]) < positive
        seen = self.after(*view, says_dirty, glimpse.is_held)
        return Told(log_odds + label_evidence(if_dirty, if_clean, says_dirty), seen, trait)

    def in_view(self, occluded: Any, is_held: Any = False) -> Any:
        """Share of the surface that a look shows: of what nothing hides on the table `facing`, of what is held all."""
        return library_of(occluded, is_held).where(is_held, 1.0, self.facing * (1.0 - occluded))

    def positive(self, occluded: Any, seen: Any, is_held: Any = False) -> tuple[Any, Any]:
        """Probabilities that a look says DIRTY of a dirty object, and of a clean one; 0 where it shows nothing new."""
        shown = self.in_view(occluded, is_held)
        return self._found_now(self.sensitivity, shown, seen), self._found_now(self.false_alarms, shown, seen)

    def after(self, occluded: Any, seen: Any, says_dirty: Any, is_held: Any = False) -> Any:
        """Share of the surface that has been in view; all of it counts once something was found."""
        shown = self.in_view(occluded, is_held)
        xp = library_of(shown, seen, says_dirty)
        return xp.where(says_dirty, 1.0, xp.maximum(seen, shown))

    def _found_now(self, curve: tuple[Number, ...], shown: Any, seen: Any) -> Any:
        xp = library_of(shown, seen)
        before, now = (self._found_by(curve, share) for share in (seen, shown))
        found = (now - before) / xp.maximum(1.0 - before, LEAST_DOUBT)
        return xp.where(shown > seen + SAME_VIEW, xp.clip(found, LEAST_DOUBT, 1.0 - LEAST_DOUBT), 0.0)

    def _found_by(self, curve: tuple[Number, ...], share: Any) -> Any:
        """A curve at a share of the surface: each piece adds its rise, as far as the share covers it."""
        clip, knots, heights = library_of(share).clip, (0.0, *self.views), (0.0, *curve)
        pieces = zip(knots[:-1], knots[1:], heights[:-1], heights[1:], strict=True)
        return sum((high - low) * clip((share - begin) / (end - begin), 0.0, 1.0) for begin, end, low, high in pieces)


def _check_curve(name: str, values: tuple[Number, ...], length: int, is_rising: bool) -> None:
    steps = np.diff(np.array([0.0, *values]))
    if len(values) != length or not values or values[-1] > 1.0 or (steps <= 0.0 if is_rising else steps < 0.0).any():
        how = "rising from above 0" if is_rising else f"{length} as there are views, never falling from 0"
        raise ArgumentError(f"{name} is {values}; give numbers in [0, 1], {how}")
