"""Features of an RKHS, so that a Q in it is linear in them: ψ(x)·ψ(z) = k(x, z) on the landmarks' span.

k is Gaussian on features that are scaled to unit variance. With as many landmarks as there are different rows this is
the whole RKHS that the data can use (the representer theorem); with fewer it is its low-rank form
[WilliamsSeeger2000]_. A *trend* adds the features themselves and all their products of two, so that k is the sum of two
kernels and Q that of a quadratic and of a smooth remainder.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from halfseen.arrays import library_of


class KernelMap(NamedTuple):
    """ψ(x) = (c · q(z), Rᵀ k(landmarks, z)) with z = (x − centre)/scale and q(z) all z_i and z_i z_j.

    Parameters
    ----------
    centre, scale
        Mean and standard deviation of each feature; a feature that never varied has an infinite scale.
    landmarks
        m rows, scaled.
    projection
        R.
    gamma
        γ of the Gaussian kernel exp(−γ‖x − z‖²), on scaled features.
    trend
        c, of each z_i and z_i z_j; None without the quadratic trend.
    """

    centre: Float[Any, " F"]
    scale: Float[Any, " F"]
    landmarks: Float[Any, "m F"]
    projection: Float[Any, "m r"]
    gamma: Float[Any, ""]
    trend: Float[Any, " Q"] | None = None

    @property
    def num_features(self) -> int:
        """Length of ψ(x)."""
        return (0 if self.trend is None else len(self.trend)) + self.projection.shape[1]

    def __call__(self, features: Float[Any, "*S F"]) -> Float[Any, "*S r"]:
        """Map features of states and actions, in the library of their array."""
        xp = library_of(features)
        scaled = (features - self.centre) / self.scale
        if self.trend is None:
            return self._smooth(scaled)
        return xp.concatenate([self.trend * quadratic(scaled), self._smooth(scaled)], axis=-1)

    def _smooth(self, scaled: Float[Any, "*S F"]) -> Float[Any, "*S r"]:
        xp = library_of(scaled)
        far = xp.sum(scaled**2, axis=-1, keepdims=True) + xp.sum(self.landmarks**2, axis=-1)
        distance = xp.maximum(far - 2.0 * scaled @ self.landmarks.T, 0.0)
        return xp.exp(-self.gamma * distance) @ self.projection


def quadratic(scaled: Float[Any, "*S F"]) -> Float[Any, "*S Q"]:
    """Features, and the product of each two of them, squares among them."""
    xp = library_of(scaled)
    one, other = _pairs(scaled.shape[-1])
    return xp.concatenate([scaled, scaled[..., one] * scaled[..., other]], axis=-1)


@cache
def _pairs(num_features: int) -> tuple[np.ndarray, np.ndarray]:
    """Each two of so many features; to find them takes longer than to multiply those of one state."""
    return np.triu_indices(num_features)
