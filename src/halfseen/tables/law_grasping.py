"""Laws of grasping, fitted to attempts, some of them cut, by maximum likelihood; and the choice between two families.

========  ==========================================================================================================
symbol    here
========  ==========================================================================================================
u         unobserved part of an object's grip offset, N(0, σ²)
τ         the limit of an attempt [s]
t         time for which an attempt was watched: until it held, missed or was cut, or τ [s]
========  ==========================================================================================================

**Exponential** (`AssumedGrasping`). An attempt misses only at τ, so misses count as having lasted τ. With a the log
time and b its slope in occlusion, η = grip − a − b·occ is the log rate at which an attempt holds, without u:
T = exp(a + b·occ − grip − u)·E is exponential with rate e^{η + u}. An attempt that held at t has density
e^{η + u − t·e^{η + u}}; one that missed, or was cut, at t has survival e^{−t·e^{η + u}}. So censored attempts are
neither dropped nor weighted. With d = 1 where an attempt held and 0 elsewhere, D = Σ d and H = Σ t·e^η over the
attempts of one object, which share u,

    log L(a, b, σ) = Σ_attempts d·η + Σ_objects log ∫ exp(D·u − H·e^u) φ(u / σ) / σ du.

Cuts may depend on everything observed before them, including the age of the attempt.

**Logistic** (`FittedGrasping`). An attempt holds with probability p = expit(a + b·occ + grip + u). Durations are
lognormal, and end at τ. With μ that of holds or of misses, and z = (log t − μ) / s, an attempt that ended at t has

    g = φ(z) / (s·t)  where t < `AT_LIMIT`·τ,   and   g = 1 − Φ((log(`AT_LIMIT`·τ) − μ) / s)  at the limit;

One cut at t has g = 1 − Φ(z). With g_held and g_missed for the two means, the likelihood of an attempt given u is

    p·g_held  if it held,   (1 − p)·g_missed  if it missed,   p·g_held + (1 − p)·g_missed  if it was cut.

So a cut attempt counts as one that lasts longer, whatever its outcome; where misses take long, it is evidence of a
miss. Under the prior, misses last as long as holds.

**Choice of the family.** Both densities are with respect to Lebesgue measure on durations below `AT_LIMIT`·τ, plus a
point mass for those at τ. The chosen family has the larger

    log L(θ̂) − |(θ̂ − mode) / spread|² / 2 − (k / 2)·log n,

the maximum of the log-posterior minus a penalty for its k parameters (3 or 6), with n attempts [Schwarz1978]_. The
measure has two consequences:

- The exponential family misses only at the limit. A single earlier miss has density 0 in it, so that the logistic
  family is chosen, whatever its density.
- An attempt that held at the limit is at the point mass as well. The exponential family has a density f there, and
  gives the point the mass f·(1 − `AT_LIMIT`)·τ; the lognormal one gives it the share of durations beyond.

Offsets u of objects are integrated out by Gauss–Hermite quadrature, as are frailties [Hougaard2000]_.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from halfseen.arrays import RowIds, RowMask, Rows
from halfseen.shapes import Float
from halfseen.tables.evidence import AT_LIMIT, Prior, TimedAttempts, least
from halfseen.world.grasping import AssumedGrasping, FittedGrasping, GraspLaw

REACH = np.array([10.0, 15.0, 2.5, 5.0, 5.0, 4.0])
"""Largest distance of each parameter of the logistic family from the prior's mode."""
_LOG_ROOT_2_PI = 0.5 * np.log(2.0 * np.pi)
PRIOR_SPREAD = 0.25
"""Spread of a prior centred at a given law, as a share of the weak prior's."""


def choose_grasping(
    tried: TimedAttempts, limit_s: float, known: GraspLaw | None = None
) -> AssumedGrasping | FittedGrasping:
    """Fit both families to attempts, and choose the better one; the exponential one if they are equal.

    τ is `limit_s` [s]. If a law is `known`, its family is fitted with the prior centred at it; None for weak priors.
    """
    families: list[Exponential | LogisticFamily] = [LogisticFamily(tried, limit_s)]
    if misses_at_limit_alone(tried, limit_s):
        families.insert(0, Exponential(tried, limit_s))
    about = {type(family): family.theta_of(known) for family in families}
    if any(theta is not None for theta in about.values()):
        families = [replace(family, known=theta) for family in families if (theta := about[type(family)]) is not None]
    fits = [(family, family.fitted()) for family in families]
    family, theta = max(fits, key=lambda fit: fit[0].score(fit[1]))
    return family.law(theta)


