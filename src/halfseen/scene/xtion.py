"""The depth camera: a structured-light sensor, by default one like the Asus Xtion PRO.

The field of view (58° × 45°), the picture size (640 × 480) and the far end of the range are the manufacturer's. Camera
and projector triangulate with baseline b: depth is z = f·b/d with the disparity d [px], and an error of d becomes an
error of z that grows with z². Numbers marked "ours" are our own choice, typical of this family of sensors. The error
model that perception assumes is `halfseen.perception.DepthSensor`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from halfseen.arrays import Image
from halfseen.scene.poses import Pose
from halfseen.scene.table import Camera
from halfseen.scene.view import IdealView
from halfseen.shapes import Float

NUM_ROWS, NUM_COLUMNS = 480, 640
FIELD_OF_VIEW_RAD = (np.deg2rad(58.0), np.deg2rad(45.0))


@dataclass(frozen=True)
class StructuredLight:
    """Model of a depth camera with a projector beside it.

    Parameters
    ----------
    baseline_m
        Distance from the camera to the projector on its right; shadows fall to the left [m].
    range_m
        Nearest and farthest depth that returns [m].
    disparity_step_px
        Step in which disparities are measured [px].
    shared_noise_px, own_noise_px
        Standard deviation of the disparity noise: the part shared by neighbouring pixels, which are matched by
        overlapping windows, and each pixel's own part [px].
    window_px
        Spread of the shared part [px].
    grazing_rad
        Angles between ray and normal: from the first on, some rays do not return; from the second on, none does [rad].
    """

    baseline_m: float
    range_m: tuple[float, float]
    disparity_step_px: float
    shared_noise_px: float
    own_noise_px: float
    window_px: float
    grazing_rad: tuple[float, float]


XTION = StructuredLight(
    baseline_m=0.075,  # ours, and so is the side
    range_m=(0.5, 3.5),  # the near end is ours
    disparity_step_px=1 / 8,  # ours, and so is everything below; the total noise is 0.1 px
    shared_noise_px=0.09,
    own_noise_px=0.044,
    window_px=3.0,
    grazing_rad=(float(np.deg2rad(78.0)), float(np.deg2rad(85.0))),
)


def xtion_at(world_from_camera: Pose) -> Camera:
    """The sensor's camera at a pose: 640 × 480 pixels, principal point in the middle.

    fx = 577.3 px and fy = 579.4 px follow from the field of view.
    """
    fx = NUM_COLUMNS / 2 / np.tan(FIELD_OF_VIEW_RAD[0] / 2)
    fy = NUM_ROWS / 2 / np.tan(FIELD_OF_VIEW_RAD[1] / 2)
    focal_px = (round(float(fx), 4), round(float(fy), 4))
    return Camera(world_from_camera, focal_px, ((NUM_COLUMNS - 1) / 2, (NUM_ROWS - 1) / 2), NUM_ROWS, NUM_COLUMNS)


def sense(view: IdealView, focal_px: float, rng: np.random.Generator, sensor: StructuredLight = XTION) -> Image:
    """Turn an ideal view into the sensor's depth image [m].

    It is NaN where nothing returns: out of range, in the projector's shadow, or at a grazing angle. `focal_px` is the
    horizontal focal length [px].
    """
    noise_px = disparity_noise_px(view.depth_m.shape, rng, sensor)
    dice = rng.random(view.depth_m.shape)
    measured_px = noisy_disparity_px(view.depth_m, noise_px, focal_px, sensor)
    depth_m = depth_from_disparity_m(measured_px, focal_px, sensor)
    is_back = view.is_lit & (dice >= loss_probability(view.incidence_cosine, sensor))
    is_back &= (depth_m >= sensor.range_m[0]) & (depth_m <= sensor.range_m[1])
    return np.where(is_back, depth_m, np.nan)


def disparity_noise_px(shape: tuple[int, ...], rng: np.random.Generator, sensor: StructuredLight = XTION) -> Image:
    """Draw the disparity noise of an image, partly shared between neighbours [px]."""
    smooth = gaussian_filter(rng.standard_normal(shape), sensor.window_px, mode="wrap")
    # A Gaussian filter of spread s reduces the variance of white noise to 1/(4·π·s²).
    shared = smooth * np.sqrt(4 * np.pi) * sensor.window_px
    return sensor.shared_noise_px * shared + sensor.own_noise_px * rng.standard_normal(shape)


def noisy_disparity_px(depth_m: Image, noise_px: Image, focal_px: float, sensor: StructuredLight = XTION) -> Image:
    """Measure the disparity f·b/z + noise, rounded to the sensor's steps [px]; NaN where the depth is NaN."""
    exact_px = focal_px * sensor.baseline_m / depth_m
    return np.round((exact_px + noise_px) / sensor.disparity_step_px) * sensor.disparity_step_px


def depth_from_disparity_m(disparity_px: Image, focal_px: float, sensor: StructuredLight = XTION) -> Image:
    """Turn a disparity into depth, z = f·b/d [m]; NaN where the disparity is not positive."""
    is_finite_depth = disparity_px > 0
    return np.where(
        is_finite_depth, focal_px * sensor.baseline_m / np.where(is_finite_depth, disparity_px, 1.0), np.nan
    )


def loss_probability(
    incidence_cosine: Float[np.ndarray, "..."], sensor: StructuredLight = XTION
) -> Float[np.ndarray, "..."]:
    """Probability that a ray is lost at a grazing angle: a linear ramp from 0 to 1 between two angles.

    It is 1 where the cosine is NaN, without a hit.
    """
    angle_rad = np.arccos(np.clip(incidence_cosine, 0.0, 1.0))
    low_rad, high_rad = sensor.grazing_rad
    return np.where(np.isnan(angle_rad), 1.0, np.clip((angle_rad - low_rad) / (high_rad - low_rad), 0.0, 1.0))
