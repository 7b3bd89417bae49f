"""Attempts as the experiment keeps them: plain numbers, and the regression that was fitted to all of them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from halfseen.cell.calibration.attempts import FACTS, trials
from halfseen.cell.calibration.calibrate import HORIZON
from halfseen.cell.calibration.grasping import GraspFit, fit_grasping
from halfseen.logs import read_logs

COLUMNS = (
    "trajectory",
    "stage",
    "object",
    "occlusion",
    "successes",
    "failures",
    "succeeded",
    "time_s",
    "is_finished",
    *FACTS,
)
Source = Mapping[str, Any]
"""Attempts of one planner of grasps, and the regression."""


def read_attempts(folder: Path) -> pd.DataFrame:
    """Read the attempts of a log that a law was estimated from."""
    return trials(read_logs(folder), HORIZON)


def source_of(tried: pd.DataFrame) -> Source:
    """Keep attempts, and the regression that is fitted to them."""
    fit = fit_grasping(tried)
    return {
        "tried": {name: _plain(pd.Series(tried[name])) for name in COLUMNS},
        "estimate": fit.estimate.tolist(),
        "covariance": fit.covariance.tolist(),
        "effective_sample_size": fit.effective_sample_size,
    }


def frame_of(source: Source) -> pd.DataFrame:
    """Give the attempts, one row each."""
    tried = pd.DataFrame(source["tried"])
    return tried.assign(succeeded=tried["succeeded"].astype("boolean"))


def fit_of(source: Source) -> GraspFit:
    """Give the regression."""
    num_decided = int(np.sum(source["tried"]["is_finished"]))
    num_cut = len(source["tried"]["is_finished"]) - num_decided
    estimate, covariance = (np.array(source[name], dtype=np.float64) for name in ("estimate", "covariance"))
    return GraspFit(estimate, covariance, num_decided, num_cut, source["effective_sample_size"])


def _plain(column: pd.Series) -> list[Any]:
    return [None if pd.isna(value) else value for value in column.tolist()]
