"""P(an attempt holds), given what is seen: a logistic regression with a random offset of each object, under censoring.

For attempts i of object g, with covariates x_i and weights w_i ∝ δ_i / Ĝ(time_i⁻) of mean 1,

    ℓ(β, σ) = Σ_g log ∫ Π_{i ∈ g} expit(±(x_i·β + σ z))^{w_i} φ(z) dz,

the integral by Gauss–Hermite quadrature, plus a weak normal prior. An attempt that was cut weighs nothing, and stands
for by those that were seen. Standard errors are robust, tables being the clusters [LiangZeger1986]_.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float, Int
from scipy.optimize import minimize

from halfseen.cell.calibration.trials import FACTS
from halfseen.errors import LogError
from halfseen.tables.grasp.inputs import checked_attempts

CENTRES, SCALES = (
    {"is_lying": 0.0, "width_m": 0.075, "room_m": 0.04},
    {"is_lying": 1.0, "width_m": 0.02, "room_m": 0.03},
)
"""Facts enter as (fact − centre) / scale: a standing cup 7.5 cm wide with 4 cm of room has offset 0."""
NAMES = ("log_odds", "occlusion", *FACTS, "log_offset_std")
"""Of the parameters, in their order."""
_PRIOR_MEAN = np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.log(0.5)])
_PRIOR_STD = np.array([5.0, 5.0, 5.0, 2.0, 2.0, 1.0])
_NUM_NEWTON_STEPS = 4
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(15)


@dataclass(frozen=True)
class GraspFit:
    """What attempts tell of P(held).

    Parameters
    ----------
    estimate
        Of `NAMES`.
    covariance
        Of the estimates, robust, tables being clusters.
    num_decided, num_cut
        Attempts.
    effective_sample_size
        Of the weights.
    """

    estimate: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    num_decided: int
    num_cut: int
    effective_sample_size: float

    @property
    def standard_error(self) -> Float[np.ndarray, " p"]:
        """Of each estimate."""
        return np.sqrt(np.diag(self.covariance))


def design(trials: pd.DataFrame) -> Float[np.ndarray, "n k"]:
    """Give the covariates of attempts: 1, the occlusion, and the facts as `CENTRES` and `SCALES` have them.

    Parameters
    ----------
    trials
        With occlusion and `FACTS`.
    """
    facts = [(trials[name].to_numpy(dtype=np.float64) - CENTRES[name]) / SCALES[name] for name in FACTS]
    return np.column_stack([np.ones(len(trials)), trials["occlusion"], *facts])


def fit_grasping(trials: pd.DataFrame, censoring: str = "kaplan-meier") -> GraspFit:
    """Fit the regression.

    Parameters
    ----------
    trials
        As `halfseen.cell.calibration.trials.trials` gives them.
    censoring
        As in `halfseen.tables.grasp.beta_grasp.BetaGrasp`.

    Raises
    ------
    ArgumentError
        A value is none that an attempt can have, or none was decided.
    PositivityError
        A weight is not identified.
    LogError
        No finite numbers fit them.
    """
    decided = checked_attempts(trials, censoring)
    kept = trials["is_finished"].to_numpy(dtype=bool)
    # Rows of one object follow one another's number; an integral is taken over each.
    objects = pd.factorize(decided.group)[0].astype(np.int64)
    clusters = pd.factorize(trials["path"][kept])[0].astype(np.int64)
    with jax.enable_x64(True):
        # Of mean 1: within the integral over an object's offset, attempts that weigh more would seem to be more.
        weight = decided.weight / decided.weight.mean()
        data = (design(trials)[kept], np.where(decided.succeeded, 1.0, -1.0), weight, objects)
        return _fitted(data, clusters, len(trials) - int(kept.sum()), decided.diagnostics.effective_sample_size)


def _fitted(data: tuple, clusters: Int[np.ndarray, " n"], num_cut: int, size: float) -> GraspFit:
    num_objects = int(data[3].max()) + 1
    of_object = np.zeros(num_objects, dtype=np.int64)
    of_object[data[3]] = clusters
    padded, num_padded = _padded(data, num_objects)

    def objective(theta: np.ndarray) -> tuple[np.ndarray, ...]:
        return tuple(map(np.asarray, _value_and_gradient(theta, padded, num_padded)))

    found = minimize(objective, _PRIOR_MEAN, jac=True)
    estimate = found.x
    for _ in range(_NUM_NEWTON_STEPS):
        # To the last digits, so that every machine finds the same.
        curvature, _ = _curvature_and_scores(estimate, padded, num_padded)
        estimate = estimate - np.linalg.solve(np.asarray(curvature), objective(estimate)[1])
    curvature, scores = _curvature_and_scores(estimate, padded, num_padded)
    bread = np.linalg.inv(np.asarray(curvature))
    by_table = np.zeros((int(clusters.max()) + 1, len(estimate)))
    np.add.at(by_table, of_object, np.asarray(scores)[:num_objects])
    covariance = bread @ (by_table.T @ by_table) @ bread
    if not (np.isfinite(estimate).all() and np.isfinite(covariance).all()):
        raise LogError("no finite numbers fit these attempts; look for facts of objects that are out of all proportion")
    return GraspFit(estimate, covariance, len(clusters), num_cut, size)


def _padded(data: tuple, num_objects: int) -> tuple[tuple, int]:
    """Rows and objects up to a power of two, so that fits of similar size are compiled once; rows added weigh 0."""
    num_rows, num_padded = (1 << int(num).bit_length() for num in (len(data[0]), num_objects))
    missing = num_rows - len(data[0])
    covariates, *rest = (np.pad(each, [(0, missing), *[(0, 0)] * (each.ndim - 1)]) for each in data)
    return (covariates, *rest), num_padded


def _negative(theta: Array, data: tuple, num_objects: int) -> Array:
    shift = (theta - _PRIOR_MEAN) / _PRIOR_STD
    return 0.5 * jnp.sum(shift**2) - jnp.sum(_log_likelihoods(theta, data, num_objects))


@partial(jax.jit, static_argnums=2)
def _value_and_gradient(theta: Array, data: tuple, num_objects: int) -> tuple[Array, Array]:
    return jax.value_and_grad(_negative)(theta, data, num_objects)


@partial(jax.jit, static_argnums=2)
def _curvature_and_scores(theta: Array, data: tuple, num_objects: int) -> tuple[Array, Array]:
    curvature = jax.hessian(_negative)(theta, data, num_objects)
    return curvature, jax.jacfwd(_log_likelihoods)(theta, data, num_objects)


def _log_likelihoods(theta: Array, data: tuple, num_objects: int) -> Float[Array, " objects"]:
    """Of each object: its offset integrated out."""
    covariates, sign, weight, objects = data
    logits = (covariates @ theta[:-1])[:, None] + jnp.exp(theta[-1]) * _NODES
    each = weight[:, None] * jax.nn.log_sigmoid(sign[:, None] * logits)
    of_object = jax.ops.segment_sum(each, objects, num_segments=num_objects)
    return jax.scipy.special.logsumexp(of_object + np.log(_WEIGHTS / _WEIGHTS.sum()), axis=1)
