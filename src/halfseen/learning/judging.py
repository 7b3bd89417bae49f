"""What fitted Qs say of every stage of a log: its value, that of the action taken, and the target of eq. 3."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from halfseen.learning.transitions import (
    QFunctions,
    StageMode,
    Transitions,
    imputed_target,
    of_successor,
    q_values,
    target_of,
    values_of,
)


class Judged(NamedTuple):
    """What a Q says of every stage of a log, for one weighting or for each of B."""

    value: Float[np.ndarray, "*B n T"]
    """V̂_t(S_t)."""
    taken: Float[np.ndarray, "*B n T"]
    """Q̂_t(S_t, A_t)."""
    target: Float[np.ndarray, "*B n T"]
    """X_t = R_t + V̂_{t+1}(S_{t+1}), or Y_t where targets are imputed; 0 where there is none."""


def judged(
    fits: QFunctions,
    log: Transitions,
    block_of_action: Int[np.ndarray, " A"],
    stages: StageMode,
    reward: Float[np.ndarray, "n T"],
) -> Judged:
    """Let each stage's own Q judge it.

    Parameters
    ----------
    fits
        What was fitted to the log, or to another weighting of it.
    log
        The log.
    block_of_action, stages
        As for the fit.
    reward
        As logged; those of `log` may have had noise taken out of them.
    """
    in_order = slice(None, None, -1 if stages == "pooled" else 1)
    each = zip(fits.coefficients[in_order], np.moveaxis(log.features, 1, 0), strict=True)
    q = np.stack([q_values(of_stage, features, block_of_action) for of_stage, features in each], axis=1)
    value = values_of(q, log)
    taken = np.take_along_axis(q, log.action[..., None], axis=2)[..., 0]
    target = target_of(log._replace(reward=reward), of_successor(value))
    if fits.outcome is not None:
        target = imputed_target(log, fits.outcome[in_order], target, block_of_action)
    return Judged(value, taken, target)
