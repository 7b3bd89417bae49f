"""How long attempts take until it is known whether they hold: lognormal, for those that hold and those that miss."""

from typing import NamedTuple

import numpy as np
import pandas as pd

from halfseen.tables.grasp_attempts import checked_attempts

FEWEST_MISSES = 5
"""With fewer, a miss is taken to last as long as an attempt that holds."""


class TimeFit(NamedTuple):
    """Numbers of the durations."""

    log_held_s: float
    """Mean logarithm of the duration of an attempt that holds [log s]."""
    log_missed_s: float
    """Likewise of one that misses [log s]."""
    log_std: float
    """Standard deviation of both."""
    rest_s: float
    """Mean time of what follows an attempt, until the next decision [s]."""


def fit_times(trials: pd.DataFrame, censoring: str = "kaplan-meier") -> TimeFit:
    """Fit the durations, each attempt weighted for those that were cut.

    Parameters
    ----------
    trials
        As `halfseen.cell.calibration.trials.trials` gives them; attempts that found nothing to try count for the rest
        alone.
    censoring
        As in `halfseen.tables.grasp_models.BetaGrasp`.
    """
    decided = checked_attempts(trials, censoring)
    rows = pd.DataFrame(trials[trials["is_finished"].to_numpy(dtype=bool)])
    attempt_s, watched_s = (rows[name].to_numpy(dtype=np.float64) for name in ("attempt_s", "time_s"))
    is_tried = attempt_s > 0.0
    weight, held = decided.weight[is_tried], decided.succeeded[is_tried]
    log_s = np.log(attempt_s[is_tried])
    means = [float(np.average(log_s[which], weights=weight[which])) for which in _groups(held)]
    spread = log_s - np.where(held, *means)
    rest_s = float(np.average(watched_s - attempt_s, weights=decided.weight))
    return TimeFit(means[0], means[1], float(np.sqrt(np.average(spread**2, weights=weight))), rest_s)


def _groups(held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    missed = ~held
    every = np.ones_like(held)
    return (held if held.any() else every), (missed if missed.sum() >= FEWEST_MISSES else every)
