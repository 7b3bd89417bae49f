"""A fair sample of a log's paths, which decides on all that is no sum over rows.

Eq. 3 itself runs on sums, to which every path adds. But landmarks of a kernel, durations of stages, the behaviour
policy, the grasp model of a table and the choice of stages are fitted by methods that hold what they look at. Of a log
of many paths, so many of them tell these as well as all would, in memory and in passes alike.
"""

import numpy as np
from jaxtyping import Int

MOST_PATHS = 2_000
"""Paths of the sample; of a log that has no more, it is the log."""


def sampled(num_paths: int, seed: int, most: int | None = None) -> Int[np.ndarray, " k"]:
    """Draw rows of paths, increasing and without replacement.

    Parameters
    ----------
    num_paths
        n.
    seed
        Of the draw.
    most
        Paths to draw, if there are as many; None for `MOST_PATHS`.

    Examples
    --------
    >>> sampled(3, seed=0)
    array([0, 1, 2])
    """
    size = MOST_PATHS if most is None else most
    if num_paths <= size:
        return np.arange(num_paths)
    return np.sort(np.random.default_rng([seed, 4]).choice(num_paths, size, replace=False))
