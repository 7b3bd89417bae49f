"""Whether success falls with occlusion, and for what lies: counted, by the regression, and under the assumed laws."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats
from scipy.special import expit, logit

from halfseen.cell.calibration.clustered_share import shares_by
from halfseen.cell.calibration.grasp_fit import NAMES, GraspFit
from halfseen.cell.calibration.held_given_past import held_share
from halfseen.cell.calibration.occlusion_bins import OCCLUSION_EDGES, occlusion_bins
from halfseen.shapes import Float
from halfseen.study.experiments.attempts.sources import Source, fit_of, frame_of
from halfseen.study.statistics import LEVEL
from halfseen.tables.grasp_attempts import checked_attempts
from halfseen.world.config import WorldConfig

ASSUMED = "assumed"
SHOWN: Float[np.ndarray, " shown"] = np.linspace(0.0, 0.8, 17)
"""Occlusions at which curves are told."""
_Z = float(stats.norm.ppf(0.5 + LEVEL / 2))
_STEP = 1e-5
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(41)


def counts_of(planner: str, source: Source) -> dict[str, Any]:
    """Say what was tried."""
    tried, fit = frame_of(source), fit_of(source)
    held = int(tried["succeeded"].sum())
    counts = {"tables": tried["trajectory"].nunique(), "decided": fit.num_decided, "cut": fit.num_cut, "held": held}
    return {"planner": planner} | counts


def held_by_occlusion(planner: str, tried: pd.DataFrame) -> list[dict[str, Any]]:
    """Count what held, by occlusion, of objects that stand and that lie; attempts weigh 1/Ĝ."""
    decided = checked_attempts(tried)
    met = tried.iloc[decided.row]
    is_lying, lines = met["is_lying"].to_numpy(dtype=bool), []
    occlusion, tables = met["occlusion"].to_numpy(), met["trajectory"].to_numpy()
    for lies in (False, True):
        rows = is_lying == lies
        groups, nothing = occlusion_bins(occlusion[rows]), np.zeros(int(rows.sum()))
        found = shares_by(groups, decided.succeeded[rows], nothing, decided.weight[rows], tables[rows])
        for k, share in found.items():
            place = {"planner": planner, "is_lying": lies, "bin_from": OCCLUSION_EDGES[k]}
            place |= {"bin_to": OCCLUSION_EDGES[k + 1], "occlusion": float(occlusion[rows][groups == k].mean())}
            place |= {"attempts": share.num_attempts, "tables": share.num_tables}
            lines.append(place | {"share_held": share.held, "low": share.low, "high": share.high})
    return lines


def law_rows(planner: str, source: Source) -> list[dict[str, Any]]:
    """Estimates of the regression, with 95 % intervals by the normal law, robust to tables."""
    fit = fit_of(source)
    return [
        {"planner": planner, "parameter": name, "estimate": value, "se": error}
        | {"low": value - _Z * error, "high": value + _Z * error}
        | {"p_value": float(2.0 * stats.norm.sf(abs(value) / error))}
        for name, value, error in zip(NAMES, fit.estimate.tolist(), fit.standard_error.tolist(), strict=True)
    ]


def slope_rows(sources: Mapping[str, Source]) -> pd.DataFrame:
    """P(held) by occlusion at the first attempt at a usual object: by each regression, and under the assumed laws."""
    lines = []
    for name, source in sources.items():
        for lies in (False, True):
            lines += [{"law": name, "is_lying": lies} | row for row in _curve(fit_of(source), lies)]
    for occlusion, share in zip(SHOWN.tolist(), assumed_share(SHOWN).tolist(), strict=True):
        lines.append({"law": ASSUMED, "is_lying": False, "occlusion": occlusion, "share_held": share})
    return pd.DataFrame(lines)


def assumed_share(occlusion: Float[np.ndarray, " shown"]) -> Float[np.ndarray, " shown"]:
    """P(held) under the assumed laws, the offset of an object integrated out."""
    law: Any = WorldConfig().grasping
    log_failure = law.log_failure(occlusion[:, None], float(law.offset_std) * _NODES)
    return (1.0 - np.exp(np.asarray(log_failure, dtype=np.float64))) @ (_WEIGHTS / _WEIGHTS.sum())


def _curve(fit: GraspFit, lies: bool) -> list[dict[str, float]]:
    """By the delta method on the logit scale."""
    covariates = np.zeros((len(SHOWN), len(NAMES) - 1))
    covariates[:, 0], covariates[:, 1], covariates[:, NAMES.index("is_lying")] = 1.0, SHOWN, float(lies)

    def log_odds(theta: Float[np.ndarray, " p"]) -> Float[np.ndarray, " shown"]:
        return logit(held_share(theta, covariates))

    steps = _STEP * np.eye(len(NAMES))
    gradient = [(log_odds(fit.estimate + step) - log_odds(fit.estimate - step)) / (2.0 * _STEP) for step in steps]
    error = np.sqrt(np.einsum("ps,pq,qs->s", gradient, fit.covariance, gradient))
    middle = log_odds(fit.estimate)
    ends = (expit(middle + side * _Z * error) for side in (0.0, -1.0, 1.0))
    named = zip(SHOWN.tolist(), *(end.tolist() for end in ends), strict=True)
    return [dict(zip(("occlusion", "share_held", "low", "high"), row, strict=True)) for row in named]
