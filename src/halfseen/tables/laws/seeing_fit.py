"""The assumed law of seeing, its numbers fitted to labels and to what washing showed, by maximum likelihood.

A label is right with probability q(occ) = floor + gain·(1 − occ)^power. Of an object with labels y_1, y_2, … let A = Σ
log P(y_j | dirty) and B = Σ log P(y_j | clean), and π the share of dirty objects. It adds to the log-likelihood

    log π + A                                   where washing showed that it was dirty,
    log(1 − π) + B                              where washing showed that it was clean,
    log(π·exp(A) + (1 − π)·exp(B))              where nothing was shown.

What is washed is chosen by its labels. So labels of washed objects say DIRTY too often: they seem more right than they
are where the object was dirty, and less where it was clean. The likelihood of all objects, those never washed included,
takes that in: given the labels, whether an object was washed, held or cut does not depend on what it is, so what was
not shown is missing at random [Rubin1976]_.
Objects that were never washed tell of q as well, by how often their labels agree.

What maximises it also pays a weak normal prior (`CENTRE`, `SPREAD`), which weighs as much as a few objects do.
"""

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.special import expit

from halfseen.arrays import Rows
from halfseen.tables.laws.labels import Labels
from halfseen.world.seeing import AssumedSeeing

Theta = Float[np.ndarray, "3"]
"""logit of 2·(floor + gain) − 1, logit of (floor − ½) / (floor + gain − ½), log power."""

CENTRE = np.array([0.0, -3.0, 0.0])
"""Mode of the prior: right three times of four in full view, hardly better than a coin if hidden, straight between."""

SPREAD = np.array([1.5, 1.0, 0.5])
"""Its standard deviations."""


def fit_seeing(told: Labels, dirty_share: float) -> AssumedSeeing:
    """Fit floor, gain and power, with a floor of at least ½; without labels they are the prior's.

    Parameters
    ----------
    told
        The labels.
    dirty_share
        π, which is known.
    """
    bounds = [(-8.0, 8.0)] * len(CENTRE)
    found = minimize(
        negative_log_posterior, CENTRE, args=(told, dirty_share), jac=True, method="L-BFGS-B", bounds=bounds
    )
    return law_of(found.x)


def law_of(theta: Theta) -> AssumedSeeing:
    """Read the parameters that `negative_log_posterior` takes."""
    reach, least = 0.5 * expit(theta[0]), expit(theta[1])
    return AssumedSeeing(float(0.5 + reach * least), float(reach * (1.0 - least)), float(np.exp(theta[2])))


def negative_log_posterior(theta: Theta, told: Labels, dirty_share: float) -> tuple[float, Theta]:
    """What `fit_seeing` minimises, and its gradient."""
    shift = (theta - CENTRE) / SPREAD
    right, slopes = _accuracy(theta, told.occlusion)
    log_likelihood, is_dirty = _of_objects(right, told, dirty_share)
    is_right = np.where(told.says_dirty, is_dirty[told.object], 1.0 - is_dirty[told.object])
    gradient = (slopes * (is_right / right - (1.0 - is_right) / (1.0 - right))).sum(axis=1)
    return float((shift**2).sum() / 2.0 - log_likelihood), shift / SPREAD - gradient


def _accuracy(theta: Theta, occlusion: Rows) -> tuple[Rows, Float[np.ndarray, "3 n"]]:
    """Accuracy q of each label, and how each parameter changes it."""
    reach, least, power = 0.5 * expit(theta[0]), expit(theta[1]), np.exp(theta[2])
    shown = 1.0 - occlusion
    curve = shown**power
    height = least + (1.0 - least) * curve
    per_power = reach * (1.0 - least) * curve * power * np.log(np.where(shown > 0.0, shown, 1.0))
    slopes = [reach * (1.0 - expit(theta[0])) * height, reach * least * (1.0 - least) * (1.0 - curve), per_power]
    return 0.5 + reach * height, np.stack(slopes)


def _of_objects(right: Rows, told: Labels, dirty_share: float) -> tuple[float, Float[np.ndarray, " objects"]]:
    """Log-likelihood of all objects, and P(DIRTY) of each given its labels and what was shown of it."""
    num_objects = 1 + told.object.max(initial=-1)
    log_right, log_wrong = np.log(right), np.log1p(-right)
    pairs = (log_right, log_wrong), (log_wrong, log_right)
    if_dirty, if_clean = (
        np.bincount(told.object, np.where(told.says_dirty, yes, no), num_objects) for yes, no in pairs
    )
    was = np.zeros((2, num_objects), dtype=bool)
    was[0, told.object[told.was_dirty]], was[1, told.object[told.was_clean]] = True, True
    dirty, clean = np.log(dirty_share) + if_dirty, np.log1p(-dirty_share) + if_clean
    each = np.select([was[0], was[1]], [dirty, clean], np.logaddexp(dirty, clean))
    # Numbers that no object has have neither labels nor truth, and add log 1.
    return float(each.sum()), np.select([was[0], was[1]], [1.0, 0.0], expit(dirty - clean))
