"""The depth camera: how far it errs, and the pinhole that an organised cloud shows.

From where it stood, each point lies on the ray of its pixel.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from scipy.linalg import rq

from halfseen.arrays import Intrinsics, Points
from halfseen.shapes import Float, Int


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


# Largest distance between a point and its pixel's ray that still counts as a pinhole image [px].
LARGEST_REPROJECTION_PX = 2.0
# Fewest returns from which a camera can be worked out [points], and how many take part where a few will do.
FEWEST_RETURNS, NUM_ASKED = 200, 4000
# Rows and columns of a pinhole's pixels are square to one another, to this share of the focal length.
LARGEST_SKEW = 0.02

Pixels = Float[np.ndarray, "n 2"]


class Pinhole(NamedTuple):
    """A camera at the origin of the points."""

    intrinsics: Intrinsics
    """Pinhole matrix [px]."""
    axes: Float[np.ndarray, "3 3"]
    """Its right, down and forward axes as columns; they are mirrored where the points, or the columns, are."""
    misfit_px: float
    """Median distance between a point and its pixel's ray; infinite if this is no camera [px]."""

    @property
    def is_camera(self) -> bool:
        """Whether points lie on the rays of their pixels."""
        return self.misfit_px <= LARGEST_REPROJECTION_PX


NO_CAMERA = Pinhole(np.eye(3), np.eye(3), np.inf)


def pixels_of_returns(
    points_m: Points, shape: tuple[int, int], most: int | None = None
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 2"]]:
    """Points that returned, and the column and row of each.

    Parameters
    ----------
    points_m
        Points, row by row; NaN where nothing returned [m].
    shape
        Rows and columns of the image [px].
    most
        About so many at most, from all over the image; None for all.
    """
    pixels: Int[np.ndarray, " k"] = np.flatnonzero(np.isfinite(points_m[:, 2]))
    pixels = pixels[:: 1 if most is None else max(1, len(pixels) // most)]
    return points_m[pixels], np.stack([pixels % shape[1], pixels // shape[1]], axis=1).astype(np.float64)


def misfit_px(points_m: Points, at_px: Pixels, K: Intrinsics) -> float:
    """Median distance between a point and its pixel's ray [px].

    Parameters
    ----------
    points_m, at_px, K
        Points in the camera's frame [m], where each is in the image, and the pinhole matrix [px].
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = points_m @ K.T
        apart = np.linalg.norm(seen[:, :2] / seen[:, 2:] - at_px, axis=1)
    return float(np.median(np.where(seen[:, 2] > 0, apart, np.inf))) if len(points_m) else np.inf


def aligned_pinhole(points_m: Points, at_px: Pixels) -> Pinhole:
    """Camera whose axes are those of the points, up to their signs.

    Parameters
    ----------
    points_m, at_px
        Points from the camera's place [m], and where each is in the image.
    """
    forward = -1.0 if np.count_nonzero(points_m[:, 2] < 0) > 0.5 * len(points_m) else 1.0
    is_before = forward * points_m[:, 2] > 0
    if np.count_nonzero(is_before) < FEWEST_RETURNS:
        return NO_CAMERA
    points_m, at_px, K, signs, misfits = points_m[is_before], at_px[is_before], np.eye(3), [1.0, 1.0, forward], []
    for axis in (0, 1):
        slope = points_m[:, axis] / (forward * points_m[:, 2])
        design = np.stack([slope, np.ones(len(slope))], axis=1)
        (focal, centre), *_ = np.linalg.lstsq(design, at_px[:, axis], rcond=None)
        misfits.append(float(np.median(np.abs(design @ [focal, centre] - at_px[:, axis]))))
        signs[axis] = 1.0 if focal > 0 else -1.0
        K[axis, axis], K[axis, 2] = abs(focal), centre
    return Pinhole(K, np.diag(signs), max(misfits)) if K[[0, 1], [0, 1]].min() >= 1.0 else NO_CAMERA


def turned_pinhole(points_m: Points, at_px: Pixels) -> Pinhole:
    """Camera whose axes are any, by the direct linear transformation [HartleyZisserman2004]_, section 4.1.

    Parameters
    ----------
    points_m, at_px
        Points from the camera's place [m], and where each is in the image.
    """
    if len(points_m) < FEWEST_RETURNS:
        return NO_CAMERA
    ray = points_m / np.linalg.norm(points_m, axis=1, keepdims=True)
    middle_px, scale_px = at_px.mean(axis=0), max(float(np.ptp(at_px)), 1.0)
    column, row = ((at_px - middle_px) / scale_px).T[..., None]
    none = np.zeros_like(ray)
    design = np.concatenate([np.hstack([ray, none, -column * ray]), np.hstack([none, ray, -row * ray])])
    image_from_ray = np.linalg.svd(design, full_matrices=False)[2][-1].reshape(3, 3)
    image_from_ray = np.array([[scale_px, 0, middle_px[0]], [0, scale_px, middle_px[1]], [0, 0, 1]]) @ image_from_ray
    image_from_ray *= 1.0 if np.median(ray @ image_from_ray[2]) > 0 else -1.0
    misfit = misfit_px(points_m, at_px, image_from_ray)
    K, axes = rq(image_from_ray)
    signs = np.where(np.diag(K) < 0, -1.0, 1.0)
    K, axes = K * signs, (axes * signs[:, None]).T
    K = K / max(K[2, 2], 1e-12)
    is_none = K[0, 0] < 1.0 or K[1, 1] < 1.0 or abs(K[0, 1]) > LARGEST_SKEW * K[0, 0]
    K[0, 1] = 0.0
    return NO_CAMERA if is_none else Pinhole(K, axes, misfit)
