"""Later trajectories count more: weights that halve every so many trajectories.

With n trajectories in the order of their names and a half-life h, the i-th of eq. 3 counts

    w_i = 2^{−(n−i)/h},   scaled to mean 1,

beside its weight for cuts. So λ weighs as much as on a log in which each trajectory were there w_i times.
"""

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.logs import Logs
from halfseen.shapes import Float

FEWEST_TRAJECTORIES = 100
"""Below which no half-life is chosen, and by which a policy is judged at least."""


def half_life_of(value: float | int | str | None) -> float | str | None:
    """Check a half-life [trajectories].

    Raises
    ------
    ArgumentError
        It is neither above 0, ``"auto"`` nor None.
    """
    if value is None or value == "auto":
        return value
    if isinstance(value, str | bool) or not 0 < value < np.inf:
        raise ArgumentError(f"half_life is {value!r}; it is a number of trajectories above 0, 'auto' or None")
    return float(value)


def recency_weights(num_trajectories: int, half_life: float | int) -> Float[np.ndarray, " n"]:
    """What each trajectory of a log counts, with mean 1; the last one most.

    Parameters
    ----------
    num_trajectories
        n.
    half_life
        Trajectories by which the weight halves.

    Examples
    --------
    >>> recency_weights(2, 1) * 3
    array([2., 4.])
    """
    weights = np.exp2(-np.arange(num_trajectories)[::-1] / half_life)
    return weights / weights.mean()


def latest(logs: Logs, half_life: float | str | None, num_trajectories: int) -> Logs:
    """Keep the trajectories that count half of the last one, or more, but at least 100; all without a half-life.

    Parameters
    ----------
    logs
        A log, or trajectories drawn from it.
    half_life
        Of the log.
    num_trajectories
        Of the log.
    """
    if not isinstance(half_life, float):
        return logs
    num = max(int(half_life * logs.num_trajectories / num_trajectories), FEWEST_TRAJECTORIES)
    return logs if num >= logs.num_trajectories else logs.select(logs.trajectory_ids[-num:])