def misses_at_limit_alone(tried: TimedAttempts, limit_s: float) -> bool:
    """Whether the attempts are possible in the exponential family."""
    return not (tried.is_missed & (tried.watched_s < AT_LIMIT * limit_s)).any()


class _Quadrature(NamedTuple):
    """∫ f(u) φ(u) du as a sum over nodes, the first axis of all arrays."""

    nodes: Float[np.ndarray, "nodes 1"]
    log_weights: Float[np.ndarray, "nodes 1"]

    @classmethod
    def of(cls, num_nodes: int) -> "_Quadrature":
        nodes, weights = np.polynomial.hermite_e.hermegauss(num_nodes)
        return cls(nodes[:, None], np.log(weights / weights.sum())[:, None])

    def integrated(self, log_values: Float[np.ndarray, "nodes n"]) -> tuple[Rows, Float[np.ndarray, "nodes n"]]:
        """Log of each integral, and the posterior weights of the nodes."""
        terms = log_values + self.log_weights
        largest = terms.max(axis=0)
        mass = np.exp(terms - largest)
        total = mass.sum(axis=0)
        return largest + np.log(total), mass / total


_OF_EXPONENTIAL, _OF_LOGISTIC = _Quadrature.of(31), _Quadrature.of(15)


@dataclass(frozen=True, eq=False)
class _AttemptFamily:
    """Laws of attempts that end within τ (`limit_s` [s]), with a prior centred at θ `known`; None for a weak prior."""

    tried: TimedAttempts
    limit_s: float
    known: Rows | None = None

    @property
    def weak(self) -> Prior:
        """The prior without a known law."""
        raise NotImplementedError

    @property
    def prior(self) -> Prior:
        """The prior."""
        return self.weak if self.known is None else Prior(self.known, PRIOR_SPREAD * self.weak.spread)

    def loss(self, theta: Rows) -> tuple[float, Rows]:
        """Negative log-posterior, and its gradient."""
        raise NotImplementedError

    def score(self, theta: Rows) -> float:
        """Maximum of the log-posterior minus the penalty for the number of parameters."""
        return -self.loss(theta)[0] - len(theta) / 2.0 * float(np.log(max(len(self.tried.object), 1)))


class Exponential(_AttemptFamily):
    """The exponential family; θ is a − log τ, b and log σ."""

    @property
    def weak(self) -> Prior:
        """Half of the attempts hold, occlusion has no effect, and objects differ somewhat."""
        return Prior(np.array([-np.log(np.log(2.0)), 0.0, np.log(0.5)]), np.array([2.0, 2.0, 1.0]))

    def theta_of(self, law: GraspLaw | None) -> Float[np.ndarray, "3"] | None:
        """θ of a law; None for a law of the other family."""
        if not isinstance(law, AssumedGrasping):
            return None
        log_time = float(law.log_time) - float(np.log(self.limit_s))
        return np.array([log_time, float(law.log_time_per_occlusion), np.log(float(law.offset_std))])

    def fitted(self) -> Float[np.ndarray, "3"]:
        """The posterior mode of θ; without attempts it is the prior's mode."""
        return least(self.loss, self.prior.mode, [(-10.0, 10.0), (-15.0, 15.0), (-5.0, 2.0)])

    def law(self, theta: Float[np.ndarray, "3"]) -> AssumedGrasping:
        """The law with parameters θ."""
        log_time, per_occlusion, log_std = theta.tolist()
        return AssumedGrasping(
            float(np.exp(log_std)), log_time + float(np.log(self.limit_s)), per_occlusion, self.limit_s
        )

    def score(self, theta: Float[np.ndarray, "3"]) -> float:
        """Score with the point mass of attempts that held at the limit."""
        num_at_limit = int((self.tried.is_held & (self.tried.watched_s >= AT_LIMIT * self.limit_s)).sum())
        at_limit = num_at_limit * float(np.log((1.0 - AT_LIMIT) * self.limit_s))
        return at_limit + super().score(theta)

    def loss(self, theta: Float[np.ndarray, "3"]) -> tuple[float, Float[np.ndarray, "3"]]:
        """Negative log-posterior, and its gradient."""
        tried = self.tried
        log_rate = tried.grip - theta[0] - np.log(self.limit_s) - theta[1] * tried.occlusion
        hazard = np.where(tried.is_missed, self.limit_s, tried.watched_s) * np.exp(log_rate)
        # D and H of each object; both are 0 for numbers without attempts, which adds no information.
        held, hazards = (np.bincount(tried.object, weights) * 1.0 for weights in (tried.is_held, hazard))
        offset = float(np.exp(theta[2])) * _OF_EXPONENTIAL.nodes
        rate = np.exp(offset)
        log_integral, posterior = _OF_EXPONENTIAL.integrated(held * offset - hazards * rate)
        # Holds minus expected holds.
        excess = tried.is_held - hazard * (posterior * rate).sum(axis=0)[tried.object]
        per_log_std = (posterior * offset * (held - hazards * rate)).sum()
        slope = np.array([-excess.sum(), -(excess * tried.occlusion).sum(), per_log_std])
        return self.prior.loss(theta, (tried.is_held * log_rate).sum() + log_integral.sum(), slope)


