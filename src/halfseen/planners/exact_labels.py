"""What the looks at one object may say, in float64, side by side on the axis of a grid.

An object can be seen in a few ways only (`Views`). Under one record of its looks all that they may have said lies side
by side as the cells of an axis. Where labels are independent given the truth (`CountedLabels`), the record is how often
the object was looked at in each view, and a cell is how many of the looks in each view said DIRTY. Where they are not
(`RecordedLabels`), it is the sequence of the views that showed something new, and a cell is what was said in each: of
`PersistentSeeing` "not yet found", and "found at the k-th record".

Values of a table are arrays over the grid of its objects' axes, and a look is taken along one axis after the other:
given the past, the labels of different objects are independent.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np

from halfseen.shapes import Bool, Float, Int
from halfseen.world.seeing import KnownSeeing, is_independent, label_evidence

_MAX_CACHED = 8192
Looks: TypeAlias = tuple[int, ...]
"""What is kept of the looks at an object."""
Grid: TypeAlias = Float[np.ndarray, "..."]
"""Over the labels of a table: an axis for each object, of length 1 once that has left."""


class Views(NamedTuple):
    """The ways in which an object can be seen."""

    occluded: Float[np.ndarray, " views"]
    is_held: Bool[np.ndarray, " views"]

    @property
    def held(self) -> int:
        """Number of the view of it while it is held up."""
        return int(np.argmax(self.is_held)) if self.is_held.any() else 0


class Cells(NamedTuple):
    """What is known of the object in each cell."""

    log_odds: Float[np.ndarray, " cells"]
    seen: Float[np.ndarray, " cells"]
    """Share of the surface that counts as seen."""

    @property
    def dirty(self) -> Float[np.ndarray, " cells"]:
        """P(DIRTY)."""
        return 1.0 / (1.0 + np.exp(-self.log_odds))


class Look(NamedTuple):
    """One more label of an object: where each cell of its axis goes, and how likely that is."""

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
        """What is kept before the first look."""
        return (0,) * len(self.views.occluded)

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019 bounded, and the entries are small
    def cells(self, looks: Looks) -> Cells:
        """What looks may have told."""
        positive = self.seeing.positive(self.views.occluded, 0.0, self.views.is_held)
        if_said, if_not = (label_evidence(*positive, says_dirty) for says_dirty in (True, False))
        said = 2 * _dirty_labels(looks) - np.array(looks)[:, None]
        log_odds = self.prior + (if_said - if_not) / 2 @ said + (if_said + if_not) / 2 @ np.array(looks)
        return Cells(log_odds, np.zeros_like(log_odds))

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019
    def look(self, looks: Looks, view: int) -> Look | None:
        """Look once more; None where that says nothing."""
        after = (*looks[:view], looks[view] + 1, *looks[view + 1 :])
        labels, shape = _dirty_labels(looks), [count + 1 for count in after]
        one_more = labels + (np.arange(len(looks)) == view)[:, None]
        if_clean, if_dirty = (np.asarray(np.ravel_multi_index(tuple(each), shape)) for each in (labels, one_more))
        positive = self.seeing.positive(self.views.occluded[view], 0.0, self.views.is_held[view])
        return Look(after, if_clean, if_dirty, _says_dirty(self.cells(looks), *positive))


@dataclass(frozen=True, eq=False)
class RecordedLabels:
    """Labels of one object that depend on former looks: its views in their order, but for those that said nothing."""

    seeing: KnownSeeing
    views: Views
    prior: float
    """Log-odds of DIRTY before the first label."""
    nothing: Looks = ()
    """What is kept before the first look."""

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019
    def cells(self, looks: Looks) -> Cells:
        """What looks may have told: a cell in which a look may say DIRTY gets a cell beside it, behind all others."""
        if not looks:
            return Cells(np.array([self.prior]), np.zeros(1))
        before, view = self.cells(looks[:-1]), looks[-1]
        positive = self._positive(before, view)
        is_news = positive[0] + positive[1] > 0.0
        if_not, if_said = (before.log_odds + label_evidence(*positive, is_news & says) for says in (False, True))
        seen = [self._seen_after(before, view, says) for says in (False, True)]
        return Cells(np.append(if_not, if_said[is_news]), np.append(seen[0], seen[1][is_news]))

    @lru_cache(maxsize=_MAX_CACHED)  # noqa: B019
    def look(self, looks: Looks, view: int) -> Look | None:
        """Look once more; None where that says nothing."""
        before, cells = self.cells(looks), np.arange(len(self.cells(looks).seen))
        positive = self._positive(before, view)
        is_news = positive[0] + positive[1] > 0.0
        if not (is_news | (self._seen_after(before, view, False) != before.seen)).any():
            return None
        if_dirty = np.where(is_news, cells[-1] + np.cumsum(is_news), cells)
        return Look((*looks, view), cells, if_dirty, _says_dirty(before, *positive))

    def _positive(self, before: Cells, view: int) -> tuple[Float[np.ndarray, " cells"], Float[np.ndarray, " cells"]]:
        if_dirty, if_clean = self.seeing.positive(self.views.occluded[view], before.seen, self.views.is_held[view])
        return np.broadcast_to(if_dirty, before.seen.shape), np.broadcast_to(if_clean, before.seen.shape)

    def _seen_after(self, before: Cells, view: int, says_dirty: bool) -> Float[np.ndarray, " cells"]:
        after = self.seeing.after(self.views.occluded[view], before.seen, says_dirty, self.views.is_held[view])
        return np.broadcast_to(after, before.seen.shape)


Labels: TypeAlias = CountedLabels | RecordedLabels


def labels_of(seeing: KnownSeeing, occlusions: Float[np.ndarray, " levels"], dirty_share: float) -> Labels:
    """Labels of an object that is seen at its occlusions, from 0 up, and held, if that is another view."""
    prior = float(np.log(dirty_share) - np.log1p(-dirty_share))
    views = Views(np.append(occlusions, 0.0), np.arange(len(occlusions) + 1) == len(occlusions))
    on_table, in_hand = (
        [*seeing.positive(0.0, 0.0, is_held), *(seeing.after(0.0, 0.0, says, is_held) for says in (False, True))]
        for is_held in (False, True)
    )
    if on_table == in_hand:
        views = Views(*(each[:-1] for each in views))
    return (CountedLabels if is_independent(seeing) else RecordedLabels)(seeing, views, prior)


def _says_dirty(before: Cells, if_dirty: Grid | float, if_clean: Grid | float) -> Float[np.ndarray, " cells"]:
    return before.dirty * if_dirty + (1.0 - before.dirty) * if_clean


def _dirty_labels(looks: Looks) -> Int[np.ndarray, "views cells"]:
    """How many of the looks in each view said DIRTY, cell by cell."""
    return np.indices([count + 1 for count in looks]).reshape(len(looks), -1)


def along(values: Float[np.ndarray, " cells"], axis: int, num_axes: int) -> Grid:
    """Lay values along one axis of a grid."""
    return values.reshape([-1 if at == axis else 1 for at in range(num_axes)])


def expected_over_labels(values: Grid, looks: tuple[Look | None, ...]) -> Grid:
    """Mean of `values`, on the grid after a look, over what the look may say; on the grid before it."""
    for axis, look in enumerate(looks):
        if look is not None:
            if_clean, if_dirty = values.take(look.if_clean, axis), values.take(look.if_dirty, axis)
            if_dirty -= if_clean
            if_dirty *= along(look.says_dirty, axis, len(looks))
            values = np.add(if_clean, if_dirty, out=if_clean)
    return values


def spread_over_labels(mass: Grid, looks: tuple[Look | None, ...], shape: tuple[int, ...]) -> Grid:
    """Probability of each cell of the grid (of `shape`) after a look, given that of each before it.

    The objects' axes are the last of `mass`; those before them are kept.
    """
    for axis, look in enumerate(looks, start=mass.ndim - len(looks)):
        if look is not None:
            said_dirty = mass * along(look.says_dirty, axis, mass.ndim)
            after = np.zeros((*mass.shape[:axis], shape[axis - mass.ndim], *mass.shape[axis + 1 :]))
            after[(slice(None),) * axis + (look.if_clean,)] += mass - said_dirty
            after[(slice(None),) * axis + (look.if_dirty,)] += said_dirty
            mass = after
    return mass
