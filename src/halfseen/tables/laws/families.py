"""Which family of laws a log speaks for.

Grasping: exponential with frailty (`grasping_fit`), or logistic with lognormal durations (`logistic_fit`). Both are
fitted to the same attempts, and each is a density of the same data: whether an attempt held, missed or was cut, and for
how long it was watched. Both densities are with respect to Lebesgue measure on durations below `AT_LIMIT`·τ, and a
point for those at the limit τ. What is taken has the larger

    log L(θ̂) − |(θ̂ − mode) / spread|² / 2 − (k / 2)·log n,

the log-posterior that was maximised less the price of its k numbers (3 or 6), n being the attempts [Schwarz1978]_. Two
things follow from the measure:

- The exponential family misses at the limit alone. One miss that ended before has density 0 in it, so that the other
  family is taken whatever its density is.
- An attempt that held at the limit is at the point as well. The exponential family has a density f there, and gives the
  point f·(1 − `AT_LIMIT`)·τ; the lognormal one gives it the share of durations that would have lasted longer.

Seeing: independent (`seeing_fit`), or persistent (`persistent_fit`). No likelihood chooses. What would tell them apart
is what looks said that showed nothing new, and a log says this only if its recorder took them for news. So the recorder
has chosen: where a log counts what was seen of an object, looks that show no more are no news in it, and will be none
to the policy that acts on such states; where it counts nothing, every look moved the log-odds, and will again.
"""

import numpy as np

from halfseen.tables.laws import grasping_fit, logistic_fit
from halfseen.tables.laws.labels import Labels
from halfseen.tables.laws.persistent_fit import fit_persistent
from halfseen.tables.laws.seeing_fit import fit_seeing
from halfseen.tables.laws.watched import AT_LIMIT, Watched
from halfseen.world.grasping import AssumedGrasping, FittedGrasping
from halfseen.world.seeing import AssumedSeeing, PersistentSeeing


def choose_grasping(tried: Watched, limit_s: float) -> AssumedGrasping | FittedGrasping:
    """Fit both families to attempts, and take the one that they speak for.

    Parameters
    ----------
    tried
        The attempts.
    limit_s
        τ, which is known [s].
    """
    logistic = logistic_fit.fit_theta(tried, limit_s)
    if not misses_at_limit_alone(tried, limit_s):
        return logistic_fit.law_of(logistic, limit_s)
    exponential = grasping_fit.fit_theta(tried, limit_s)
    if exponential_score(exponential, tried, limit_s) >= logistic_score(logistic, tried, limit_s):
        return grasping_fit.law_of(exponential, limit_s)
    return logistic_fit.law_of(logistic, limit_s)


def choose_seeing(told: Labels, dirty_share: float) -> AssumedSeeing | PersistentSeeing:
    """Fit the family that the recorder of labels kept to.

    Parameters
    ----------
    told
        The labels.
    dirty_share
        P(DIRTY) before any label, which is known.
    """
    return (fit_persistent if told.is_persistent else fit_seeing)(told, dirty_share)


def misses_at_limit_alone(tried: Watched, limit_s: float) -> bool:
    """Whether the exponential family can have made these attempts."""
    return not (tried.is_missed & (tried.watched_s < AT_LIMIT * limit_s)).any()


def exponential_score(theta: grasping_fit.Theta, tried: Watched, limit_s: float) -> float:
    """What the exponential family reaches, where it can have made the attempts at all."""
    num_at_limit = int((tried.is_held & (tried.watched_s >= AT_LIMIT * limit_s)).sum())
    loss = grasping_fit.negative_log_posterior(theta, tried, limit_s)[0]
    return num_at_limit * float(np.log((1.0 - AT_LIMIT) * limit_s)) - loss - _price(theta, tried)


def logistic_score(theta: logistic_fit.Theta, tried: Watched, limit_s: float) -> float:
    """What the logistic family reaches."""
    return -logistic_fit.negative_log_posterior(theta, tried, limit_s)[0] - _price(theta, tried)


def _price(theta: np.ndarray, tried: Watched) -> float:
    return len(theta) / 2.0 * float(np.log(max(len(tried.object), 1)))
