"""What must be counted of the looks at one object, and what they tell: the axis of its labels.

An object can be seen in a few ways only (`Views`). Its tally keeps what is needed of the looks so far, and under one
tally all that they may have said lies side by side as the cells of an axis. Where labels are independent given the
truth, that is how often the object was looked at in each view, and a cell is how many of the looks in each view said
DIRTY. Where they are not, it is the sequence of the views that showed something new, and a cell is what was said in
each: of `PersistentSeeing` "not yet found", and "found at the k-th record".
"""

from dataclasses import dataclass
from functools import lru_cache
from math import prod
from typing import NamedTuple, Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.world.seeing import KnownSeeing, is_independent, label_evidence

_MAX_CACHED = 8192

Looks: TypeAlias = tuple[int, ...]
"""What a tally keeps of the looks at an object."""

Cells: TypeAlias = Float[np.ndarray, " cells"]


class Views(NamedTuple):
    """The ways in which an object can be seen."""

    occluded: Float[np.ndarray, " views"]
    is_held: Bool[np.ndarray, " views"]

    @property
    def held(self) -> int:
        """Number of the view of it while it is held up."""
        return int(np.argmax(self.is_held)) if self.is_held.any() else 0


class Look(NamedTuple):
    """One more label of an object: where each cell of its axis goes, and how likely that is."""

    if_clean: Int[np.ndarray, " cells"]
    if_dirty: Int[np.ndarray, " cells"]
    says_dirty: Cells


@runtime_checkable
class Labels(Protocol):
    """The labels of one object, by what its tally keeps of the looks."""

    @property
    def views(self) -> Views:
        """The ways in which it can be seen."""
        ...

    @property
    def nothing(self) -> Looks:
        """What the tally keeps before the first look."""
        ...

    def after(self, looks: Looks, view: int) -> Looks:
        """What it keeps after one more look."""
        ...

    def num_cells(self, looks: Looks) -> int:
        """Number of cells of the axis."""
        ...

    def log_odds(self, looks: Looks) -> Cells:
        """Log-odds of DIRTY in each cell."""
        ...

    def seen(self, looks: Looks) -> Cells:
        """Share of the surface that counts as seen in each cell."""
        ...

    def look(self, looks: Looks, view: int) -> Look | None:
        """What one more label does to the cells; None if it tells nothing."""
        ...


def views_of(seeing: KnownSeeing, occlusions: Float[np.ndarray, " levels"]) -> Views:
    """Return the ways in which an object can be seen: at its occlusions, from 0 up, and held, if that is another."""
    held = len(occlusions)
    views = Views(np.append(occlusions, 0.0), np.arange(held + 1) == held)
    on_table, in_hand = (_told(seeing, 0.0, is_held) for is_held in (False, True))
    return views if on_table != in_hand else Views(*(of[:held] for of in views))


def labels_of(seeing: KnownSeeing, views: Views, prior: float) -> Labels:
    """Return the labels of an object, with the log-odds of DIRTY before the first."""
    return (CountedLabels if is_independent(seeing) else RecordedLabels)(seeing, views, prior)


def _told(seeing: KnownSeeing, occluded: float, is_held: bool) -> tuple[float, ...]:
    positive = seeing.positive(occluded, 0.0, is_held)
    return tuple(map(float, (*positive, *(seeing.after(occluded, 0.0, says, is_held) for says in (False, True)))))


