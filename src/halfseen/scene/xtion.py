"""The depth camera: a structured-light sensor like the Asus Xtion PRO.

The field of view (58° × 45°), the picture (640 × 480) and the far end of the range are the maker's figures. The
projector beside the camera makes a triangle of baseline b, so depth is z = f·b/d with the disparity d [px], and an
error of d becomes an error of z that grows with z². Numbers marked "ours" are chosen here, to be like this family of
sensors.
"""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter

from halfseen.arrays import Image
from halfseen.scene.camera import Camera
from halfseen.scene.poses import Pose
from halfseen.scene.view import IdealView

NUM_ROWS, NUM_COLUMNS = 480, 640
FIELD_OF_VIEW_RAD = (np.deg2rad(58.0), np.deg2rad(45.0))
BASELINE_M = 0.075  # ours, as is the side: the projector stands to the camera's right, so shadows fall to the left
DISPARITY_STEP_PX = 1 / 8  # ours
RANGE_M = (0.5, 3.5)  # the near end is ours
# Ours: the disparity's noise, in a part that neighbouring pixels share (they are matched by overlapping windows) and
# a part of each pixel's own; together 0.1 px.
SHARED_NOISE_PX = 0.09
OWN_NOISE_PX = 0.044
_WINDOW_PX = 3.0  # ours: spread of the shared part
# Ours: from the first angle between ray and normal on, some rays do not return; from the second on, none does.
GRAZING_RAD = (np.deg2rad(78.0), np.deg2rad(85.0))


def xtion_at(world_from_camera: Pose) -> Camera:
    """Put the sensor's camera somewhere; fx = 577.3 px and fy = 579.4 px follow from the field of view.

    Parameters
    ----------
    world_from_camera
        Where it stands [m].

    Returns
    -------
    Camera
        640 × 480 pixels, principal point in the middle.
    """
    fx = NUM_COLUMNS / 2 / np.tan(FIELD_OF_VIEW_RAD[0] / 2)
    fy = NUM_ROWS / 2 / np.tan(FIELD_OF_VIEW_RAD[1] / 2)
    focal_px = (round(float(fx), 4), round(float(fy), 4))
    return Camera(world_from_camera, focal_px, ((NUM_COLUMNS - 1) / 2, (NUM_ROWS - 1) / 2), NUM_ROWS, NUM_COLUMNS)


def sense(view: IdealView, focal_px: float, rng: np.random.Generator) -> Image:
    """Turn an ideal view into what the sensor returns.

    Parameters
    ----------
    view
        What an ideal camera sees, and what the projector reaches.
    focal_px
        Horizontal focal length [px].
    rng
        Source of the noise.

    Returns
    -------
    Image
        Depth [m]; NaN where nothing returns: out of range, in the projector's shadow, or at a grazing angle.
    """
    noise_px = disparity_noise_px(view.depth_m.shape, rng)
    dice = rng.random(view.depth_m.shape)
    depth_m = depth_from_disparity_m(noisy_disparity_px(view.depth_m, noise_px, focal_px), focal_px)
    is_back = view.is_lit & (dice >= loss_probability(view.incidence_cosine))
    is_back &= (depth_m >= RANGE_M[0]) & (depth_m <= RANGE_M[1])
    return np.where(is_back, depth_m, np.nan)


def disparity_noise_px(shape: tuple[int, ...], rng: np.random.Generator) -> Image:
    """Draw the noise of the disparity, partly shared between neighbours; its standard deviation is 0.1 px.

    Parameters
    ----------
    shape
        Rows and columns [px].
    rng
        Source of the noise.

    Returns
    -------
    Image
        Noise [px].
    """
    smooth = gaussian_filter(rng.standard_normal(shape), _WINDOW_PX, mode="wrap")
    # A Gaussian filter of spread s leaves 1/(4·π·s²) of the variance of white noise.
    shared = smooth * np.sqrt(4 * np.pi) * _WINDOW_PX
    return SHARED_NOISE_PX * shared + OWN_NOISE_PX * rng.standard_normal(shape)


def noisy_disparity_px(depth_m: Image, noise_px: Image, focal_px: float) -> Image:
    """Measure the disparity, in steps of 1/8 px: round(8·(f·b/z + noise))/8.

    Parameters
    ----------
    depth_m
        True depth [m]; NaN where there is nothing.
    noise_px
        Noise [px].
    focal_px
        Focal length f [px].

    Returns
    -------
    Image
        Disparity [px]; NaN where there is nothing.
    """
    exact_px = focal_px * BASELINE_M / depth_m
    return np.round((exact_px + noise_px) / DISPARITY_STEP_PX) * DISPARITY_STEP_PX


def depth_from_disparity_m(disparity_px: Image, focal_px: float) -> Image:
    """Turn a disparity into depth, z = f·b/d [m]; NaN where the disparity is not positive.

    Parameters
    ----------
    disparity_px
        Disparity d [px].
    focal_px
        Focal length f [px].

    Returns
    -------
    Image
        Depth [m].
    """
    is_finite_depth = disparity_px > 0
    return np.where(is_finite_depth, focal_px * BASELINE_M / np.where(is_finite_depth, disparity_px, 1.0), np.nan)


def loss_probability(incidence_cosine: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Give the probability that a ray is lost at a grazing angle: 0 up to 78°, 1 from 85° on, a ramp between.

    Parameters
    ----------
    incidence_cosine
        Cosine of the angle between ray and normal; NaN where nothing is met.

    Returns
    -------
    numpy.ndarray
        Probability; 1 where nothing is met.
    """
    angle_rad = np.arccos(np.clip(incidence_cosine, 0.0, 1.0))
    low_rad, high_rad = GRAZING_RAD
    return np.where(np.isnan(angle_rad), 1.0, np.clip((angle_rad - low_rad) / (high_rad - low_rad), 0.0, 1.0))
