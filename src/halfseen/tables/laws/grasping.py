"""Laws of grasping, fitted to attempts of which some were cut, by maximum likelihood; and which a log speaks for.

========  ==========================================================================================================
symbol    here
========  ==========================================================================================================
u         what is hidden of an object's grip offset, N(0, σ²)
τ         the limit of an attempt [s]
t         time for which an attempt was watched: until it held, missed or was cut, or τ [s]
========  ==========================================================================================================

**Exponential** (`AssumedGrasping`). An attempt misses at τ and at no other time, so its misses are taken to have lasted
τ. With a and b the log time and how occlusion changes it, η = grip − a − b·occ is the log rate at which an attempt
holds, less u: T = exp(a + b·occ − grip − u)·E is exponential with rate e^{η + u}. An attempt that held at t has density
e^{η + u − t·e^{η + u}}; one that missed, or was cut, at t has survival e^{−t·e^{η + u}}. So censored attempts are
neither dropped nor weighted, and with d = 1 where it held and 0 elsewhere, D = Σ d and H = Σ t·e^η over the attempts of
one object, which share u,

    log L(a, b, σ) = Σ_attempts d·η + Σ_objects log ∫ exp(D·u − H·e^u) φ(u / σ) / σ du.

Cuts may depend on all that was seen until then, the age of the attempt included.

**Logistic** (`FittedGrasping`). An attempt holds with probability p = expit(a + b·occ + grip + u). Durations are
lognormal, and end at τ: with μ of what holds or of what misses, and z = (log t − μ) / s, an attempt that ended at t has

    g = φ(z) / (s·t)  where t < `AT_LIMIT`·τ,   and   g = 1 − Φ((log(`AT_LIMIT`·τ) − μ) / s)  at the limit;

one that was cut at t has g = 1 − Φ(z). With g_held and g_missed by the two means, its likelihood given u is

    p·g_held  if it held,   (1 − p)·g_missed  if it missed,   p·g_held + (1 − p)·g_missed  if it was cut.

So an attempt that was cut counts as one that lasts longer, whatever becomes of it: where misses take long, it tells of
a miss. By the prior a miss lasts as long as an attempt that holds until misses tell otherwise.

**Which.** Both densities are with respect to Lebesgue measure on durations below `AT_LIMIT`·τ, and a point for those at
τ. What is taken has the larger

    log L(θ̂) − |(θ̂ − mode) / spread|² / 2 − (k / 2)·log n,

the log-posterior that was maximised less the price of its k numbers (3 or 6), n being the attempts [Schwarz1978]_. Two
things follow from the measure:

- The exponential family misses at the limit alone. One miss that ended before has density 0 in it, so that the other
  family is taken whatever its density is.
- An attempt that held at the limit is at the point as well. The exponential family has a density f there, and gives the
  point f·(1 − `AT_LIMIT`)·τ; the lognormal one gives it the share of durations that would have lasted longer.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from halfseen.arrays import RowIds, RowMask, Rows
from halfseen.tables.laws.evidence import AT_LIMIT, Watched
from halfseen.tables.laws.posterior import Prior, Quadrature, least
from halfseen.world.grasping import AssumedGrasping, FittedGrasping

Exponential = Float[np.ndarray, "3"]
"""a − log τ, b and log σ."""
Logistic = Float[np.ndarray, "6"]
"""a, b, log σ, mean log duration of an attempt that holds, what is added for one that misses, and log s."""

EXPONENTIAL_PRIOR = Prior(np.array([-np.log(np.log(2.0)), 0.0, np.log(0.5)]), np.array([2.0, 2.0, 1.0]))
"""Half of the attempts hold, occlusion changes nothing, and objects differ somewhat."""

REACH = np.array([10.0, 15.0, 2.5, 5.0, 5.0, 4.0])
"""How far from the prior's mode a number of the logistic family may go."""

_OF_EXPONENTIAL, _OF_LOGISTIC = Quadrature.of(31), Quadrature.of(15)
_LOG_ROOT_2_PI = 0.5 * np.log(2.0 * np.pi)


def choose_grasping(tried: Watched, limit_s: float) -> AssumedGrasping | FittedGrasping:
    """Fit both families to attempts, and take the one that they speak for.

    Parameters
    ----------
    tried
        The attempts.
    limit_s
        τ, which is known [s].
    """
    logistic = fit_logistic(tried, limit_s)
    if misses_at_limit_alone(tried, limit_s):
        exponential = fit_exponential(tried, limit_s)
        if exponential_score(exponential, tried, limit_s) >= logistic_score(logistic, tried, limit_s):
            return exponential_law(exponential, limit_s)
    return logistic_law(logistic, limit_s)