class _Attempts(NamedTuple):
    """Attempts in the order of their objects, without uninformative ones."""

    occlusion: Rows
    grip: Rows
    log_s: Rows
    is_ended: RowMask
    """Whether its end was observed and came before the limit."""
    is_held: RowMask
    is_cut: RowMask
    rank: RowIds
    first: RowIds
    """The first attempt at each object."""


class LogisticFamily(_AttemptFamily):
    """The logistic family; θ is a, b, log σ, mean log duration of holds, difference of misses from it, and log s."""

    @property
    def weak(self) -> Prior:
        """Half of the attempts hold, whatever the occlusion, and both outcomes take half the limit."""
        mode = np.array([0.0, 0.0, np.log(0.5), np.log(self.limit_s / 2.0), 0.0, np.log(0.5)])
        return Prior(mode, np.array([2.0, 2.0, 1.0, 1.0, 1.0, 1.0]))

    def theta_of(self, law: GraspLaw | None) -> Float[np.ndarray, "6"] | None:
        """θ of a law; None for a law of the other family."""
        if not isinstance(law, FittedGrasping):
            return None
        held, longer = float(law.log_held_s), float(law.log_missed_s) - float(law.log_held_s)
        stds = np.log([float(law.offset_std), float(law.log_std)])
        return np.array([float(law.log_odds), float(law.log_odds_per_occlusion), stds[0], held, longer, stds[1]])

    def fitted(self) -> Float[np.ndarray, "6"]:
        """The posterior mode of θ; without attempts it is the prior's mode."""
        start = self._start()
        scale = self._scale(start)

        def loss(steps: Rows) -> tuple[float, Rows]:
            value, gradient = self.loss(start + scale * steps)
            return value, scale * gradient

        low, high = ((self.prior.mode + sign * REACH - start) / scale for sign in (-1.0, 1.0))
        return start + scale * least(loss, np.zeros(len(start)), list(zip(low, high, strict=True)), ftol=1e-12)

    def law(self, theta: Float[np.ndarray, "6"]) -> FittedGrasping:
        """The law with parameters θ."""
        log_odds, per_occlusion, log_offset, log_held_s, longer, log_std = theta.tolist()
        stds = float(np.exp(log_offset)), float(np.exp(log_std))
        return FittedGrasping(log_odds, per_occlusion, stds[0], log_held_s, log_held_s + longer, stds[1], self.limit_s)

    @cached_property
    def _known(self) -> _Attempts:
        tried, limit_s = self.tried, self.limit_s
        is_cut = ~(tried.is_held | tried.is_missed)
        order = np.argsort(tried.object, kind="stable")
        order = order[~is_cut[order] | (tried.watched_s[order] > 0.0)]
        _, first, rank = np.unique(tried.object[order], return_index=True, return_inverse=True)
        is_ended = ~is_cut & (tried.watched_s < AT_LIMIT * limit_s)
        # An attempt at the limit lasted at least `AT_LIMIT` of it; a time of 0 has no logarithm.
        until_s = np.where(is_cut | is_ended, tried.watched_s, AT_LIMIT * limit_s)
        log_s = np.log(np.maximum(until_s, 1e-3 * limit_s))
        columns = (tried.occlusion, tried.grip, log_s, is_ended, tried.is_held, is_cut)
        return _Attempts(*(column[order] for column in columns), rank=rank, first=first)

    def _start(self) -> Float[np.ndarray, "6"]:
        """The prior's mode, moved to the observed outcomes and durations."""
        known, mode = self._known, self.prior.mode
        start, log_s, num_held = mode.copy(), known.log_s[known.is_ended], int(known.is_held.sum())
        start[0] = np.log(num_held + 1.0) - np.log(len(known.log_s) - known.is_cut.sum() - num_held + 1.0)
        if len(log_s) > 1:
            start[3], start[5] = log_s.mean(), np.log(log_s.std() + 0.05)
        return np.clip(start, mode - REACH / 2.0, mode + REACH / 2.0)

    def _scale(self, start: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6"]:
        """Rough posterior standard deviation of each parameter, so that steps have equal length in all of them."""
        num, precision = len(self._known.log_s), np.exp(-2.0 * start[5])
        num_not_held, spread = num - self._known.is_held.sum(), float(np.var(self._known.occlusion)) if num else 0.0
        known = np.array([num / 5.0, num * spread / 5.0, num / 20.0, num * precision, num_not_held * precision, num])
        return 1.0 / np.sqrt(self.prior.spread**-2.0 + known)

    def loss(self, theta: Float[np.ndarray, "6"]) -> tuple[float, Float[np.ndarray, "6"]]:
        """Negative log-posterior, and its gradient."""
        known = self._known
        # log g of each attempt for both means, and its slopes.
        (held, held_mean, held_std), (missed, missed_mean, missed_std) = (
            _durations(known, mean, theta[5]) for mean in (theta[3], theta[3] + theta[4])
        )
        offset = np.exp(theta[2]) * _OF_LOGISTIC.nodes
        odds = np.exp(offset) * np.exp(theta[0] + theta[1] * known.occlusion + known.grip)
        # Relative to the likelier of both outcomes, so that the sum of a cut attempt never vanishes.
        most = np.where(known.is_cut, np.maximum(held, missed), np.where(known.is_held, held, missed))
        if_held = np.where(known.is_cut, np.exp(np.minimum(held - missed, 0.0)), known.is_held) * odds
        either = if_held + np.where(known.is_cut, np.exp(np.minimum(missed - held, 0.0)), ~known.is_held)
        of_object = np.add.reduceat(np.log(either / (1.0 + odds)), known.first, axis=1)
        log_integral, posterior = _OF_LOGISTIC.integrated(of_object)
        posterior = posterior[:, known.rank]
        # P(held) given all evidence, and that minus P(held) without the attempt's own outcome.
        chance = (posterior * (if_held / either)).sum(axis=0)
        excess = posterior * (if_held / either - odds / (1.0 + odds))
        per_missed_mean = ((1.0 - chance) * missed_mean).sum()
        slope = [
            excess.sum(),
            (excess.sum(axis=0) * known.occlusion).sum(),
            (excess * offset).sum(),
            (chance * held_mean).sum() + per_missed_mean,
            per_missed_mean,
            (chance * held_std + (1.0 - chance) * missed_std).sum(),
        ]
        return self.prior.loss(theta, float(most.sum() + log_integral.sum()), np.array(slope))


def _durations(known: _Attempts, mean: float, log_std: float) -> tuple[Rows, Rows, Rows]:
    """Log g of each attempt, and its derivatives by the mean and by log s."""
    from scipy.special import log_ndtr

    std = np.exp(log_std)
    z = (known.log_s - mean) / std
    log_density, log_beyond = -(z**2) / 2.0 - _LOG_ROOT_2_PI, log_ndtr(-z)
    hazard = np.exp(log_density - log_beyond)
    return (
        np.where(known.is_ended, log_density - log_std - known.log_s, log_beyond),
        np.where(known.is_ended, z, hazard) / std,
        np.where(known.is_ended, z**2 - 1.0, z * hazard),
    )
