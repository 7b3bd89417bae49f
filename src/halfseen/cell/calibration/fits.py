"""Fits of a cell's laws: the probability that an attempt holds, durations of attempts, and labels by the share in view.

*P(an attempt holds), given visible facts*, is a logistic regression with a random offset per object, under censoring.
For attempts i of object g, with covariates x_i and weights w_i ∝ δ_i / Ĝ(time_i⁻) of mean 1,

    ℓ(β, σ) = Σ_g log ∫ Π_{i ∈ g} expit(±(x_i·β + σ z))^{w_i} φ(z) dz,

with the integral by Gauss–Hermite quadrature and a weak normal prior. A cut attempt has weight 0; the weights of the
others represent it. Standard errors are robust, with tables as clusters [LiangZeger1986]_.

The offset of an object is latent, but its past attempts j are evidence of it. With φ the standard normal density,

    P(held | x, past) = ∫ expit(x·β + σz) Π_j expit(±(x_j·β + σz)) φ(z) dz / ∫ Π_j expit(±(x_j·β + σz)) φ(z) dz,

with both integrals at the same nodes.

*Durations* of attempts are lognormal, with separate means for those that hold and those that miss.

*Labels.* An object is labelled DIRTY once a share V of its surface has been in view, or never. V is interval-censored:
it lies between the shares seen before and with the first DIRTY label, or beyond all that was seen. The curve P(V ≤ v)
is linear between knots; its steps are the maximum-likelihood estimates, found by self-consistency [Turnbull1976]_.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.optimize import minimize
from scipy.special import expit, log_expit, logsumexp, softmax

from halfseen.cell.calibration.attempts import FACTS
from halfseen.errors import LogError
from halfseen.perception.labels import FACING_SHARE
from halfseen.shapes import Float, Int
from halfseen.tables.grasp_attempts import checked_attempts
from halfseen.world.seeing import SAME_VIEW, PersistentSeeing

CENTRES, SCALES = (
    {"is_lying": 0.0, "width_m": 0.075, "room_m": 0.04},
    {"is_lying": 1.0, "width_m": 0.02, "room_m": 0.03},
)
"""Facts enter as (fact − centre) / scale: a standing cup 7.5 cm wide with 4 cm of room has offset 0."""
NAMES = ("log_odds", "occlusion", *FACTS, "log_offset_std")  # names of the parameters, in order
_PRIOR_MEAN = np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.log(0.5)])
_PRIOR_STD = np.array([5.0, 5.0, 5.0, 2.0, 2.0, 1.0])
_NUM_NEWTON_STEPS = 4
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(15)


@dataclass(frozen=True)
class GraspFit:
    """Fit of P(held): estimates of `NAMES`, and their robust covariance with tables as clusters.

    Also the numbers of decided and of cut attempts, and the effective sample size of the weights.
    """

    estimate: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    num_decided: int
    num_cut: int
    effective_sample_size: float

    @property
    def standard_error(self) -> Float[np.ndarray, " p"]:
        """Standard error of each estimate."""
        return np.sqrt(np.diag(self.covariance))


def design(trials: pd.DataFrame) -> Float[np.ndarray, "n k"]:
    """Covariates of attempts: 1, the occlusion, and the facts standardised by `CENTRES` and `SCALES`.

    Parameters
    ----------
    trials
        Attempts with occlusion and `FACTS`.
    """
    facts = [(trials[name].to_numpy(dtype=np.float64) - CENTRES[name]) / SCALES[name] for name in FACTS]
    return np.column_stack([np.ones(len(trials)), trials["occlusion"], *facts])


def fit_grasping(trials: pd.DataFrame, censoring: str = "kaplan-meier") -> GraspFit:
    """Fit the regression of P(held).

    Parameters
    ----------
    trials
        Attempts from `halfseen.cell.calibration.attempts.trials`.
    censoring
        As in `halfseen.tables.grasp_models.BetaGrasp`.

    Raises
    ------
    ArgumentError
        A value is impossible for an attempt, or no attempt was decided.
    PositivityError
        A weight is not identified.
    LogError
        The estimates are not finite.
    """
    decided = checked_attempts(trials, censoring)
    kept = trials["is_finished"].to_numpy(dtype=bool)
    # Number the objects from 0; each has its own integral.
    objects = pd.factorize(decided.group)[0].astype(np.int64)
    clusters = pd.factorize(trials["trajectory"][kept])[0].astype(np.int64)
    # The mean weight is 1: within the integral over an offset, larger weights would act like more attempts.
    weight = decided.weight / decided.weight.mean()
    data = _Data(design(trials)[kept], np.where(decided.succeeded, 1.0, -1.0), weight, objects)
    estimate = minimize(lambda theta: _posterior(theta, data)[:2], _PRIOR_MEAN, jac=True).x
    for _ in range(_NUM_NEWTON_STEPS):
        # Converge to the last digits, so that every machine finds the same estimate.
        _, gradient, _, curvature = _posterior(estimate, data)
        estimate = estimate - np.linalg.solve(curvature(), gradient)
    _, _, scores, curvature = _posterior(estimate, data)
    bread = np.linalg.inv(curvature())
    of_object = np.zeros(len(scores), dtype=np.int64)
    of_object[objects] = clusters
    by_table = np.zeros((int(clusters.max()) + 1, len(estimate)))
    np.add.at(by_table, of_object, scores)
    covariance = bread @ (by_table.T @ by_table) @ bread
    if not (np.isfinite(estimate).all() and np.isfinite(covariance).all()):
        raise LogError("the fit to these attempts is not finite; look for implausibly large values in the objects")
    num_cut = len(trials) - len(clusters)
    return GraspFit(estimate, covariance, len(clusters), num_cut, decided.diagnostics.effective_sample_size)


class _Data(NamedTuple):
    """Decided attempts."""

    covariates: Float[np.ndarray, "n k"]
    sign: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]
    objects: Int[np.ndarray, " n"]


def _posterior(
    theta: Float[np.ndarray, " p"], data: _Data
) -> tuple[float, Float[np.ndarray, " p"], Float[np.ndarray, "objects p"], Callable[[], Float[np.ndarray, "p p"]]]:
    """Negative log-posterior, its gradient, the gradient of each object's log-likelihood, and the Hessian on demand.

    With l_q the log-likelihood of an object at node q of its offset, and π_q its posterior there, the gradient of
    log Σ_q e^{l_q} is Σ π l', and its Hessian Σ π (l'' + l' l'ᵀ) − (Σ π l')(Σ π l')ᵀ.
    """
    num_objects, std = int(data.objects.max()) + 1, np.exp(theta[-1])
    logits = data.sign[:, None] * ((data.covariates @ theta[:-1])[:, None] + std * _NODES)
    slope = data.weight[:, None] * data.sign[:, None] * expit(-logits)
    # Derivative of each logit with respect to each parameter, by node.
    moves = np.concatenate(
        [
            np.broadcast_to(data.covariates[:, None], (*logits.shape, len(theta) - 1)),
            np.broadcast_to((std * _NODES)[:, None], (*logits.shape, 1)),
        ],
        axis=2,
    )

    def by_object(values: np.ndarray) -> np.ndarray:
        total = np.zeros((num_objects, *values.shape[1:]))
        np.add.at(total, data.objects, values)
        return total

    each = by_object(data.weight[:, None] * log_expit(logits)) + np.log(_WEIGHTS / _WEIGHTS.sum())
    found = np.asarray(logsumexp(each, axis=1))
    chance = np.exp(each - found[:, None])
    gradients = by_object(slope[..., None] * moves)
    scores = np.einsum("oq,oqp->op", chance, gradients)
    shift = (theta - _PRIOR_MEAN) / _PRIOR_STD

    def curvature() -> np.ndarray:
        bend = -data.weight[:, None] * expit(logits) * expit(-logits)
        hessians = by_object(bend[..., None, None] * moves[..., :, None] * moves[..., None, :])
        # The last parameter is a logarithm, so the logit has a second derivative in it.
        hessians[..., -1, -1] += by_object(slope * std * _NODES)
        curved = np.einsum("oq,oqpr->pr", chance, hessians + gradients[..., :, None] * gradients[..., None, :])
        return np.diag(_PRIOR_STD**-2) - (curved - scores.T @ scores)

    value = 0.5 * float(shift @ shift) - float(found.sum())
    return value, shift / _PRIOR_STD - scores.sum(axis=0), scores, curvature


_MANY_NODES, _MANY_WEIGHTS = np.polynomial.hermite_e.hermegauss(41)
# More nodes than the fit: the offset's posterior for an object with many attempts is narrow.


def held_given_past(theta: Float[np.ndarray, " p"], trials: pd.DataFrame) -> Float[np.ndarray, " n"]:
    """Predict each attempt from earlier attempts on the same object.

    Parameters
    ----------
    theta
        Estimates of `halfseen.cell.calibration.fits.NAMES`.
    trials
        Attempts from `halfseen.cell.calibration.attempts.trials`, with all past attempts on each object. The outcome of
        an attempt enters only later predictions; a cut attempt enters none.
    """
    logits = (design(trials) @ theta[:-1])[:, None] + np.exp(theta[-1]) * _MANY_NODES
    is_decided = trials["succeeded"].notna().to_numpy()
    is_held = trials["succeeded"].isin([True]).to_numpy()
    sign = np.where(is_held, 1.0, -1.0)[:, None]
    logs_of_held = pd.DataFrame(np.where(is_decided[:, None], log_expit(sign * logits), 0.0))
    order = np.argsort(trials["stage"].to_numpy(), kind="stable")
    in_turn = logs_of_held.iloc[order]
    objects = trials["object"].to_numpy()[order]
    before = (in_turn.groupby(objects).cumsum() - in_turn).sort_index().to_numpy()
    return np.sum(softmax(before + np.log(_MANY_WEIGHTS), axis=1) * expit(logits), axis=1)


def held_share(theta: Float[np.ndarray, " p"], covariates: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " n"]:
    """P(held) of a first attempt, with the offset integrated out.

    Parameters
    ----------
    theta
        As for `held_given_past`.
    covariates
        Covariates from `halfseen.cell.calibration.fits.design`.
    """
    logits = (covariates @ theta[:-1])[:, None] + np.exp(theta[-1]) * _MANY_NODES
    return expit(logits) @ (_MANY_WEIGHTS / _MANY_WEIGHTS.sum())


FEWEST_MISSES = 5  # with fewer, the mean duration of misses is that of all attempts


class TimeFit(NamedTuple):
    """Mean log durations of attempts that hold and that miss, and their standard deviation.

    `rest_s` is the mean time from the end of an attempt to the next decision [s].
    """

    log_held_s: float
    log_missed_s: float
    log_std: float
    rest_s: float


def fit_times(trials: pd.DataFrame) -> TimeFit:
    """Fit the durations, with censoring weights for cut attempts.

    Parameters
    ----------
    trials
        Attempts from `halfseen.cell.calibration.attempts.trials`; those without a grasp to try count only for `rest_s`.
    """
    decided = checked_attempts(trials)
    rows = pd.DataFrame(trials[trials["is_finished"].to_numpy(dtype=bool)])
    attempt_s, watched_s = (rows[name].to_numpy(dtype=np.float64) for name in ("attempt_s", "time_s"))
    is_tried = attempt_s > 0.0
    weight, held = decided.weight[is_tried], decided.succeeded[is_tried]
    log_s = np.log(attempt_s[is_tried])
    means = [float(np.average(log_s[which], weights=weight[which])) for which in _groups(held)]
    spread = log_s - np.where(held, *means)
    rest_s = float(np.average(watched_s - attempt_s, weights=decided.weight))
    return TimeFit(means[0], means[1], float(np.sqrt(np.average(spread**2, weights=weight))), rest_s)


def _groups(held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    missed = ~held
    every = np.ones_like(held)
    return (held if held.any() else every), (missed if missed.sum() >= FEWEST_MISSES else every)


VIEWS = (0.25 * FACING_SHARE, 0.5 * FACING_SHARE, 0.75 * FACING_SHARE, FACING_SHARE, 1.0)
"""Knots of the curves, as shares of the surface: quarters of what a look at the table shows, and all."""
_NUM_STEPS, _SMALLEST_CHANGE = 2000, 1e-10

Interval = tuple[float, float]
"""Shares seen before and with the first DIRTY label; the second is infinite if there was none."""


def fit_seeing(glances: pd.DataFrame) -> PersistentSeeing:
    """Fit both curves.

    Parameters
    ----------
    glances
        One row per object, from `attempts.glances`.

    Raises
    ------
    LogError
        No object is dirty, or none is clean.
    """
    curves = []
    for is_dirty in (True, False):
        rows = pd.DataFrame(glances[glances["is_dirty"] == is_dirty])
        if rows.empty:
            kind = "dirty" if is_dirty else "clean"
            raise LogError(
                f"objects: none of {len(glances)} is {kind}; calibrating labels needs both dirty and clean objects"
            )
        curves.append(tuple(found_by(intervals(rows)).tolist()))
    return PersistentSeeing(FACING_SHARE, VIEWS, curves[0], curves[1])


def intervals(rows: pd.DataFrame) -> list[Interval]:
    """Interval of each object that contains the share V at which its label becomes DIRTY.

    Parameters
    ----------
    rows
        Objects with `attempts.GLANCES`.
    """
    columns = (rows[name] for name in ("glance_occlusions", "glance_held", "glance_dirty"))
    return [_interval(zip(*each, strict=True)) for each in zip(*columns, strict=True)]


def _interval(labels: Iterable[tuple[float, bool, bool]]) -> Interval:
    seen = 0.0
    for occlusion, is_held, says_dirty in labels:
        shown = 1.0 if is_held else FACING_SHARE * (1.0 - occlusion)
        # A look that shows no more than before is not new evidence: its label repeats, or differs by noise.
        if shown <= seen + SAME_VIEW:
            continue
        if says_dirty:
            return seen, shown
        seen = shown
    return seen, np.inf


def found_by(intervals: list[Interval]) -> Float[np.ndarray, " knots"]:
    """Maximum-likelihood estimate of P(V ≤ v) at each of `VIEWS`."""
    knots = np.array([0.0, *VIEWS])
    low, high = np.array(intervals, dtype=np.float64).reshape(-1, 2).T
    # Share of each segment within an interval; the last column is "never".
    begins, ends = np.maximum(knots[:-1], low[:, None]), np.minimum(knots[1:], high[:, None])
    inside = np.clip(ends - begins, 0.0, None) / np.diff(knots)
    share = np.column_stack([inside, np.isinf(high)])
    share = share[share.sum(axis=1) > 0]
    mass = np.full(share.shape[1], 1.0 / share.shape[1])
    for _ in range(_NUM_STEPS):
        weight = share * mass
        after = (weight / weight.sum(axis=1, keepdims=True)).mean(axis=0)
        is_settled = np.abs(after - mass).max() < _SMALLEST_CHANGE
        mass = after
        if is_settled:
            break
    return np.minimum(np.cumsum(mass[:-1]), 1.0)
