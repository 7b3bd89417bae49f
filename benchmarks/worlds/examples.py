"""The worlds of the examples, whose policies have exact values: `examples/pick_cell` and `examples/clinical_trial`.

The cell's cuts are as its hazards make them, whatever share is asked for; patients of the trial are treated at random.
"""

import sys
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
from worlds.world import Chances, is_possible

from halfseen.logs import Logs

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
sys.path += [str(EXAMPLES / "pick_cell"), str(EXAMPLES / "clinical_trial")]

import cell_optimum  # noqa: E402
import cell_parts  # noqa: E402
import cell_paths  # noqa: E402
import trial_optimum  # noqa: E402
import trial_patients  # noqa: E402


class Cell:
    actions = cell_parts.ACTIONS_ALL
    actions_by_stage = cell_parts.ACTIONS
    covariates = tuple(cell_parts.COVARIATES)

    @cached_property
    def optimum(self) -> float:
        return cell_optimum.optimum()[0]

    def log(self, num_paths: int, seed: int, share: float) -> Logs:
        return cell_paths.simulate(num_paths, seed, share > 0)

    def value(self, chances: Chances) -> float:
        return cell_optimum.policy_value(lambda frame, stage: chances(frame, stage).argmax(axis=1))

    def plain(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        return np.eye(len(self.actions))[cell_paths.rule_of_thumb(frame, stage)]


class Trial:
    actions = trial_patients.TREATMENTS
    actions_by_stage = trial_patients.ACTIONS
    covariates = tuple(trial_patients.COVARIATES)

    @cached_property
    def optimum(self) -> float:
        return trial_optimum.optimum()[0]

    def log(self, num_paths: int, seed: int, share: float) -> Logs:
        return trial_patients.trial(num_paths, share, seed)

    def value(self, chances: Chances) -> float:
        """Of a policy that is certain, or of treatment at random."""
        chance = chances(trial_optimum.STATES.head(1), 1)
        if chance.max() < 1.0:
            return trial_optimum.random_value()
        return trial_optimum.policy_value(lambda frame, stage: chances(frame, stage).argmax(axis=1))

    def plain(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        possible = is_possible(self, stage)
        return np.tile(possible / possible.sum(), (len(frame), 1))
