"""Colour of each pixel of a range image."""

import numpy as np

from halfseen.errors import CloudError
from halfseen.perception.clouds import Cloud, Picture
from halfseen.perception.range_image import RangeImage


def pixel_colours(image: RangeImage, cloud: Cloud) -> Picture:
    """Give each pixel the colour of the point that it shows: the nearest of those that fall into it.

    Parameters
    ----------
    image
        Range image of the cloud.
    cloud
        A cloud with colour.

    Returns
    -------
    numpy.ndarray
        Red, green and blue; black where nothing returned.

    Raises
    ------
    CloudError
        The cloud has no colour.
    """
    if cloud.colours is None:
        raise CloudError(f"{cloud.name}: it has no colour; record it with colour, or give labels in a file")
    if cloud.shape is not None and not image.is_virtual:
        return np.where(image.is_return[..., None], cloud.colours.reshape(*cloud.shape, 3), np.uint8(0))
    shown = np.flatnonzero(image.pixel_of_point >= 0)
    seen_m = (cloud.points_m[shown] - cloud.eye_m) @ image.cloud_from_camera
    # The nearest comes last, and stays; equal depths are told apart as in the range image.
    order = shown[np.lexsort((seen_m[:, 1], seen_m[:, 0], seen_m[:, 2]))[::-1]]
    picture = np.zeros((image.depth_m.size, 3), dtype=np.uint8)
    picture[image.pixel_of_point[order]] = cloud.colours[order]
    return picture.reshape(*image.depth_m.shape, 3)
