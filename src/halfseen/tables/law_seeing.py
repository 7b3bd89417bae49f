"""Laws of seeing, fitted to labels and to results of washing, by maximum likelihood.

With π the share of dirty objects, and D and C the likelihood of an object's labels if it is dirty and if it is clean,
an object adds to the log-likelihood

    log π + log D                   where washing showed that it was dirty,
    log(1 − π) + log C              where washing showed that it was clean,
    log(π·D + (1 − π)·C)            where it was not washed.

Objects are chosen for washing by their labels. So labels of washed objects say DIRTY too often: they seem more accurate
than they are for dirty objects, and less for clean ones. The likelihood of all objects, including those never washed,
accounts for that. Given the labels, whether an object was washed, held or cut does not depend on its dirt, so the
unobserved dirt is missing at random [Rubin1976]_. Objects never washed carry information in the agreement of their
labels.

**Independent** (`AssumedSeeing`). A label is right with probability q(occ) = floor + gain·(1 − occ)^power, so log D and
log C are sums over the labels of an object.

**Persistent** (`PersistentSeeing`).

========  ==========================================================================================================
symbol    here
========  ==========================================================================================================
v         share of an object's surface that was in view
V         the share at which a label turns DIRTY: P(V ≤ v) is sens(v) for a dirty object, fp(v) for a clean one
k         a piece of the surface, between two of the shares at which the curves are given
h_k       P(V is in piece k | V is in no earlier piece)
========  ==========================================================================================================

A curve is P(V ≤ v) = Σ_k c_k(v)·m_k, with c_k(v) the share of piece k that v covers and m_k = h_k·Π_{j<k} (1 − h_j)
(the rest, Π_k (1 − h_k), is never found). It rises for any h in (0, 1), and each h is the expit of a free parameter.

A look that shows v' > v finds something with probability (P(V ≤ v') − P(V ≤ v)) / (1 − P(V ≤ v)). The product over the
looks at one object is P(v < V ≤ v') if the last one said DIRTY, and 1 − P(V ≤ v) if none did by v. These are
interval-censored data, as in `halfseen.cell.calibration` [Turnbull1976]_. Under the prior a look in full view finds a
stain on half of the dirty objects and something on a tenth of the clean ones, with equal probability in each part; so
does a look at the remaining surface by lifting. The share of its surface that an object shows in full view is not a
parameter. It is read from the recorder's counts.

**Choice of the family.** The likelihood cannot choose. The families differ in labels of looks that show nothing new,
and a log holds these only if its recorder treated them as news. So the recorder determines the family. Where a log
counts the seen share of an object, looks that show nothing new are no news, and a policy must treat them so. Where it
counts none, every look changed the log-odds, and will do so for the policy.
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
"""Independent family: logit of 2·(floor + gain) − 1, logit of (floor − ½) / (floor + gain − ½), log power; persistent
family: logits of h, first of dirty objects, then of clean ones."""
NUM_PARTS = 4
"""Number of equal parts of the surface in full view. Curves are given at the ends of the parts, and at 1."""
FOUND = np.array([0.5, 0.1])
"""Prior share of dirty objects, and of clean ones, in which a look in full view finds something."""


@dataclass(frozen=True, eq=False)
class _LabelFamily:
    """Laws of labels; a share π (`dirty_share`) of the objects is dirty."""

    labels: Labels
    dirty_share: float

    bounds: ClassVar[tuple[float, float]]
    """Bounds of each element of θ."""

    def fitted(self, prior: Prior) -> Theta:
        """The posterior mode of θ."""
        return least(lambda theta: self.loss(theta, prior), prior.mode, [self.bounds] * len(prior.mode))

    def loss(self, theta: Theta, prior: Prior) -> tuple[float, Theta]:
        """Negative log-posterior, and its gradient."""
        return prior.loss(theta, *self.likelihood(theta))

    def likelihood(self, theta: Theta) -> tuple[float, Theta]:
        """Log-likelihood of all objects, and its gradient."""
        raise NotImplementedError


class Independent(_LabelFamily):
    """Labels that are each news; their accuracy is at least ½."""

    prior: ClassVar[Prior] = Prior(np.array([0.0, -3.0, 0.0]), np.array([1.5, 1.0, 0.5]))
    """Three in four right in full view, barely better than chance if hidden, linear between."""
    bounds = (-8.0, 8.0)

    def law(self, theta: Theta) -> AssumedSeeing:
        """The law with parameters θ."""
        reach, floor, power = _shape(theta)
        return AssumedSeeing(float(0.5 + reach * floor), float(reach * (1.0 - floor)), float(power))

    def theta_of(self, law: KnownSeeing) -> Theta | None:
        """θ of a law; None for a law of the other family."""
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
    """Accuracy above chance in full view, the share of it that remains if hidden, and the power."""
    from scipy.special import expit

    return 0.5 * expit(theta[0]), expit(theta[1]), np.exp(theta[2])


def _accuracy(theta: Theta, occlusion: Rows) -> tuple[Rows, Float[np.ndarray, "3 n"]]:
    """Accuracy q of each label, and its derivative by each parameter."""
    reach, floor, power = _shape(theta)
    shown = 1.0 - occlusion
    curve = shown**power
    height = floor + (1.0 - floor) * curve
    per_power = reach * (1.0 - floor) * curve * power * np.log(np.where(shown > 0.0, shown, 1.0))
    slopes = [reach * (1.0 - 2.0 * reach) * height, reach * floor * (1.0 - floor) * (1.0 - curve), per_power]
    return 0.5 + reach * height, np.stack(slopes)


def _of_objects(right: Rows, labels: Labels, dirty_share: float) -> tuple[float, Float[np.ndarray, " objects"]]:
    """Log-likelihood of all objects, and P(DIRTY) of each given its labels and the result of washing."""
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
    # Unused object numbers have neither labels nor truth, and add log 1.
    return float(each.sum()), np.select([*was], [1.0, 0.0], expit(dirty - clean))


class Intervals(NamedTuple):
    """Interval-censored shares V of n objects."""

    covered: Float[np.ndarray, "n pieces+1"]
    """Share of each piece of the surface in which V may lie; the last column is "never"."""
    was_dirty: RowMask
    was_clean: RowMask


@dataclass(frozen=True, eq=False)
class Persistent(_LabelFamily):
    """Labels that persist as long as the view, with curves in `num_parts` parts of the surface in full view."""

    num_parts: int = NUM_PARTS

    bounds = (-12.0, 12.0)

    @cached_property
    def facing(self) -> float:
        """Share of the surface that an object in full view shows, as the recorder counted it; 1 if unknown.

        It is read from looks at objects on the table that found nothing: the seen share is then this share of the
        visible part.
        """
        labels = self.labels
        is_new = labels.seen_after > labels.seen + SAME_VIEW
        is_plain = ~labels.is_held & ~labels.says_dirty & is_new & (labels.occlusion < 1.0)
        if not is_plain.any():
            return 1.0
        shares = labels.seen_after[is_plain] / (1.0 - labels.occlusion[is_plain])
        # Rounded to the precision that distinguishes views: recorded values have rounding errors.
        return float(np.clip(np.round(np.median(shares), 6), SAME_VIEW, 1.0))

    @cached_property
    def views(self) -> Float[np.ndarray, " pieces"]:
        """Shares of the surface at which the curves are given."""
        return np.unique(np.append(self.facing * np.arange(1, self.num_parts + 1) / self.num_parts, 1.0))

    @cached_property
    def prior(self) -> Prior:
        """Weak prior of the curves."""
        hazard = -np.expm1(np.log1p(-FOUND)[:, None] / self.num_parts)
        hazard = np.where(self.views <= self.facing, hazard, FOUND[:, None])
        return Prior((np.log(hazard) - np.log1p(-hazard)).ravel(), 1.5)

    @cached_property
    def _intervals(self) -> Intervals:
        """Intervals of V from all labels of each object."""
        _, from_end = np.unique(self.labels.object[::-1], return_index=True)
        last = Labels(*(values[::-1][from_end] for values in self.labels))
        in_view = np.where(last.is_held, 1.0, self.facing * (1.0 - last.occlusion))
        # Where a look found nothing, the recorder counts the part that it showed as seen.
        shown = np.where(last.says_dirty, in_view, last.seen_after)
        seen_by, shown_by = (_covered(share, self.views) for share in (last.seen, np.maximum(shown, last.seen)))
        inside = np.where(last.says_dirty[:, None], shown_by - seen_by, 1.0 - shown_by)
        covered = np.column_stack([inside, ~last.says_dirty])
        is_possible = covered.any(axis=1)
        return Intervals(covered[is_possible], last.was_dirty[is_possible], last.was_clean[is_possible])

    def law(self, theta: Theta) -> PersistentSeeing:
        """The law with parameters θ."""
        curves = np.minimum(np.cumsum(masses(theta)[:, :-1], axis=1), 1.0)
        curves = np.maximum.accumulate(curves, axis=1)
        return PersistentSeeing(self.facing, tuple(self.views.tolist()), *(tuple(curve) for curve in curves.tolist()))

    def theta_of(self, law: KnownSeeing) -> Theta | None:
        """θ of a law at the shares at which the curves are given; None for a law of the other family."""
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
        # Expected numbers of dirty, and of clean, objects with V in each piece.
        count = mass * ((share / likelihood[:, None]).T @ known.covered)
        later = count.sum(axis=1, keepdims=True) - np.cumsum(count, axis=1)
        hazard = expit(theta.reshape(2, -1))
        slope = count[:, :-1] * (1.0 - hazard) - later[:, :-1] * hazard
        return float(np.log(likelihood).sum()), slope.ravel()


def _covered(share: Rows, views: Float[np.ndarray, " pieces"]) -> Float[np.ndarray, "n pieces"]:
    begins = np.append(0.0, views[:-1])
    return np.clip((share[:, None] - begins) / (views - begins), 0.0, 1.0)


def masses(theta: Theta) -> Float[np.ndarray, "2 parts"]:
    """Probability that V lies in each piece, and in none, for dirty and for clean objects."""
    from scipy.special import log_expit

    theta = theta.reshape(2, -1)
    none = np.zeros((2, 1))
    before = np.hstack([none, np.cumsum(log_expit(-theta), axis=1)])
    return np.exp(before + np.hstack([log_expit(theta), none]))
