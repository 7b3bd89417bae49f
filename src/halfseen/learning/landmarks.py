"""Which features of an RKHS suit some rows: landmarks among them, and how much each part of a trend counts."""

import numpy as np
from jaxtyping import Float

from halfseen.learning.kernel_map import KernelMap, quadratic
from halfseen.learning.svm.nystrom import fit_nystrom
from halfseen.learning.svm.vector_kernels import RbfKernel


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
    return KernelMap(centre, scale, found.landmarks, found.projection, np.asarray(width), weight)


def _trend_weights(scaled: Float[np.ndarray, "k F"], sizes: tuple[float, float]) -> Float[np.ndarray, " Q"]:
    """Bring the linear part of q and its products to root mean squares of their own."""
    parts = np.split(np.asarray(quadratic(scaled)), [scaled.shape[1]], axis=1)
    means = [float(np.sqrt(np.sum(part**2, axis=-1).mean())) for part in parts]
    each = [size / mean if mean > 0 else 0.0 for size, mean in zip(sizes, means, strict=True)]
    return np.repeat(each, [part.shape[1] for part in parts])
