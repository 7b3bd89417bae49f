"""Sampling of trajectories, and their weights by recency.

*Sample.* Eq. 3 itself runs on sums over all trajectories. But the landmarks of a kernel, the durations of stages, the
behaviour policy, the grasp model of a table and the choice of stage mode need methods that hold their data in memory. A
sample of a long log determines these as well as the whole log would, in memory and in passes alike.

*Recency.* With n trajectories in the order of their names and a half-life h, the i-th has the weight

    w_i = 2^{−(n−i)/h},   scaled to mean 1,

in eq. 3, multiplied by its weight for cuts. So λ acts as on a log that contains each trajectory w_i times.
"""

import numpy as np

from halfseen.logs import Logs
from halfseen.shapes import Float, Int

MOST_TRAJECTORIES = 2_000
"""Size of the sample; a smaller log is used whole."""

FEWEST_TRAJECTORIES = 100
"""Fewest trajectories for choosing a half-life, and for evaluating a policy on recent ones."""


def sampled(num_trajectories: int, seed: int, most: int | None = None) -> Int[np.ndarray, " k"]:
    """Draw rows of trajectories, increasing and without replacement.

    Parameters
    ----------
    num_trajectories
        n.
    seed
        Seed of the draw.
    most
        Size of the sample, if there are as many; None for `MOST_TRAJECTORIES`.

    Examples
    --------
    >>> sampled(3, seed=0)
    array([0, 1, 2])
    """
    size = MOST_TRAJECTORIES if most is None else most
    if num_trajectories <= size:
        return np.arange(num_trajectories)
    return np.sort(np.random.default_rng([seed, 4]).choice(num_trajectories, size, replace=False))


def recency_weights(num_trajectories: int, half_life: float | int) -> Float[np.ndarray, " n"]:
    """Weight of each trajectory of a log, with mean 1; the last has the largest.

    Examples
    --------
    >>> recency_weights(2, 1) * 3
    array([2., 4.])
    """
    weights = np.exp2(-np.arange(num_trajectories)[::-1] / half_life)
    return weights / weights.mean()


def latest(logs: Logs, half_life: float | str | None, num_trajectories: int) -> Logs:
    """Keep trajectories with at least half the weight of the last one, but at least 100; all without a half-life.

    `logs` is a log of `num_trajectories`, or a sample of it.
    """
    if not isinstance(half_life, float):
        return logs
    num = max(int(half_life * logs.num_trajectories / num_trajectories), FEWEST_TRAJECTORIES)
    return logs if num >= logs.num_trajectories else logs.select(logs.trajectory_ids[-num:])
