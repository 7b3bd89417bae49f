"""The logistic law of grasping, its numbers fitted to attempts of which some were cut, by maximum likelihood.

========  ==========================================================================================================
symbol    here
========  ==========================================================================================================
a, b      log_odds, log_odds_per_occlusion
u         what is hidden of an object's grip offset, N(0, σ²)
p         expit(a + b·occ + grip + u): probability that an attempt holds
μ, s      log_held_s or log_missed_s, and log_std: mean and standard deviation of a log duration
τ         the limit of an attempt [s]
t         time for which an attempt was watched [s]
========  ==========================================================================================================

Durations are lognormal, and end at τ. With z = (log t − μ) / s, an attempt that ended at t has

    g = φ(z) / (s·t)  where t < `AT_LIMIT`·τ,   and   g = 1 − Φ((log(`AT_LIMIT`·τ) − μ) / s)  at the limit;

one that was cut at t has g = 1 − Φ(z). With g_held and g_missed by the two means, its likelihood given u is

    p·g_held  if it held,   (1 − p)·g_missed  if it missed,   p·g_held + (1 − p)·g_missed  if it was cut.

So an attempt that was cut counts as one that lasts longer, whatever becomes of it: where misses take long, it tells of
a miss. The product over the attempts of one object is integrated over u by Gauss–Hermite quadrature, as frailties are
[Hougaard2000]_. What maximises it also pays a weak normal prior (`centre`, `SPREAD`), which weighs as much as a few
attempts do; by it a miss lasts as long as an attempt that holds until misses tell otherwise.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.special import log_ndtr

from halfseen.arrays import RowIds, RowMask, Rows
from halfseen.tables.laws.watched import AT_LIMIT, Watched
from halfseen.world.grasping import FittedGrasping

Theta = Float[np.ndarray, "6"]
"""a, b, log σ, mean log duration of an attempt that holds, what is added for one that misses, and log s."""

SPREAD = np.array([2.0, 2.0, 1.0, 1.0, 1.0, 1.0])
"""Standard deviations of the prior."""

REACH = np.array([10.0, 15.0, 2.5, 5.0, 5.0, 4.0])
"""How far from the prior's mode a number may go."""

NUM_NODES = 15
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(NUM_NODES)
_LOG_WEIGHTS = np.log(_WEIGHTS / _WEIGHTS.sum())
_LOG_ROOT_2_PI = 0.5 * np.log(2.0 * np.pi)


class _Attempts(NamedTuple):
    """Attempts in the order of their objects, without those that tell nothing."""

    occlusion: Rows
    grip: Rows
    log_s: Rows
    is_ended: RowMask
    """Whether its end was seen, and it was before the limit."""
    is_held: RowMask
    is_cut: RowMask
    rank: RowIds
    """Number of its object, from 0."""
    first: RowIds
    """The first attempt at each object."""


class _Durations(NamedTuple):
    """log g of each attempt under one mean, and what changes it."""

    log_density: Rows
    per_mean: Rows
    per_log_std: Rows


class _Results(NamedTuple):
    """What is known of the results of attempts, their objects' offsets integrated out."""

    log_likelihood: float
    held: Rows
    """P(it held), given all that was seen."""
    excess: Rows
    """That, less P(it held) before its own result was seen."""
    per_log_offset: float
    """What log σ changes of the log-likelihood."""


def centre(limit_s: float) -> Theta:
    """Mode of the prior: half of the attempts hold, whatever hides the object, and both results take half the limit."""
    return np.array([0.0, 0.0, np.log(0.5), np.log(limit_s / 2.0), 0.0, np.log(0.5)])


def fit_logistic(tried: Watched, limit_s: float) -> FittedGrasping:
    """Fit the six numbers; without attempts they are the prior's.

    Parameters
    ----------
    tried
        The attempts.
    limit_s
        τ, which is known [s].
    """
    return law_of(fit_theta(tried, limit_s), limit_s)


def fit_theta(tried: Watched, limit_s: float) -> Theta:
    """Fit the six numbers, as `negative_log_posterior` takes them."""
    middle, known = centre(limit_s), _known(tried, limit_s)
    start = _start(known, middle)
    scale = _scale(known, start)

    def loss(steps: Theta) -> tuple[float, Theta]:
        value, gradient = _loss(start + scale * steps, known, middle)
        return value, scale * gradient

    ends = ((middle + sign * REACH - start) / scale for sign in (-1.0, 1.0))
    options = {"bounds": list(zip(*ends, strict=True)), "options": {"ftol": 1e-12}}
    return start + scale * minimize(loss, np.zeros(len(start)), jac=True, method="L-BFGS-B", **options).x


def law_of(theta: Theta, limit_s: float) -> FittedGrasping:
    """Read the parameters that `negative_log_posterior` takes."""
    log_odds, per_occlusion, log_offset, log_held_s, longer, log_std = (float(value) for value in theta)
    stds = float(np.exp(log_offset)), float(np.exp(log_std))
    return FittedGrasping(log_odds, per_occlusion, stds[0], log_held_s, log_held_s + longer, stds[1], limit_s)


