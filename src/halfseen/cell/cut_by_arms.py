"""What an arm cuts off from the camera's view of an object: such an object is left out of a look, and kept as it was.

An object of which an arm, or what it holds, hides a part would be completed to a wrong shape, and a stain behind it
would count as looked for. Where nothing returns, nothing is told: so its pixels are taken out, too.
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import minimum_filter

from halfseen.arrays import Image
from halfseen.perception.clouds import Cloud
from halfseen.perception.view import View, perceive
from halfseen.shapes import Bool

_BESIDE_PX = 3
_BEHIND_M = 0.03
"""An arm hides what is farther than this before it [m]: what it touches counts as cut."""


def perceived_whole(cloud: Cloud, arms_m: Image, is_held: Bool[np.ndarray, " n"]) -> tuple[View, Cloud]:
    """Perceive what no arm cuts, nor what it holds.

    Parameters
    ----------
    cloud
        What the camera returned, without robots.
    arms_m
        Distance of robots along the optical axis [m]; infinite where there is none.
    is_held
        Which points of the cloud belong to what hands hold: it is no object on the table, and hides as arms do.

    Returns
    -------
    View
        What is seen whole.
    Cloud
        The cloud without the objects that are not, and without what is held.
    """
    held_m = np.where(is_held, cloud.points_m[:, 2], np.inf).reshape(arms_m.shape)
    cloud = without(cloud, is_held)
    view = perceive(cloud)
    hiding_m = np.minimum(arms_m, held_m)
    if not np.isfinite(hiding_m).any():
        return view, cloud
    nearest_m = minimum_filter(hiding_m, 2 * _BESIDE_PX + 1)
    is_beside = nearest_m < view.image.depth_m + _BEHIND_M
    cut = [seen.pixels for seen in view.objects if is_beside.ravel()[seen.pixels].any()]
    if not cut:
        return view, cloud
    is_cut: Bool[np.ndarray, " n"] = np.zeros(len(cloud.points_m), dtype=bool)
    is_cut[np.concatenate(cut)] = True
    left = without(cloud, is_cut)
    return perceive(left), left


def without(cloud: Cloud, is_out: Bool[np.ndarray, " n"]) -> Cloud:
    """Take points out of a cloud, as if nothing had returned there.

    Parameters
    ----------
    cloud
        What the camera returned.
    is_out
        Which of its points.
    """
    if not is_out.any():
        return cloud
    return replace(cloud, points_m=np.where(is_out[:, None], np.nan, cloud.points_m))
