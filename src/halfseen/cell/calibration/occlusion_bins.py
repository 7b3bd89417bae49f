"""Bins of occlusion in which attempts are counted."""

import numpy as np

from halfseen.arrays import Rows
from halfseen.shapes import Float, Int

OCCLUSION_EDGES: Float[np.ndarray, " edges"] = np.array([0.0, 0.01, 0.2, 0.4, 0.6, 1.0])
"""Ends of the bins; in the first nothing is hidden, as far as one can see."""


def occlusion_bins(occlusion: Rows) -> Int[np.ndarray, " n"]:
    """Give the number of the bin of each attempt; its lower end belongs to a bin.

    Parameters
    ----------
    occlusion
        Hidden shares in [0, 1].
    """
    return np.searchsorted(OCCLUSION_EDGES[1:-1], occlusion, side="right").astype(np.int64)