def misses_at_limit_alone(tried: Watched, limit_s: float) -> bool:
    """Whether the exponential family can have made these attempts."""
    return not (tried.is_missed & (tried.watched_s < AT_LIMIT * limit_s)).any()


def exponential_score(theta: Exponential, tried: Watched, limit_s: float) -> float:
    """What the exponential family reaches, where it can have made the attempts at all."""
    num_at_limit = int((tried.is_held & (tried.watched_s >= AT_LIMIT * limit_s)).sum())
    at_limit = num_at_limit * float(np.log((1.0 - AT_LIMIT) * limit_s))
    return at_limit - exponential_loss(theta, tried, limit_s)[0] - _price(theta, tried)


def logistic_score(theta: Logistic, tried: Watched, limit_s: float) -> float:
    """What the logistic family reaches."""
    return -logistic_loss(theta, tried, limit_s)[0] - _price(theta, tried)


def _price(theta: np.ndarray, tried: Watched) -> float:
    return len(theta) / 2.0 * float(np.log(max(len(tried.object), 1)))


def fit_exponential(tried: Watched, limit_s: float) -> Exponential:
    """Fit the three numbers; without attempts they are the prior's."""
    bounds = [(-10.0, 10.0), (-15.0, 15.0), (-5.0, 2.0)]
    return least(lambda theta: exponential_loss(theta, tried, limit_s), EXPONENTIAL_PRIOR.mode, bounds)


def exponential_law(theta: Exponential, limit_s: float) -> AssumedGrasping:
    """Read the parameters that `exponential_loss` takes."""
    log_time, per_occlusion, log_std = theta.tolist()
    return AssumedGrasping(float(np.exp(log_std)), log_time + float(np.log(limit_s)), per_occlusion, limit_s)


def exponential_loss(theta: Exponential, tried: Watched, limit_s: float) -> tuple[float, Exponential]:
    """Negative log-posterior of the exponential family, and its gradient."""
    log_rate = tried.grip - theta[0] - np.log(limit_s) - theta[1] * tried.occlusion
    hazard = np.where(tried.is_missed, limit_s, tried.watched_s) * np.exp(log_rate)
    # D and H of each object; numbers that no attempt has stand for 0 and 0, which tell nothing.
    held, hazards = (np.bincount(tried.object, weights) * 1.0 for weights in (tried.is_held, hazard))
    offset = float(np.exp(theta[2])) * _OF_EXPONENTIAL.nodes
    rate = np.exp(offset)
    log_integral, posterior = _OF_EXPONENTIAL.integrated(held * offset - hazards * rate)
    # What an attempt held more often than was to be expected.
    excess = tried.is_held - hazard * (posterior * rate).sum(axis=0)[tried.object]
    per_log_std = (posterior * offset * (held - hazards * rate)).sum()
    slope = np.array([-excess.sum(), -(excess * tried.occlusion).sum(), per_log_std])
    return EXPONENTIAL_PRIOR.loss(theta, (tried.is_held * log_rate).sum() + log_integral.sum(), slope)


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


def logistic_prior(limit_s: float) -> Prior:
    """Half of the attempts hold, whatever hides the object, and both results take half the limit."""
    mode = np.array([0.0, 0.0, np.log(0.5), np.log(limit_s / 2.0), 0.0, np.log(0.5)])
    return Prior(mode, np.array([2.0, 2.0, 1.0, 1.0, 1.0, 1.0]))


def fit_logistic(tried: Watched, limit_s: float) -> Logistic:
    """Fit the six numbers; without attempts they are the prior's."""
    prior, known = logistic_prior(limit_s), _known(tried, limit_s)
    start = _start(known, prior.mode)
    scale = _scale(known, start, prior)

    def loss(steps: Logistic) -> tuple[float, Logistic]:
        value, gradient = _loss(start + scale * steps, known, prior)
        return value, scale * gradient

    low, high = ((prior.mode + sign * REACH - start) / scale for sign in (-1.0, 1.0))
    return start + scale * least(loss, np.zeros(len(start)), list(zip(low, high, strict=True)), ftol=1e-12)


def logistic_law(theta: Logistic, limit_s: float) -> FittedGrasping:
    """Read the parameters that `logistic_loss` takes."""
    log_odds, per_occlusion, log_offset, log_held_s, longer, log_std = theta.tolist()
    stds = float(np.exp(log_offset)), float(np.exp(log_std))
    return FittedGrasping(log_odds, per_occlusion, stds[0], log_held_s, log_held_s + longer, stds[1], limit_s)


