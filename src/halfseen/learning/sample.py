"""Which trajectories of a log are looked at, and how much each counts.

*Sample.* Eq. 3 itself runs on sums, to which every trajectory adds. But landmarks of a kernel, durations of stages, the
behaviour policy, the grasp model of a table and the choice of stages are fitted by methods that hold what they look at.
Of a log of many trajectories, so many of them tell these as well as all would, in memory and in passes alike.

*Recency.* With n trajectories in the order of their names and a half-life h, the i-th of eq. 3 counts

    w_i = 2^{−(n−i)/h},   scaled to mean 1,

beside its weight for cuts. So λ weighs as much as on a log in which each trajectory were there w_i times.
"""

import numpy as np

from halfseen.logs import Logs
from halfseen.shapes import Float, Int

MOST_TRAJECTORIES = 2_000
"""Trajectories of the sample; of a log that has no more, it is the log."""

FEWEST_TRAJECTORIES = 100
"""Below which no half-life is chosen, and by which a policy is judged at least."""


def sampled(num_trajectories: int, seed: int, most: int | None = None) -> Int[np.ndarray, " k"]:
    """Draw rows of trajectories, increasing and without replacement.

    Parameters
    ----------
    num_trajectories
        n.
    seed
        Of the draw.
    most
        Trajectories to draw, if there are as many; None for `MOST_TRAJECTORIES`.

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
    """What each trajectory of a log counts, with mean 1; the last one most.

    Examples
    --------
    >>> recency_weights(2, 1) * 3
    array([2., 4.])
    """
    weights = np.exp2(-np.arange(num_trajectories)[::-1] / half_life)
    return weights / weights.mean()


def latest(logs: Logs, half_life: float | str | None, num_trajectories: int) -> Logs:
    """Keep the trajectories that count half of the last one, or more, but at least 100; all without a half-life.

    They are a log of so many, or were drawn from it.
    """
    if not isinstance(half_life, float):
        return logs
    num = max(int(half_life * logs.num_trajectories / num_trajectories), FEWEST_TRAJECTORIES)
    return logs if num >= logs.num_trajectories else logs.select(logs.trajectory_ids[-num:])
