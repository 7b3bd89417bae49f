"""What policies of the trial are worth: exactly, on a grid of wellness and tumour, backwards over the stages.

Of Q_t(w, m, a) = mean survival + (1 − chance of death) · E V_{t+1}(w', m'), the expectation is a sum over quantiles of
the noise; between grid points V is linear.
"""

from collections.abc import Callable, Sequence
from functools import cache
from itertools import product

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from scipy.stats import norm
from trial_patients import (
    ACTIONS,
    COVARIATES,
    HORIZON,
    NOISE,
    TREATMENTS,
    TUMOUR_STEP,
    WELLNESS_STEP,
    Decision,
    chance_of_death,
    mean_survival,
)

GRID = np.linspace(0.0, 1.0, 81)
WELLNESS, TUMOUR = np.meshgrid(GRID, GRID, indexing="ij")
STATES = pd.DataFrame({name: axis.ravel() for name, axis in zip(COVARIATES, (WELLNESS, TUMOUR), strict=True)})
NUM_QUANTILES = 200


def optimum() -> tuple[float, list[Float[np.ndarray, "G G A"]]]:
    """Find the largest expected survival [years], and Q of each stage on the grid; −inf where not offered."""
    value, q_of_stage = np.zeros(WELLNESS.shape), []
    for stage in range(HORIZON, 0, -1):
        q = _q_values(value)
        q[..., [treatment not in ACTIONS[stage] for treatment in TREATMENTS]] = -np.inf
        value = q.max(axis=-1)
        q_of_stage.insert(0, q)
    return _mean_over_entries(value), q_of_stage


def policy_value(decide: Decision) -> float:
    """Expected survival under a policy [years]."""
    chosen = [decide(STATES, stage).reshape(WELLNESS.shape) for stage in range(1, HORIZON + 1)]
    return _value(chosen)


def random_value() -> float:
    """Expected survival if treatment is randomised, as in the trial [years]."""
    offered = {stage: np.isin(TREATMENTS, names) / len(names) for stage, names in ACTIONS.items()}
    return chances_value(lambda patients, stage: np.tile(offered[stage], (len(patients), 1)))


def chances_value(chances: Callable[[pd.DataFrame, int], Float[np.ndarray, "m A"]]) -> float:
    """Expected survival under a policy that draws its treatments [years]."""
    value = np.zeros(WELLNESS.shape)
    for stage in range(HORIZON, 0, -1):
        each = chances(STATES, stage).reshape(*WELLNESS.shape, len(TREATMENTS))
        value = (each * _q_values(value)).sum(axis=-1)
    return _mean_over_entries(value)


def best_sequence() -> tuple[float, str]:
    """Find the best of all sequences of treatments that are fixed as a patient enters: its value [years], its name."""
    sequences = ["".join(names) for names in product(*ACTIONS.values())]
    everyone = np.ones(WELLNESS.shape, dtype=np.int64)
    return max((_value([TREATMENTS.index(name) * everyone for name in names]), names) for names in sequences)


def _value(chosen: Sequence[Int[np.ndarray, "G G"]]) -> float:
    value = np.zeros(WELLNESS.shape)
    for treatment in reversed(chosen):
        value = np.take_along_axis(_q_values(value), treatment[..., None], axis=-1)[..., 0]
    return _mean_over_entries(value)


def _q_values(value: Float[np.ndarray, "G G"]) -> Float[np.ndarray, "G G A"]:
    return np.stack([_q_of(value, treatment) for treatment in range(len(TREATMENTS))], axis=-1)


def _q_of(value: Float[np.ndarray, "G G"], treatment: int) -> Float[np.ndarray, "G G"]:
    later = _move(WELLNESS_STEP[treatment]) @ value @ _move(TUMOUR_STEP[treatment]).T
    alive = 1.0 - chance_of_death(WELLNESS, TUMOUR, treatment)
    return mean_survival(WELLNESS, TUMOUR, treatment) + alive * later


@cache
def _move(step: float) -> Float[np.ndarray, "G G"]:
    """Row g: the weights of V's grid points in E V(clip(g + step + noise))."""
    noise = NOISE * norm.ppf((np.arange(NUM_QUANTILES) + 0.5) / NUM_QUANTILES)
    after = np.clip(GRID[:, None] + step + noise, 0.0, 1.0) * (len(GRID) - 1)
    below = np.minimum(after.astype(np.int64), len(GRID) - 2)
    weights = np.zeros((len(GRID), len(GRID)))
    row = np.broadcast_to(np.arange(len(GRID))[:, None], below.shape)
    np.add.at(weights, (row, below), (below + 1 - after) / NUM_QUANTILES)
    np.add.at(weights, (row, below + 1), (after - below) / NUM_QUANTILES)
    return weights


def _mean_over_entries(value: Float[np.ndarray, "G G"]) -> float:
    """Mean over patients as they enter, uniform on the square, by the trapezoidal rule."""
    weight = np.ones(len(GRID))
    weight[[0, -1]] = 0.5
    weight /= weight.sum()
    return float(weight @ value @ weight)
