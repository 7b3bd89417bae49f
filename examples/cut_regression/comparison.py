"""Repetitions: each draws a sample, fits every method to it, and measures how far from the true median each is."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from cut_regression.methods import CONSTANT, METHODS, fitted
from cut_regression.settings import TAU, Sample, Setting

GRID = np.linspace(0.0, 1.0, 101)
NUM_TEST_ROWS = 500


@dataclass(frozen=True)
class Comparison:
    """What was found.

    Attributes
    ----------
    errors
        A row for each ``setting``, ``num_rows``, ``repetition`` and ``method`` (or `CONSTANT`): ``error_s``, the mean
        of |estimate − m(z)| over the z asked about [s]; ``share_at_tau``, the share of these z where the estimate is
        τ itself; and ``cut_share``, measured in the sample.
    curves
        (setting, method) → mean estimate over the repetitions at `GRID` [s], from samples of the largest size; settings
        of one covariate only.
    samples
        Setting → the first of the samples of the largest size.
    """

    errors: pd.DataFrame
    curves: dict[tuple[Setting, str], Float[np.ndarray, " g"]]
    samples: dict[Setting, Sample]

    @property
    def sizes(self) -> list[int]:
        """Rows of the samples, increasing."""
        return sorted(self.errors["num_rows"].unique().tolist())

    @property
    def settings(self) -> list[Setting]:
        """The settings compared."""
        return list(self.samples)

    @property
    def num_repetitions(self) -> int:
        """Samples of each size and setting."""
        return int(self.errors["repetition"].nunique())

    def errors_of(self, setting: Setting, num_rows: int, method: str) -> Float[np.ndarray, " R"]:
        """Error in each repetition [s], in their order."""
        frame = self.errors
        wanted = (frame["setting"] == setting) & (frame["num_rows"] == num_rows) & (frame["method"] == method)
        return frame.loc[wanted, "error_s"].to_numpy()


def compare(
    settings: Sequence[Setting], sizes: Sequence[int], num_repetitions: int, seed: int, reg: float | str
) -> Comparison:
    """Compare all methods in all settings.

    Parameters
    ----------
    settings
        What is simulated.
    sizes
        Rows of a sample.
    num_repetitions
        Samples of each size and setting.
    seed
        Repetition r draws from the seeds (`seed`, r, rows), whatever else is asked for.
    reg
        λ of all SVMs, or ``"cv"``.
    """
    tasks = [(setting, size, r) for r in range(num_repetitions) for setting in settings for size in sizes]
    bar = tqdm(tasks, desc="samples", delay=2, disable=None, leave=False)
    # The matrices are small: more threads than one wait for one another.
    with threadpool_limits(1):
        results = [_repetition(setting, size, _rng(seed, r, size), reg) for setting, size, r in bar]
    rows = [
        {"setting": setting, "num_rows": size, "repetition": r, **row}
        for (setting, size, r), (found, _) in zip(tasks, results, strict=True)
        for row in found
    ]
    largest = max(sizes)
    curves = {}
    for setting in (setting for setting in settings if setting.num_covariates == 1):
        estimates = [e for task, (_, e) in zip(tasks, results, strict=True) if task[:2] == (setting, largest)]
        curves |= {(setting, method): np.mean([e[method] for e in estimates], axis=0) for method in METHODS}
    samples = {setting: setting.sample(largest, _rng(seed, 0, largest)) for setting in settings}
    return Comparison(pd.DataFrame(rows), curves, samples)


def _repetition(
    setting: Setting, num_rows: int, rng: np.random.Generator, reg: float | str
) -> tuple[list[dict[str, Any]], dict[str, Float[np.ndarray, " m"]]]:
    """Errors of all methods on one sample, and their estimates at the z asked about."""
    sample = setting.sample(num_rows, rng)
    asked = GRID[:, None] if setting.num_covariates == 1 else rng.uniform(size=(NUM_TEST_ROWS, setting.num_covariates))
    estimates = {method: fitted(method, sample, setting, reg)(asked) for method in METHODS}
    estimates[CONSTANT] = np.full(len(asked), setting.best_constant)
    errors = [
        {
            "method": method,
            "error_s": float(np.abs(estimate - setting.medians(asked)).mean()),
            "share_at_tau": float((estimate == TAU).mean()),
            "cut_share": sample.cut_share,
        }
        for method, estimate in estimates.items()
    ]
    return errors, estimates


def _rng(seed: int, repetition: int, num_rows: int) -> np.random.Generator:
    return np.random.default_rng([seed, repetition, num_rows])
