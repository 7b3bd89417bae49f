"""The possible labels of one object, as the cells of a grid axis, in float64.

An object has only a few views (`Views`). For a given record of its looks, the possible label histories are the cells of
an axis. If labels are independent given the truth (`CountedLabels`), the record counts the looks in each view, and a
cell counts the looks in each view that said DIRTY. Otherwise (`RecordedLabels`), the record is the sequence of views
that showed something new, and a cell is the label in each: under `PersistentSeeing` "not yet found" or "found at the
k-th record".

Values of a table are arrays over the grid of its objects' axes. A look is applied along one axis after another, since
the labels of different objects are independent given the past.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np

from halfseen.shapes import Bool, Float, Int
from halfseen.world.seeing import KnownSeeing, is_independent, label_evidence

_MAX_CACHED = 8192
Looks: TypeAlias = tuple[int, ...]
"""Record of the looks at an object."""
Grid: TypeAlias = Float[np.ndarray, "..."]
"""Array over the labels of a table: an axis for each object, of length 1 once it has left."""


class Views(NamedTuple):
    """The views in which an object can be seen."""

    occluded: Float[np.ndarray, " views"]
    is_held: Bool[np.ndarray, " views"]

    @property
    def held(self) -> int:
        """Index of the view of the object held up."""
        return int(np.argmax(self.is_held)) if self.is_held.any() else 0


class CellBeliefs(NamedTuple):
    """Belief about the object in each cell."""

    log_odds: Float[np.ndarray, " cells"]
    seen: Float[np.ndarray, " cells"]
    """Share of the surface that counts as seen."""

    @property
    def dirty(self) -> Float[np.ndarray, " cells"]:
        """P(DIRTY)."""
        return 1.0 / (1.0 + np.exp(-self.log_odds))


class LabelTransitions(NamedTuple):
    """One more label of an object: the transitions of the cells of its axis, with their probabilities."""

    looks: Looks
    if_clean: Int[np.ndarray, " cells"]
    if_dirty: Int[np.ndarray, " cells"]
    says_dirty: Float[np.ndarray, " cells"]


@dataclass(frozen=True, eq=False)
class CountedLabels:
    """Labels of one object that are independent given the truth: a count of looks for each view."""

    seeing: KnownSeeing
    views: Views
    prior: float
    """Log-odds of DIRTY before the first label."""

    @property
    def nothing(self) -> Looks:
        """Record before the first look."""
        return (0,) * len(self.views.occluded)

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019 bounded, and the entries are small
    def cells(self, looks: Looks) -> CellBeliefs:
        """Cells of a record of looks."""
        positive = self.seeing.positive(self.views.occluded, 0.0, self.views.is_held)
        if_said, if_not = (label_evidence(*positive, says_dirty) for says_dirty in (True, False))
        said = 2 * _dirty_labels(looks) - np.array(looks)[:, None]
        log_odds = self.prior + (if_said - if_not) / 2 @ said + (if_said + if_not) / 2 @ np.array(looks)
        return CellBeliefs(log_odds, np.zeros_like(log_odds))

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019
    def look(self, looks: Looks, view: int) -> LabelTransitions | None:
        """Transition of one more look; None if it shows nothing new."""
        after = (*looks[:view], looks[view] + 1, *looks[view + 1 :])
        labels, shape = _dirty_labels(looks), [count + 1 for count in after]
        one_more = labels + (np.arange(len(looks)) == view)[:, None]
        if_clean, if_dirty = (np.asarray(np.ravel_multi_index(tuple(each), shape)) for each in (labels, one_more))
        positive = self.seeing.positive(self.views.occluded[view], 0.0, self.views.is_held[view])
        return LabelTransitions(after, if_clean, if_dirty, _says_dirty(self.cells(looks), *positive))


@dataclass(frozen=True, eq=False)
class RecordedLabels:
    """Labels of one object that depend on former looks: its views in order, except those that showed nothing new."""

    seeing: KnownSeeing
    views: Views
    prior: float
    """Log-odds of DIRTY before the first label."""
    nothing: Looks = ()
    """Record before the first look."""

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019
    def cells(self, looks: Looks) -> CellBeliefs:
        """Cells of a record of looks: each look appends a cell for every cell in which it may say DIRTY."""
        if not looks:
            return CellBeliefs(np.array([self.prior]), np.zeros(1))
        before, view = self.cells(looks[:-1]), looks[-1]
        positive = self._positive(before, view)
        is_news = positive[0] + positive[1] > 0.0
        if_not, if_said = (before.log_odds + label_evidence(*positive, is_news & says) for says in (False, True))
        seen = [self._seen_after(before, view, says) for says in (False, True)]
        return CellBeliefs(np.append(if_not, if_said[is_news]), np.append(seen[0], seen[1][is_news]))

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019
    def look(self, looks: Looks, view: int) -> LabelTransitions | None:
        """Transition of one more look; None if it shows nothing new."""
        before, cells = self.cells(looks), np.arange(len(self.cells(looks).seen))
        positive = self._positive(before, view)
        is_news = positive[0] + positive[1] > 0.0
        if not (is_news | (self._seen_after(before, view, False) != before.seen)).any():
            return None
        if_dirty = np.where(is_news, cells[-1] + np.cumsum(is_news), cells)
        return LabelTransitions((*looks, view), cells, if_dirty, _says_dirty(before, *positive))

    def _positive(
        self, before: CellBeliefs, view: int
    ) -> tuple[Float[np.ndarray, " cells"], Float[np.ndarray, " cells"]]:
        if_dirty, if_clean = self.seeing.positive(self.views.occluded[view], before.seen, self.views.is_held[view])
        return np.broadcast_to(if_dirty, before.seen.shape), np.broadcast_to(if_clean, before.seen.shape)

    def _seen_after(self, before: CellBeliefs, view: int, says_dirty: bool) -> Float[np.ndarray, " cells"]:
        after = self.seeing.after(self.views.occluded[view], before.seen, says_dirty, self.views.is_held[view])
        return np.broadcast_to(after, before.seen.shape)


Labels: TypeAlias = CountedLabels | RecordedLabels


def labels_of(seeing: KnownSeeing, occlusions: Float[np.ndarray, " levels"], dirty_share: float) -> Labels:
    """Labels of an object with views at its occlusions, from 0 up, and a held view if it differs."""
    prior = float(np.log(dirty_share) - np.log1p(-dirty_share))
    views = Views(np.append(occlusions, 0.0), np.arange(len(occlusions) + 1) == len(occlusions))
    on_table, in_hand = (
        [*seeing.positive(0.0, 0.0, is_held), *(seeing.after(0.0, 0.0, says, is_held) for says in (False, True))]
        for is_held in (False, True)
    )
    if on_table == in_hand:
        views = Views(*(each[:-1] for each in views))
    return (CountedLabels if is_independent(seeing) else RecordedLabels)(seeing, views, prior)


def _says_dirty(before: CellBeliefs, if_dirty: Grid | float, if_clean: Grid | float) -> Float[np.ndarray, " cells"]:
    return before.dirty * if_dirty + (1.0 - before.dirty) * if_clean


def _dirty_labels(looks: Looks) -> Int[np.ndarray, "views cells"]:
    """Number of looks in each view that said DIRTY, for each cell."""
    return np.indices([count + 1 for count in looks]).reshape(len(looks), -1)


def along(values: Float[np.ndarray, " cells"], axis: int, num_axes: int) -> Grid:
    """Reshape values to lie along one axis of a grid."""
    return values.reshape([-1 if at == axis else 1 for at in range(num_axes)])


def expected_over_labels(values: Grid, looks: tuple[LabelTransitions | None, ...]) -> Grid:
    """Expectation over the labels of a look: from values on the grid after it to values on the grid before it."""
    for axis, look in enumerate(looks):
        if look is not None:
            if_clean, if_dirty = values.take(look.if_clean, axis), values.take(look.if_dirty, axis)
            if_dirty -= if_clean
            if_dirty *= along(look.says_dirty, axis, len(looks))
            values = np.add(if_clean, if_dirty, out=if_clean)
    return values


def spread_over_labels(mass: Grid, looks: tuple[LabelTransitions | None, ...], shape: tuple[int, ...]) -> Grid:
    """Probability of each cell of the grid (of `shape`) after a look, from the probabilities before it.

    The objects' axes are the last of `mass`; leading axes are kept.
    """
    for axis, look in enumerate(looks, start=mass.ndim - len(looks)):
        if look is not None:
            said_dirty = mass * along(look.says_dirty, axis, mass.ndim)
            after = np.zeros((*mass.shape[:axis], shape[axis - mass.ndim], *mass.shape[axis + 1 :]))
            after[(slice(None),) * axis + (look.if_clean,)] += mass - said_dirty
            after[(slice(None),) * axis + (look.if_dirty,)] += said_dirty
            mass = after
    return mass
