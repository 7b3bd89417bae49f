"""The worlds of the examples, whose policies have exact values: `pick_cell`, `bin_cell` and `clinical_trial`."""

import sys
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from worlds.world import is_possible

from halfseen.logs import Logs

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
sys.path += [str(EXAMPLES / name) for name in ("pick_cell", "bin_cell", "clinical_trial")]

import bin_cell  # noqa: E402
import cell_optimum  # noqa: E402
import cell_parts  # noqa: E402
import cell_trajectories  # noqa: E402
import trial_optimum  # noqa: E402
import trial_patients  # noqa: E402

Bin = bin_cell.Bin


class Cell:
    actions = cell_parts.ACTIONS_ALL
    actions_by_stage = cell_parts.ACTIONS
    covariates = tuple(cell_parts.COVARIATES)
    half = ("weight_kg", float(np.mean(cell_parts.WEIGHTS_KG)))
    logging = staticmethod(cell_trajectories.logging_chances)
    value = staticmethod(cell_optimum.chances_value)

    @property
    def optimum(self) -> float:
        return self._solved[0]

    def log(self, num_trajectories: int, seed: int, share: float) -> Logs:
        return cell_trajectories.simulate(
            num_trajectories, seed, share > 0, cell_rate(share) if share else cell_parts.RATE
        )

    def plain(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        return np.eye(len(self.actions))[cell_trajectories.rule_of_thumb(frame, stage)]

    def best(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        axes = zip(cell_optimum.AXES, self.covariates, strict=True)
        at = [np.rint((frame[name].to_numpy() - a[0]) / (a[1] - a[0])).astype(int) for a, name in axes]
        return np.eye(len(self.actions))[self._solved[1][stage - 1].argmax(axis=-1)[tuple(at)]]

    @cached_property
    def _solved(self) -> Any:
        return cell_optimum.optimum()


@cache
def cell_rate(share: float) -> float:
    """Level of the cell's hazards that cuts this share of the trajectories of one long log."""

    def excess(log_rate: float) -> float:
        return cell_trajectories.simulate(5000, 0, rate=np.exp(log_rate)).cut_share - share

    root: Any = brentq(excess, -9.0, -2.0, xtol=1e-2)
    return float(np.exp(root))


class Trial:
    actions = trial_patients.TREATMENTS
    actions_by_stage = trial_patients.ACTIONS
    covariates = tuple(trial_patients.COVARIATES)
    half = ("wellness", 0.5)
    value = staticmethod(trial_optimum.chances_value)

    @property
    def optimum(self) -> float:
        return self._solved[0]

    def log(self, num_trajectories: int, seed: int, share: float) -> Logs:
        return trial_patients.trial(num_trajectories, share, seed)

    def logging(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        """Treat at random."""
        possible = is_possible(self, stage)
        return np.tile(possible / possible.sum(), (len(frame), 1))

    def plain(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        """Treat aggressively where the tumour is large and the patient well."""
        is_aggressive = (frame["tumour"] + frame["wellness"] > 1.0).to_numpy()
        return np.eye(len(self.actions))[np.where(is_aggressive, 0, 1)]

    def best(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        last = len(trial_optimum.GRID) - 1
        at = [np.rint(frame[name].to_numpy() * last).astype(int) for name in self.covariates]
        return np.eye(len(self.actions))[self._solved[1][stage - 1].argmax(axis=-1)[tuple(at)]]

    @cached_property
    def _solved(self) -> Any:
        return trial_optimum.optimum()
