"""Laws of seeing, fitted to labels and to what washing showed, by maximum likelihood.

With π the share of dirty objects, and D and C the likelihood of an object's labels if it is dirty and if it is clean,
it adds to the log-likelihood

    log π + log D                   where washing showed that it was dirty,
    log(1 − π) + log C              where washing showed that it was clean,
    log(π·D + (1 − π)·C)            where nothing was shown.

What is washed is chosen by its labels. So labels of washed objects say DIRTY too often: they seem more right than they
are where the object was dirty, and less where it was clean. The likelihood of all objects, those never washed included,
takes that in: given the labels, whether an object was washed, held or cut does not depend on what it is, so what was
not shown is missing at random [Rubin1976]_. Objects that were never washed tell as well, by how often their labels
agree.

**Independent** (`AssumedSeeing`). A label is right with probability q(occ) = floor + gain·(1 − occ)^power, so log D and
log C are sums over the labels of an object.

**Persistent** (`PersistentSeeing`).

========  ==========================================================================================================
symbol    here
========  ==========================================================================================================
v         share of an object's surface that was in view
V         the share at which it tells: P(V ≤ v) is sens(v) if it is dirty, fp(v) if it is clean
k         a piece of the surface, between two of the shares at which the curves are given
h_k       P(V is in piece k, if it is in none before)
========  ==========================================================================================================

A curve is P(V ≤ v) = Σ_k c_k(v)·m_k, with c_k(v) the share of piece k that v covers and m_k = h_k·Π_{j<k} (1 − h_j)
(what is left, Π_k (1 − h_k), is never found). It rises for any h in (0, 1), and each h is the expit of a free number.

A look that shows v' > v finds something with probability (P(V ≤ v') − P(V ≤ v)) / (1 − P(V ≤ v)). The product over the
looks at one object leaves P(v < V ≤ v') if the last one said DIRTY, and 1 − P(V ≤ v) if none did by v: intervals, as
`halfseen.cell.calibration` takes them [Turnbull1976]_. By the prior a look in full view finds a stain on half of the
dirty objects and something on a tenth of the clean ones, as likely in one part as in another, and so does lifting of
the rest. How much of its surface an object shows in full view is no parameter. It is what the recorder counted.

**Which.** No likelihood chooses. What would tell the families apart is what looks said that showed nothing new, and a
log says this only if its recorder took them for news. So the recorder has chosen: where a log counts what was seen of
an object, looks that show no more are no news in it, and will be none to the policy that acts on such states; where it
counts nothing, every look moved the log-odds, and will again.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from halfseen.arrays import RowMask, Rows
from halfseen.shapes import Float
from halfseen.tables.evidence import Labels, Prior, least
from halfseen.world.seeing import SAME_VIEW, AssumedSeeing, KnownSeeing, PersistentSeeing

Theta = Float[np.ndarray, " k"]
"""Of the independent family: logit of 2·(floor + gain) − 1, logit of (floor − ½) / (floor + gain − ½), log power; of
the persistent one: logits of h, first of dirty objects, then of clean ones."""
NUM_PARTS = 4
"""Equal parts of what an object shows in full view at whose ends the curves are given; they are given at 1 too."""
FOUND = np.array([0.5, 0.1])
"""Share of the dirty objects, and of the clean ones, that the prior takes a look in full view to find."""


@dataclass(frozen=True, eq=False)
class _Family:
    """Laws of the labels of objects, of which the share π (`dirty_share`) is dirty."""

    labels: Labels
    dirty_share: float

    bounds: ClassVar[tuple[float, float]]
    """Of each number of θ."""

    def fitted(self, prior: Prior) -> Theta:
        """θ of the largest posterior density."""
        return least(lambda theta: self.loss(theta, prior), prior.mode, [self.bounds] * len(prior.mode))

    def loss(self, theta: Theta, prior: Prior) -> tuple[float, Theta]:
        """Negative log-posterior, and its gradient."""
        return prior.loss(theta, *self.likelihood(theta))

    def likelihood(self, theta: Theta) -> tuple[float, Theta]:
        """Log-likelihood of all objects, and its gradient."""
        raise NotImplementedError


class Independent(_Family):
    """Labels of which each is news; their accuracy is at least ½."""

    prior: ClassVar[Prior] = Prior(np.array([0.0, -3.0, 0.0]), np.array([1.5, 1.0, 0.5]))
    """Right three times of four in full view, hardly better than a coin if hidden, straight between."""
    bounds = (-8.0, 8.0)

    def law(self, theta: Theta) -> AssumedSeeing:
        """The law of these numbers."""
        reach, floor, power = _shape(theta)
        return AssumedSeeing(float(0.5 + reach * floor), float(reach * (1.0 - floor)), float(power))

    def theta_of(self, law: KnownSeeing) -> Theta | None:
        """The numbers of a law; None of one that is not of this family."""
        if not isinstance(law, AssumedSeeing):
            return None
        reach = float(law.floor) + float(law.gain) - 0.5
        shares = np.clip([2.0 * reach, (float(law.floor) - 0.5) / reach], 1e-3, 1.0 - 1e-3)
        return np.append(np.log(shares) - np.log1p(-shares), np.log(float(law.power)))

    def likelihood(self, theta: Theta) -> tuple[float, Theta]:
        """Log-likelihood of all objects, and its gradient."""
        labels = self.labels
        right, slopes = _accuracy(theta, labels.occlusion)
        log_likelihood, is_dirty = _of_objects(right, labels, self.dirty_share)
        is_right = np.where(labels.says_dirty, is_dirty[labels.object], 1.0 - is_dirty[labels.object])
        return log_likelihood, (slopes * (is_right / right - (1.0 - is_right) / (1.0 - right))).sum(axis=1)


def _shape(theta: Theta) -> tuple[np.float64, np.float64, np.float64]:
    """What is above chance in full view, the share of it that is left if hidden, and the power."""
    from scipy.special import expit

    return 0.5 * expit(theta[0]), expit(theta[1]), np.exp(theta[2])


def _accuracy(theta: Theta, occlusion: Rows) -> tuple[Rows, Float[np.ndarray, "3 n"]]:
    """Accuracy q of each label, and how each parameter changes it."""
    reach, floor, power = _shape(theta)
    shown = 1.0 - occlusion
    curve = shown**power
    height = floor + (1.0 - floor) * curve
    per_power = reach * (1.0 - floor) * curve * power * np.log(np.where(shown > 0.0, shown, 1.0))
    slopes = [reach * (1.0 - 2.0 * reach) * height, reach * floor * (1.0 - floor) * (1.0 - curve), per_power]
    return 0.5 + reach * height, np.stack(slopes)


def _of_objects(right: Rows, labels: Labels, dirty_share: float) -> tuple[float, Float[np.ndarray, " objects"]]:
    """Log-likelihood of all objects, and P(DIRTY) of each given its labels and what was shown of it."""
    from scipy.special import expit

    num_objects = 1 + labels.object.max(initial=-1)
    log_right, log_wrong = np.log(right), np.log1p(-right)
    pairs = (log_right, log_wrong), (log_wrong, log_right)
    if_dirty, if_clean = (
        np.bincount(labels.object, np.where(labels.says_dirty, yes, no), num_objects) for yes, no in pairs
    )
    was = np.zeros((2, num_objects), dtype=bool)
    was[0, labels.object[labels.was_dirty]], was[1, labels.object[labels.was_clean]] = True, True
    dirty, clean = np.log(dirty_share) + if_dirty, np.log1p(-dirty_share) + if_clean
    each = np.select([*was], [dirty, clean], np.logaddexp(dirty, clean))
    # Numbers that no object has have neither labels nor truth, and add log 1.
    return float(each.sum()), np.select([*was], [1.0, 0.0], expit(dirty - clean))


class Intervals(NamedTuple):
    """What is known of the share at which each of n objects tells."""

    covered: Float[np.ndarray, "n pieces+1"]
    """How much of each piece of the surface that share may lie in; the last column is "never"."""
    was_dirty: RowMask
    was_clean: RowMask


@dataclass(frozen=True, eq=False)
class Persistent(_Family):
    """Labels that persist as long as the view does, with curves in `num_parts` of what shows in full view."""

    num_parts: int = NUM_PARTS

    bounds = (-12.0, 12.0)

    @cached_property
    def facing(self) -> float:
        """Share of the surface that an object in full view shows, as the recorder counted it; 1 where nothing tells.

        It shows where a look at an object on the table found nothing: what counts as seen is then that share of what
        was not hidden.
        """
        labels = self.labels
        is_new = labels.seen_after > labels.seen + SAME_VIEW
        is_plain = ~labels.is_held & ~labels.says_dirty & is_new & (labels.occlusion < 1.0)
        if not is_plain.any():
            return 1.0
        shares = labels.seen_after[is_plain] / (1.0 - labels.occlusion[is_plain])
        # As exact as views are told apart: what was recorded has the rounding of its arithmetic.
        return float(np.clip(np.round(np.median(shares), 6), SAME_VIEW, 1.0))

    @cached_property
    def views(self) -> Float[np.ndarray, " pieces"]:
        """Shares of the surface at which the curves are given."""
        return np.unique(np.append(self.facing * np.arange(1, self.num_parts + 1) / self.num_parts, 1.0))

    @cached_property
    def prior(self) -> Prior:
        """Prior of the curves, where nothing else is known."""
        hazard = -np.expm1(np.log1p(-FOUND)[:, None] / self.num_parts)
        hazard = np.where(self.views <= self.facing, hazard, FOUND[:, None])
        return Prior((np.log(hazard) - np.log1p(-hazard)).ravel(), 1.5)

    @cached_property
    def _intervals(self) -> Intervals:
        """What the labels of each object say together."""
        _, from_end = np.unique(self.labels.object[::-1], return_index=True)
        last = Labels(*(values[::-1][from_end] for values in self.labels))
        in_view = np.where(last.is_held, 1.0, self.facing * (1.0 - last.occlusion))
        # Where a look found nothing, what it showed is what the recorder counts as seen.
        shown = np.where(last.says_dirty, in_view, last.seen_after)
        seen_by, shown_by = (_covered(share, self.views) for share in (last.seen, np.maximum(shown, last.seen)))
        inside = np.where(last.says_dirty[:, None], shown_by - seen_by, 1.0 - shown_by)
        covered = np.column_stack([inside, ~last.says_dirty])
        is_possible = covered.any(axis=1)
        return Intervals(covered[is_possible], last.was_dirty[is_possible], last.was_clean[is_possible])

    def law(self, theta: Theta) -> PersistentSeeing:
        """The law of these numbers."""
        curves = np.minimum(np.cumsum(masses(theta)[:, :-1], axis=1), 1.0)
        curves = np.maximum.accumulate(curves, axis=1)
        return PersistentSeeing(self.facing, tuple(self.views.tolist()), *(tuple(curve) for curve in curves.tolist()))

    def theta_of(self, law: KnownSeeing) -> Theta | None:
        """The numbers of a law at the shares at which the curves are given; None of one of the other family."""
        if not isinstance(law, PersistentSeeing):
            return None
        found = law.found_by(self.views)
        before = np.pad(found, ((0, 0), (1, 0)))[:, :-1]
        hazard = np.clip((found - before) / np.maximum(1.0 - before, 1e-9), 1e-3, 1.0 - 1e-3)
        return (np.log(hazard) - np.log1p(-hazard)).ravel()

    def likelihood(self, theta: Theta) -> tuple[float, Theta]:
        """Log-likelihood of all objects, and its gradient."""
        from scipy.special import expit

        known, mass = self._intervals, masses(theta)
        is_excluded = np.column_stack([known.was_clean, known.was_dirty])
        share = np.where(is_excluded, 0.0, np.array([self.dirty_share, 1.0 - self.dirty_share]))
        likelihood = (share * (known.covered @ mass.T)).sum(axis=1)
        # Objects that are dirty, and clean, and tell in each piece, as many as are to be expected.
        count = mass * ((share / likelihood[:, None]).T @ known.covered)
        later = count.sum(axis=1, keepdims=True) - np.cumsum(count, axis=1)
        hazard = expit(theta.reshape(2, -1))
        slope = count[:, :-1] * (1.0 - hazard) - later[:, :-1] * hazard
        return float(np.log(likelihood).sum()), slope.ravel()


def _covered(share: Rows, views: Float[np.ndarray, " pieces"]) -> Float[np.ndarray, "n pieces"]:
    begins = np.append(0.0, views[:-1])
    return np.clip((share[:, None] - begins) / (views - begins), 0.0, 1.0)


def masses(theta: Theta) -> Float[np.ndarray, "2 parts"]:
    """Probability that V lies in each piece, and that it is in none: of dirty objects, and of clean ones."""
    from scipy.special import log_expit

    theta = theta.reshape(2, -1)
    none = np.zeros((2, 1))
    before = np.hstack([none, np.cumsum(log_expit(-theta), axis=1)])
    return np.exp(before + np.hstack([log_expit(theta), none]))
