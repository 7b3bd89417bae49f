"""How far a depth camera errs, as a function of distance."""

import numpy as np
from jaxtyping import Float

# Structured light and stereo measure disparity: the error grows with the square of the distance. Coefficients of
# Khoshelham and Oude Elberink (2012) for a Kinect, rounded up for edges and dark surfaces [m] and [1/m].
NOISE_AT_ONE_METRE_M = 0.003
SMALLEST_NOISE_M = 0.001


def depth_noise_m(depth_m: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return the standard deviation of a depth [m].

    Parameters
    ----------
    depth_m
        Distance along the optical axis [m].
    """
    return np.maximum(SMALLEST_NOISE_M, NOISE_AT_ONE_METRE_M * np.square(depth_m))
