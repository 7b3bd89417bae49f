"""P(the next attempt at an object holds), given what came of those before: the regression as a predictor.

The offset of an object is never seen, but its past attempts j tell of it. With φ the standard normal density,

    P(held | x, past) = ∫ expit(x·β + σz) Π_j expit(±(x_j·β + σz)) φ(z) dz / ∫ Π_j expit(±(x_j·β + σz)) φ(z) dz,

both integrals by Gauss–Hermite quadrature at the same nodes.
"""

import numpy as np
import pandas as pd
from scipy.special import expit, log_expit, softmax

from halfseen.cell.calibration.grasp_fit import design
from halfseen.shapes import Float

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(41)
# More nodes than the fit has: at a few of them alone is what an object with many attempts has left of its offset.


def held_given_past(theta: Float[np.ndarray, " p"], trials: pd.DataFrame) -> Float[np.ndarray, " n"]:
    """Predict each attempt from those before it at the same object.

    Parameters
    ----------
    theta
        Estimates of `halfseen.cell.calibration.grasp_fit.NAMES`.
    trials
        As `halfseen.cell.calibration.trials.trials` gives them, with all past attempts at each object. What became of
        an attempt is read for later ones alone; one that was cut tells them nothing.
    """
    logits = (design(trials) @ theta[:-1])[:, None] + np.exp(theta[-1]) * _NODES
    is_decided = trials["succeeded"].notna().to_numpy()
    is_held = trials["succeeded"].isin([True]).to_numpy()
    sign = np.where(is_held, 1.0, -1.0)[:, None]
    told = pd.DataFrame(np.where(is_decided[:, None], log_expit(sign * logits), 0.0))
    order = np.argsort(trials["stage"].to_numpy(), kind="stable")
    in_turn = told.iloc[order]
    objects = trials["object"].to_numpy()[order]
    before = (in_turn.groupby(objects).cumsum() - in_turn).sort_index().to_numpy()
    return np.sum(softmax(before + np.log(_WEIGHTS), axis=1) * expit(logits), axis=1)


def held_share(theta: Float[np.ndarray, " p"], covariates: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " n"]:
    """P(held) at the first attempt: the offset integrated out.

    Parameters
    ----------
    theta
        As in `held_given_past`.
    covariates
        As `halfseen.cell.calibration.grasp_fit.design` gives them.
    """
    logits = (covariates @ theta[:-1])[:, None] + np.exp(theta[-1]) * _NODES
    return expit(logits) @ (_WEIGHTS / _WEIGHTS.sum())
