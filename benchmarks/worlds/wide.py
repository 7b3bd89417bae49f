"""Twenty covariates of which three matter, nearly linearly; cuts by two of these and by two of the others."""

from typing import Any

import numpy as np
import pandas as pd
from worlds.staged import Staged

SLOPES = np.array([[1.2, 0.6, 0.0], [-1.0, 0.0, 0.8], [0.2, -0.8, -0.8]])
"""Of each action, on what matters."""


class Wide(Staged):
    covariates = tuple(f"x{k}" for k in range(1, 21))
    half = ("x1", 0.5)
    step = np.array([-0.15, 0.15, 0.05])
    late_pay = 0.05

    def pays(self, x: np.ndarray, action: Any) -> np.ndarray:
        score = np.einsum("mk,mk->m", x[:, :3] - 0.5, np.broadcast_to(SLOPES[action], (len(x), 3)))
        return 0.6 + np.tanh(score)

    def ends(self, x: np.ndarray, action: Any) -> np.ndarray:
        return 0.1 + 0.2 * x[:, 1] + 0.0 * np.asarray(action)

    def lasts(self, x: np.ndarray, action: Any) -> np.ndarray:
        return np.choose(action, [2.0 + 2.0 * x[:, 0], 3.0 + x[:, 1], 4.0 - x[:, 0]])

    def hazard(self, x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return np.exp(1.5 * x[:, 0] - 1.0 * x[:, 1] + 1.0 * x[:, 3] + 0.5 * x[:, 4])

    def plain(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        return np.eye(3)[np.where(frame["x1"] > 0.5, 0, np.where(frame["x3"] > 0.5, 1, 2))]
