"""Features ψ of a Q in an RKHS, with ψ(x)·ψ(z) = k(x, z) on the landmarks' span.

k is Gaussian on features that are scaled to unit variance. With as many landmarks as there are different rows this is
the whole RKHS that the data can use (the representer theorem); with fewer it is its low-rank form
[WilliamsSeeger2000]_. A *trend* adds the features themselves and all their products of two, so that k is the sum of two
kernels and Q that of a quadratic and of a smooth remainder.
"""

from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import library_of
from halfseen.learning.svm.nystrom import fit_nystrom
from halfseen.shapes import Float


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
        return gaussian(scaled, self.landmarks, self.gamma) @ self.projection


def gaussian(rows: Float[Any, "*S F"], others: Float[Any, "m F"], gamma: Any) -> Float[Any, "*S m"]:
    """k(x, z) = exp(−γ‖x − z‖²) of each row with each of some others."""
    xp = library_of(rows)
    far = xp.sum(rows**2, axis=-1, keepdims=True) + xp.sum(others**2, axis=-1)
    return xp.exp(-gamma * xp.maximum(far - 2.0 * rows @ others.T, 0.0))


def quadratic(scaled: Float[Any, "*S F"]) -> Float[Any, "*S Q"]:
    """Features, and the product of each two of them, squares among them."""
    xp = library_of(scaled)
    one, other = _pairs(scaled.shape[-1])
    return xp.concatenate([scaled, scaled[..., one] * scaled[..., other]], axis=-1)


@cache
def _pairs(num_features: int) -> tuple[np.ndarray, np.ndarray]:
    """Each two of so many features; to find them takes longer than to multiply those of one state."""
    return np.triu_indices(num_features)


def fit_kernel_map(
    rows: Float[np.ndarray, "k F"],
    num_landmarks: int,
    gamma: float | None,
    rng: np.random.Generator,
    trend: tuple[float, float] | None = None,
) -> KernelMap:
    """Choose landmarks among rows of features.

    Parameters
    ----------
    rows
        Features of the stages and actions that were logged.
    num_landmarks
        m, at most; fewer serve where they explain all rows.
    gamma
        γ on scaled features; None for 1/F.
    rng
        Draws the landmarks.
    trend
        Root mean squares, over rows, of the part of c · q(z) that is linear and of that of the products, beside a
        Gaussian kernel of 1; None for no trend. So the more products there are, the less each counts.
    """
    centre, spread = rows.mean(axis=0), rows.std(axis=0)
    scale = np.where(spread > 1e-9 * np.maximum(np.abs(centre), 1e-9), spread, np.inf)
    num_varied = max(int(np.isfinite(scale).sum()), 1)
    width = 1.0 / num_varied if gamma is None else float(gamma)
    scaled = (rows - centre) / scale
    weight = None if trend is None else _trend_weights(scaled, trend)
    if num_landmarks == 0:
        return KernelMap(centre, scale, scaled[:0], np.zeros((0, 0)), np.asarray(width), weight)
    found = fit_nystrom(partial(gaussian, gamma=width), scaled, num_landmarks, rng)
    return KernelMap(centre, scale, found.landmarks, found.projection, np.asarray(width), weight)


def _trend_weights(scaled: Float[np.ndarray, "k F"], sizes: tuple[float, float]) -> Float[np.ndarray, " Q"]:
    """Bring the linear part of q and its products to root mean squares of their own."""
    parts = np.split(np.asarray(quadratic(scaled)), [scaled.shape[1]], axis=1)
    means = [float(np.sqrt(np.sum(part**2, axis=-1).mean())) for part in parts]
    each = [size / mean if mean > 0 else 0.0 for size, mean in zip(sizes, means, strict=True)]
    return np.repeat(each, [part.shape[1] for part in parts])