@dataclass(frozen=True, eq=False)
class CountedLabels:
    """Labels that are independent given the truth: a count of looks for each view (a `Labels`)."""

    seeing: KnownSeeing
    views: Views
    prior: float

    @property
    def nothing(self) -> Looks:
        """No look in any view."""
        return (0,) * len(self.views.occluded)

    def after(self, looks: Looks, view: int) -> Looks:
        """Count one more."""
        return (*looks[:view], looks[view] + 1, *looks[view + 1 :])

    def num_cells(self, looks: Looks) -> int:
        """As many as there are ways to share out labels."""
        return prod(count + 1 for count in looks)

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019 bounded, and the entries are small
    def log_odds(self, looks: Looks) -> Cells:
        """Log-odds of DIRTY in each cell."""
        positive = self.seeing.positive(self.views.occluded, 0.0, self.views.is_held)
        if_said, if_not = (label_evidence(*positive, says_dirty) for says_dirty in (True, False))
        said_more = 2 * _dirty_labels(looks) - np.array(looks)[:, None]
        return self.prior + (if_said - if_not) / 2 @ said_more + (if_said + if_not) / 2 @ np.array(looks)

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019
    def seen(self, looks: Looks) -> Cells:
        """Nothing counts as seen."""
        return np.zeros(self.num_cells(looks))

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019
    def look(self, looks: Looks, view: int) -> Look:
        """One label more."""
        labels, shape = _dirty_labels(looks), tuple(count + 1 for count in self.after(looks, view))
        one_more = labels + (np.arange(len(looks)) == view)[:, None]
        positive = self.seeing.positive(self.views.occluded[view], 0.0, self.views.is_held[view])
        if_clean, if_dirty = (np.asarray(np.ravel_multi_index(tuple(told), shape)) for told in (labels, one_more))
        return Look(if_clean, if_dirty, _says_dirty(self.log_odds(looks), *positive))


@dataclass(frozen=True, eq=False)
class RecordedLabels:
    """Labels that depend on former looks: the views in their order, but for those that showed nothing new."""

    seeing: KnownSeeing
    views: Views
    prior: float

    nothing: Looks = ()

    def after(self, looks: Looks, view: int) -> Looks:
        """Append a view that shows something new."""
        return looks if self.look(looks, view) is None else (*looks, view)

    def num_cells(self, looks: Looks) -> int:
        """As many as there are answers."""
        return len(self.log_odds(looks))

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019
    def log_odds(self, looks: Looks) -> Cells:
        """Log-odds of DIRTY in each cell."""
        if not looks:
            return np.array([self.prior])
        before, positive = self.log_odds(looks[:-1]), self._positive(looks[:-1], looks[-1])
        is_news = positive[0] + positive[1] > 0.0
        if_not, if_said = (before + label_evidence(*positive, is_news & says) for says in (False, True))
        return np.append(if_not, if_said[is_news])

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019
    def seen(self, looks: Looks) -> Cells:
        """Share of the surface that counts as seen in each cell."""
        if not looks:
            return np.zeros(1)
        before, is_news = self.seen(looks[:-1]), np.add(*self._positive(looks[:-1], looks[-1])) > 0.0
        if_not, if_said = (self._seen_after(before, looks[-1], says_dirty) for says_dirty in (False, True))
        return np.append(if_not, if_said[is_news])

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019
    def look(self, looks: Looks, view: int) -> Look | None:
        """One label more: a cell in which it may say DIRTY gets a cell beside it, behind all others."""
        positive, cells = self._positive(looks, view), np.arange(self.num_cells(looks))
        is_news = positive[0] + positive[1] > 0.0
        is_seen_more = self._seen_after(self.seen(looks), view, False) != self.seen(looks)
        if not (is_news | is_seen_more).any():
            return None
        if_dirty = np.where(is_news, cells[-1] + np.cumsum(is_news), cells)
        return Look(cells, if_dirty, _says_dirty(self.log_odds(looks), *positive))

    def _positive(self, looks: Looks, view: int) -> tuple[Cells, Cells]:
        seen = self.seen(looks)
        if_dirty, if_clean = self.seeing.positive(self.views.occluded[view], seen, self.views.is_held[view])
        return np.broadcast_to(if_dirty, seen.shape), np.broadcast_to(if_clean, seen.shape)

    def _seen_after(self, seen: Cells, view: int, says_dirty: bool) -> Cells:
        after = self.seeing.after(self.views.occluded[view], seen, says_dirty, self.views.is_held[view])
        return np.broadcast_to(after, seen.shape)


def dirty_in(log_odds: Cells) -> Cells:
    """Probability of DIRTY at given log-odds."""
    return 1.0 / (1.0 + np.exp(-log_odds))


def _says_dirty(log_odds: Cells, if_dirty: Cells | float, if_clean: Cells | float) -> Cells:
    dirty = dirty_in(log_odds)
    return dirty * if_dirty + (1.0 - dirty) * if_clean


def _dirty_labels(looks: Looks) -> Int[np.ndarray, "views cells"]:
    """How many of the looks in each view said DIRTY, cell by cell."""
    return np.indices([count + 1 for count in looks]).reshape(len(looks), -1)
