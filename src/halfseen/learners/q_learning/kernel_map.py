"""Features of an RKHS, so that a Q in it is linear in them: ψ(x)·ψ(z) = k(x, z) on the landmarks' span.

k is Gaussian on features that are scaled to unit variance. With as many landmarks as there are different rows this is
the whole RKHS that the data can use (the representer theorem); with fewer it is its low-rank form
[WilliamsSeeger2000]_.
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

RANK_STEP = 32
"""The number of features is a multiple of this."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class KernelMap:
    """ψ(x) = Rᵀ k(landmarks, (x − centre)/scale) (a pytree).

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
    """

    centre: Float[AnyArray, " F"]
    scale: Float[AnyArray, " F"]
    landmarks: Float[AnyArray, "m F"]
    projection: Float[AnyArray, "m r"]
    gamma: Float[AnyArray, ""]

    def __call__(self, features: Float[AnyArray, "*S F"]) -> Float[AnyArray, "*S r"]:
        """Map features of states and actions, in NumPy or in JAX as they come."""
        xp: Any = jnp if isinstance(features, jax.Array) else np
        scaled = (features - self.centre) / self.scale
        far = xp.sum(scaled**2, axis=-1, keepdims=True) + xp.sum(self.landmarks**2, axis=-1)
        distance = xp.maximum(far - 2.0 * scaled @ self.landmarks.T, 0.0)
        return xp.exp(-self.gamma * distance) @ self.projection


def fit_kernel_map(
    rows: Float[np.ndarray, "k F"], num_landmarks: int, gamma: float | None, rng: np.random.Generator
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
    """
    centre, spread = rows.mean(axis=0), rows.std(axis=0)
    scale = np.where(spread > 1e-9 * np.maximum(np.abs(centre), 1e-9), spread, np.inf)
    num_varied = max(int(np.isfinite(scale).sum()), 1)
    width = 1.0 / num_varied if gamma is None else float(gamma)
    found = fit_nystrom(RbfKernel(width), (rows - centre) / scale, num_landmarks, rng)
    # Features that are 0 change nothing, and logs of about the same rank share one compiled fit.
    padding = -found.num_features % RANK_STEP
    projection = np.ascontiguousarray(np.pad(found.projection, ((0, 0), (0, padding))))
    return KernelMap(centre, scale, found.landmarks, projection, np.asarray(width))