def logistic_loss(theta: Logistic, tried: Watched, limit_s: float) -> tuple[float, Logistic]:
    """Negative log-posterior of the logistic family, and its gradient."""
    return _loss(theta, _known(tried, limit_s), logistic_prior(limit_s))


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


def _start(known: _Attempts, mode: Logistic) -> Logistic:
    """The prior, moved to the results and the durations that were seen."""
    start, log_s = mode.copy(), known.log_s[known.is_ended]
    num_held = int(known.is_held.sum())
    start[0] = np.log(num_held + 1.0) - np.log(len(known.log_s) - known.is_cut.sum() - num_held + 1.0)
    if len(log_s) > 1:
        start[3], start[5] = log_s.mean(), np.log(log_s.std() + 0.05)
    return np.clip(start, mode - REACH / 2.0, mode + REACH / 2.0)


def _scale(known: _Attempts, start: Logistic, prior: Prior) -> Logistic:
    """About how well each number will be known, so that a step is as long for one as for another."""
    num, num_not_held, precision = len(known.log_s), len(known.log_s) - known.is_held.sum(), np.exp(-2.0 * start[5])
    spread = float(np.var(known.occlusion)) if num else 0.0
    information = np.array([num / 5.0, num * spread / 5.0, num / 20.0, num * precision, num_not_held * precision, num])
    return 1.0 / np.sqrt(prior.spread**-2.0 + information)


def _loss(theta: Logistic, known: _Attempts, prior: Prior) -> tuple[float, Logistic]:
    if_held, if_missed = (_durations(known, mean, theta[5]) for mean in (theta[3], theta[3] + theta[4]))
    log_likelihood, held, excess, per_log_offset = _results(known, theta, if_held.log_density, if_missed.log_density)
    missed_per_mean = ((1.0 - held) * if_missed.per_mean).sum()
    slope = [
        excess.sum(),
        (excess * known.occlusion).sum(),
        per_log_offset,
        (held * if_held.per_mean).sum() + missed_per_mean,
        missed_per_mean,
        (held * if_held.per_log_std + (1.0 - held) * if_missed.per_log_std).sum(),
    ]
    return prior.loss(theta, log_likelihood, np.array(slope))


def _durations(known: _Attempts, mean: np.float64, log_std: np.float64) -> _Durations:
    from scipy.special import log_ndtr

    std = np.exp(log_std)
    z = (known.log_s - mean) / std
    log_density, log_beyond = -(z**2) / 2.0 - _LOG_ROOT_2_PI, log_ndtr(-z)
    hazard = np.exp(log_density - log_beyond)
    return _Durations(
        log_density=np.where(known.is_ended, log_density - log_std - known.log_s, log_beyond),
        per_mean=np.where(known.is_ended, z, hazard) / std,
        per_log_std=np.where(known.is_ended, z**2 - 1.0, z * hazard),
    )


def _results(known: _Attempts, theta: Logistic, held: Rows, missed: Rows) -> tuple[float, Rows, Rows, float]:
    """Sum over what was not seen of the results, and over the offsets, given log g of both results.

    Returns
    -------
    log_likelihood : float
    held : Float[ndarray, "n"]
        P(it held), given all that was seen.
    excess : Float[ndarray, "n"]
        That, less P(it held) before its own result was seen.
    per_log_offset : float
        What log σ changes of the log-likelihood.
    """
    offset = np.exp(theta[2]) * _OF_LOGISTIC.nodes
    odds = np.exp(offset) * np.exp(theta[0] + theta[1] * known.occlusion + known.grip)
    # Relative to the likelier of both results, so that the sum of no cut attempt is 0.
    most = np.where(known.is_cut, np.maximum(held, missed), np.where(known.is_held, held, missed))
    if_held = np.where(known.is_cut, np.exp(np.minimum(held - missed, 0.0)), known.is_held)
    if_missed = np.where(known.is_cut, np.exp(np.minimum(missed - held, 0.0)), ~known.is_held)
    weighed = if_held * odds
    either = weighed + if_missed
    of_object = np.add.reduceat(np.log(either / (1.0 + odds)), known.first, axis=1)
    log_integral, posterior = _OF_LOGISTIC.integrated(of_object)
    posterior = posterior[:, known.rank]
    excess = posterior * (weighed / either - odds / (1.0 + odds))
    log_likelihood = float(most.sum() + log_integral.sum())
    return (
        log_likelihood,
        (posterior * (weighed / either)).sum(axis=0),
        excess.sum(axis=0),
        float((excess * offset).sum()),
    )
