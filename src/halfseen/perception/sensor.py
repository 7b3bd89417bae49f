"""How far a depth camera errs."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from halfseen.shapes import Float


@runtime_checkable
class DepthSensor(Protocol):
    """What perception needs to know of a depth camera."""

    def noise_m(self, depth_m: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the standard deviation of a depth [m], positive.

        Parameters
        ----------
        depth_m
            Distance along the optical axis [m].
        """
        ...


@dataclass(frozen=True)
class DisparitySensor:
    """A depth camera whose error grows with the square of the distance, as structured light and stereo do.

    They measure disparity: an error of it becomes an error of depth that grows with depth².

    Parameters
    ----------
    noise_at_one_metre_m
        Standard deviation of a depth of 1 m [m].
    smallest_noise_m
        Standard deviation that no depth goes below, however near [m].
    """

    noise_at_one_metre_m: float
    smallest_noise_m: float

    def noise_m(self, depth_m: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the standard deviation of a depth [m]."""
        return np.maximum(self.smallest_noise_m, self.noise_at_one_metre_m * np.square(depth_m))


XTION = DisparitySensor(noise_at_one_metre_m=0.003, smallest_noise_m=0.001)
"""The Asus Xtion and its kin, the first Kinect among them, whose coefficients [KhoshelhamOudeElberink2012]_ measured;
rounded up for edges and dark surfaces."""
