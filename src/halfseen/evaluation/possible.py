"""What a trajectory can earn at all, by the rewards that a log saw.

Backwards over stages, with R_t over completed stages,

    M_t = max(max R_t of those after which a trajectory had ended, M_{t+1} + max R_t of the others),   M_{T+1} = 0,

and the least alike. No mean of trajectories lies outside, whatever the policy, unless it earns what no stage was seen
to. So an estimate that does is moved to the nearer end, and no interval reaches beyond.
"""

from typing import NamedTuple

import numpy as np

from halfseen.learning.rows import TrajectoryArrays
from halfseen.shapes import Float


class Possible(NamedTuple):
    """The least and the most that rewards can add up to."""

    low: float
    high: float

    def moved_within(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Values with their mean moved to the nearer end where it lies outside."""
        mean = float(values.mean())
        within = min(max(mean, self.low), self.high)
        return values if within == mean else values + (within - mean)


def possible(trajectories: TrajectoryArrays) -> Possible:
    """Add up the rewards that were seen."""
    return Possible(-_most(-trajectories.reward, trajectories), _most(trajectories.reward, trajectories))


def _most(reward: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays) -> float:
    """M_1; a stage that no trajectory was seen to complete brings nothing."""
    later = 0.0
    for t in reversed(range(reward.shape[1])):
        ends, goes_on = trajectories.is_last[:, t], trajectories.is_completed[:, t] & ~trajectories.is_last[:, t]
        each = [after + reward[rows, t].max() for rows, after in ((ends, 0.0), (goes_on, later)) if rows.any()]
        later = max(each, default=later)
    return float(later)