def negative_log_posterior(theta: Theta, tried: Watched, limit_s: float) -> tuple[float, Theta]:
    """What `fit_logistic` minimises, and its gradient."""
    return _loss(theta, _known(tried, limit_s), centre(limit_s))


def _known(tried: Watched, limit_s: float) -> _Attempts:
    is_cut = ~(tried.is_held | tried.is_missed)
    order = np.argsort(tried.object, kind="stable")
    order = order[~is_cut[order] | (tried.watched_s[order] > 0.0)]
    _, first, rank = np.unique(tried.object[order], return_index=True, return_inverse=True)
    is_ended = ~is_cut & (tried.watched_s < AT_LIMIT * limit_s)
    # What ended at the limit lasted at least `AT_LIMIT` of it; what ended at once cannot have a logarithm of no time.
    until_s = np.where(is_cut | is_ended, tried.watched_s, AT_LIMIT * limit_s)
    log_s = np.log(np.maximum(until_s, 1e-3 * limit_s))
    columns = (tried.occlusion, tried.grip, log_s, is_ended, tried.is_held, is_cut)
    return _Attempts(*(column[order] for column in columns), rank=rank, first=first)


def _start(known: _Attempts, middle: Theta) -> Theta:
    """The prior, moved to the results and the durations that were seen."""
    start, log_s = middle.copy(), known.log_s[known.is_ended]
    num_held = int(known.is_held.sum())
    start[0] = np.log(num_held + 1.0) - np.log(len(known.log_s) - known.is_cut.sum() - num_held + 1.0)
    if len(log_s) > 1:
        start[3], start[5] = log_s.mean(), np.log(log_s.std() + 0.05)
    return np.clip(start, middle - REACH / 2.0, middle + REACH / 2.0)


def _scale(known: _Attempts, start: Theta) -> Theta:
    """About how well each number will be known, so that a step is as long for one as for another."""
    num, num_not_held, precision = len(known.log_s), len(known.log_s) - known.is_held.sum(), np.exp(-2.0 * start[5])
    spread = float(np.var(known.occlusion)) if num else 0.0
    information = np.array([num / 5.0, num * spread / 5.0, num / 20.0, num * precision, num_not_held * precision, num])
    return 1.0 / np.sqrt(SPREAD**-2.0 + information)


def _loss(theta: Theta, known: _Attempts, middle: Theta) -> tuple[float, Theta]:
    shift = (theta - middle) / SPREAD
    held, missed = (_durations(known, mean, theta[5]) for mean in (theta[3], theta[3] + theta[4]))
    seen = _results(known, theta, held.log_density, missed.log_density)
    if_held, if_missed = seen.held * held.per_mean, (1.0 - seen.held) * missed.per_mean
    gradient = [
        seen.excess.sum(),
        (seen.excess * known.occlusion).sum(),
        seen.per_log_offset,
        if_held.sum() + if_missed.sum(),
        if_missed.sum(),
        (seen.held * held.per_log_std + (1.0 - seen.held) * missed.per_log_std).sum(),
    ]
    return float((shift**2).sum() / 2.0 - seen.log_likelihood), shift / SPREAD - np.array(gradient)


def _durations(known: _Attempts, mean: float | np.float64, log_std: float | np.float64) -> _Durations:
    std = np.exp(log_std)
    z = (known.log_s - mean) / std
    log_density, log_beyond = -(z**2) / 2.0 - _LOG_ROOT_2_PI, log_ndtr(-z)
    hazard = np.exp(log_density - log_beyond)
    return _Durations(
        log_density=np.where(known.is_ended, log_density - log_std - known.log_s, log_beyond),
        per_mean=np.where(known.is_ended, z, hazard) / std,
        per_log_std=np.where(known.is_ended, z**2 - 1.0, z * hazard),
    )


def _results(known: _Attempts, theta: Theta, held: Rows, missed: Rows) -> _Results:
    """Sum over what was not seen of the results, and over the offsets; nodes come first in all tables."""
    offset = np.exp(theta[2]) * _NODES[:, None]
    odds = np.exp(offset) * np.exp(theta[0] + theta[1] * known.occlusion + known.grip)
    # Relative to the likelier of both results, so that the sum of no cut attempt is 0.
    most = np.where(known.is_cut, np.maximum(held, missed), np.where(known.is_held, held, missed))
    if_held = np.where(known.is_cut, np.exp(np.minimum(held - missed, 0.0)), known.is_held)
    if_missed = np.where(known.is_cut, np.exp(np.minimum(missed - held, 0.0)), ~known.is_held)
    weighed = if_held * odds
    either = weighed + if_missed
    terms = np.add.reduceat(np.log(either / (1.0 + odds)), known.first, axis=1) + _LOG_WEIGHTS[:, None]
    largest = terms.max(axis=0)
    mass = np.exp(terms - largest)
    total = mass.sum(axis=0)
    posterior = (mass / total)[:, known.rank]
    excess = posterior * (weighed / either - odds / (1.0 + odds))
    return _Results(
        log_likelihood=float(most.sum() + (largest + np.log(total)).sum()),
        held=(posterior * (weighed / either)).sum(axis=0),
        excess=excess.sum(axis=0),
        per_log_offset=float((excess * offset).sum()),
    )
