"""Features of an RKHS, so that a Q in it is linear in them: ψ(x)·ψ(z) = k(x, z) on the landmarks' span.

k is Gaussian on features that are scaled to unit variance. With as many landmarks as there are different rows this is
the whole RKHS that the data can use (the representer theorem); with fewer it is its low-rank form
[WilliamsSeeger2000]_. A *trend* adds the features themselves and all their products of two, so that k is the sum of two
kernels and Q that of a quadratic and of a smooth remainder.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from halfseen.learners.svm.nystrom import fit_nystrom
from halfseen.learners.svm.vector_kernels import RbfKernel

AnyArray = jax.Array | np.ndarray

RANK_STEP = 16
"""The number of features is a multiple of this."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class KernelMap:
    """ψ(x) = (c · q(z), Rᵀ k(landmarks, z)) with z = (x − centre)/scale and q(z) all z_i and z_i z_j (a pytree).

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

    centre: Float[AnyArray, " F"]
    scale: Float[AnyArray, " F"]
    landmarks: Float[AnyArray, "m F"]
    projection: Float[AnyArray, "m r"]
    gamma: Float[AnyArray, ""]
    trend: Float[AnyArray, " Q"] | None = None

    @property
    def num_features(self) -> int:
        """Length of ψ(x)."""
        return (0 if self.trend is None else len(self.trend)) + self.projection.shape[1]

    def __call__(self, features: Float[AnyArray, "*S F"]) -> Float[AnyArray, "*S r"]:
        """Map features of states and actions, in NumPy or in JAX as they come."""
        xp: Any = jnp if isinstance(features, jax.Array) else np
        scaled = (features - self.centre) / self.scale
        if self.trend is None:
            return self._smooth(scaled)
        return xp.concatenate([self.trend * quadratic(scaled), self._smooth(scaled)], axis=-1)

    def _smooth(self, scaled: Float[AnyArray, "*S F"]) -> Float[AnyArray, "*S r"]:
        xp: Any = jnp if isinstance(scaled, jax.Array) else np
        far = xp.sum(scaled**2, axis=-1, keepdims=True) + xp.sum(self.landmarks**2, axis=-1)
        distance = xp.maximum(far - 2.0 * scaled @ self.landmarks.T, 0.0)
        return xp.exp(-self.gamma * distance) @ self.projection


def quadratic(scaled: Float[AnyArray, "*S F"]) -> Float[AnyArray, "*S Q"]:
    """Features, and the product of each two of them, squares among them."""
    xp: Any = jnp if isinstance(scaled, jax.Array) else np
    one, other = np.triu_indices(scaled.shape[-1])
    return xp.concatenate([scaled, scaled[..., one] * scaled[..., other]], axis=-1)


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
    found = fit_nystrom(RbfKernel(width), scaled, num_landmarks, rng)
    # Features that are 0 change nothing, and logs of about the same rank share one compiled fit.
    padding = -found.num_features % RANK_STEP
    projection = np.ascontiguousarray(np.pad(found.projection, ((0, 0), (0, padding))))
    return KernelMap(centre, scale, found.landmarks, projection, np.asarray(width), weight)


def _trend_weights(scaled: Float[np.ndarray, "k F"], sizes: tuple[float, float]) -> Float[np.ndarray, " Q"]:
    """Bring the linear part of q and its products to root mean squares of their own."""
    parts = np.split(np.asarray(quadratic(scaled)), [scaled.shape[1]], axis=1)
    means = [float(np.sqrt(np.sum(part**2, axis=-1).mean())) for part in parts]
    each = [size / mean if mean > 0 else 0.0 for size, mean in zip(sizes, means, strict=True)]
    return np.repeat(each, [part.shape[1] for part in parts])
