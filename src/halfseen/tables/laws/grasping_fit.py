"""The assumed law of grasping, its numbers fitted to attempts of which some were cut, by maximum likelihood.

Under it an attempt misses at its limit and at no other time, so its misses are taken to have lasted the limit.

========  ==========================================================================================================
symbol    here
========  ==========================================================================================================
a, b      log_time, log_time_per_occlusion
u         what is hidden of an object's grip offset, N(0, σ²)
η         grip − a − b·occ: log rate at which an attempt holds, less u
d, t      1 if the attempt held, else 0; time that it was watched: until it held, until it was cut, or the limit [s]
========  ==========================================================================================================

T = exp(a + b·occ − grip − u)·E is exponential with rate e^{η + u}. An attempt that held at t has density e^{η + u −
t·e^{η + u}}; one that missed, or was cut, at t has survival e^{−t·e^{η + u}}. So censored attempts are neither dropped
nor weighted, and with D = Σ d and H = Σ t·e^η over the attempts of one object, which share u,

    log L(a, b, σ) = Σ_attempts d·η + Σ_objects log ∫ exp(D·u − H·e^u) φ(u / σ) / σ du,

the integral by Gauss–Hermite quadrature: survival with a frailty of each object [Hougaard2000]_. Cuts may depend on all
that was seen until then, the age of the attempt included. What maximises it also pays a weak normal prior (`CENTRE`,
`SPREAD`) on a, b and log σ, which weighs as much as a few attempts do.
"""

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from halfseen.arrays import Rows
from halfseen.tables.laws.watched import Watched
from halfseen.world.grasping import AssumedGrasping

Theta = Float[np.ndarray, "3"]
"""a − log τ, b and log σ."""
PerObject = Float[np.ndarray, " objects"]

CENTRE = np.array([-np.log(np.log(2.0)), 0.0, np.log(0.5)])
"""Mode of the prior: half of the attempts hold, occlusion changes nothing, and objects differ somewhat."""

SPREAD = np.array([2.0, 2.0, 1.0])
"""Its standard deviations."""

NUM_NODES = 31
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(NUM_NODES)
_LOG_WEIGHTS = np.log(_WEIGHTS / _WEIGHTS.sum())


def fit_grasping(tried: Watched, limit_s: float) -> AssumedGrasping:
    """Fit a, b and σ; without attempts they are the prior's.

    Parameters
    ----------
    tried
        The attempts.
    limit_s
        τ, which is known [s].
    """
    return law_of(fit_theta(tried, limit_s), limit_s)


def fit_theta(tried: Watched, limit_s: float) -> Theta:
    """Fit the three numbers, as `negative_log_posterior` takes them."""
    bounds = [(-10.0, 10.0), (-15.0, 15.0), (-5.0, 2.0)]
    return minimize(negative_log_posterior, CENTRE, args=(tried, limit_s), jac=True, method="L-BFGS-B", bounds=bounds).x


def law_of(theta: Theta, limit_s: float) -> AssumedGrasping:
    """Read the parameters that `negative_log_posterior` takes."""
    log_time, per_occlusion, log_std = (float(value) for value in theta)
    return AssumedGrasping(float(np.exp(log_std)), log_time + float(np.log(limit_s)), per_occlusion, limit_s)


def negative_log_posterior(theta: Theta, tried: Watched, limit_s: float) -> tuple[float, Theta]:
    """What `fit_grasping` minimises, and its gradient."""
    shift = (theta - CENTRE) / SPREAD
    log_rate = tried.grip - theta[0] - np.log(limit_s) - theta[1] * tried.occlusion
    hazard = np.where(tried.is_missed, limit_s, tried.watched_s) * np.exp(log_rate)
    of_object = _of_objects(tried, hazard)
    log_likelihood, rate, per_log_std = _integrated(*of_object, float(np.exp(theta[2])))
    # What an attempt held more often than was to be expected.
    excess = tried.is_held - hazard * rate[tried.object]
    gradient = np.array([-excess.sum(), -(excess * tried.occlusion).sum(), per_log_std])
    total = (tried.is_held * log_rate).sum() + log_likelihood
    return float((shift**2).sum() / 2.0 - total), shift / SPREAD - gradient


def _of_objects(tried: Watched, hazard: Rows) -> tuple[PerObject, PerObject]:
    """D and H of each object; numbers that no attempt has stand for 0 and 0, which tell nothing."""
    held, hazards = (np.bincount(tried.object, weights) for weights in (tried.is_held, hazard))
    return held.astype(np.float64), hazards.astype(np.float64)


def _integrated(held: PerObject, hazard: PerObject, std: float) -> tuple[float, PerObject, float]:
    """Σ log ∫ exp(D·u − H·e^u) over u, the posterior mean of e^u of each object, and what log σ changes."""
    offset = std * _NODES[:, None]
    rate = np.exp(offset)
    terms = _LOG_WEIGHTS[:, None] + held * offset - hazard * rate
    largest = terms.max(axis=0)
    mass = np.exp(terms - largest)
    total = mass.sum(axis=0)
    posterior = mass / total
    per_log_std = (posterior * offset * (held - hazard * rate)).sum()
    return float((largest + np.log(total)).sum()), (posterior * rate).sum(axis=0), float(per_log_std)
