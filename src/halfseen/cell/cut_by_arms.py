"""What an arm cuts off from the camera's view of an object: such an object is left out of a look, and kept as it was.

An object of which an arm hides a part would be completed to a wrong shape, and a stain behind the arm would count as
looked for. Where nothing returns, nothing is told: so its pixels are taken out, too.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool
from scipy.ndimage import minimum_filter

from halfseen.arrays import Image
from halfseen.perception.clouds import Cloud
from halfseen.perception.view import View, perceive

_BESIDE_PX = 3
_BEHIND_M = 0.03
"""An arm hides what is farther than this before it [m]: what it holds counts as cut."""


def perceived_whole(cloud: Cloud, arms_m: Image) -> tuple[View, Cloud]:
    """Perceive what no arm cuts.

    Parameters
    ----------
    cloud
        What the camera returned, without robots.
    arms_m
        Distance of robots along the optical axis [m]; infinite where there is none.

    Returns
    -------
    View
        What is seen whole.
    Cloud
        The cloud without the objects that are not.
    """
    view = perceive(cloud)
    if not np.isfinite(arms_m).any():
        return view, cloud
    nearest_m = minimum_filter(arms_m, 2 * _BESIDE_PX + 1)
    is_beside = nearest_m < view.image.depth_m + _BEHIND_M
    cut = [seen.pixels for seen in view.objects if is_beside.ravel()[seen.pixels].any()]
    if not cut:
        return view, cloud
    is_cut: Bool[np.ndarray, " n"] = np.zeros(len(cloud.points_m), dtype=bool)
    is_cut[np.concatenate(cut)] = True
    left = replace(cloud, points_m=np.where(is_cut[:, None], np.nan, cloud.points_m))
    return perceive(left), left
