"""A Q that no polynomial is: thresholds, an interaction of three covariates, a bump; and cuts by what is not recorded.

Haze stops a trajectory; the log has the temperature, of which haze is a noisy function. Given the temperature, cuts
depend on nothing that rewards depend on, but their hazards are neither proportional nor log-linear in it.
"""

from typing import Any

import numpy as np
import pandas as pd
from worlds.staged import Staged


class Haze(Staged):
    covariates = ("place", "temperature", "load")
    half = ("place", 0.35)
    step = np.array([0.2, -0.2, 0.05])
    late_pay = 0.1

    def pays(self, x: np.ndarray, action: Any) -> np.ndarray:
        place, temperature, load = x[:, 0], x[:, 1], x[:, 2]
        thresholds = 0.2 + 0.8 * (place > 0.5) * (load < 0.6)
        interaction = 0.5 + 2.0 * (2.0 * place - 1.0) * (2.0 * temperature - 1.0) * (2.0 * load - 1.0)
        bump = 0.3 + 0.9 * np.exp(-12.0 * ((place - 0.4) ** 2 + (load - 0.6) ** 2))
        return np.choose(action, [thresholds, interaction, bump])

    def ends(self, x: np.ndarray, action: Any) -> np.ndarray:
        return 0.1 + 0.3 * x[:, 2] * (np.asarray(action) == 1)

    def lasts(self, x: np.ndarray, action: Any) -> np.ndarray:
        return np.choose(action, [2.0 + 2.0 * x[:, 1], 3.0 + 0.0 * x[:, 0], 2.5 + 2.0 * x[:, 0] * x[:, 1]])

    def hazard(self, x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        haze = 2.0 * x[:, 1] - 1.0 + 0.7 * rng.normal(size=len(x))
        return 0.2 + np.maximum(haze, 0.0) ** 2

    def plain(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        place = frame["place"].to_numpy()
        return np.eye(3)[np.select([place > 0.6, place < 0.3], [0, 1], 2)]
