"""Labels: which objects look dirty, from the colours that are in view of each; and how much of each was in view."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from halfseen.errors import CloudError
from halfseen.perception.clouds import Cloud, Picture
from halfseen.perception.range_image import RangeImage
from halfseen.perception.view import SeenObject, View
from halfseen.shapes import Bool, Float, UInt8


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


# From one side, a camera sees half of the outside of a wall, and of its inside what the mouth shows: of walls inside
# and out this share, in the mean over cups that nothing hides.
FACING_SHARE = 0.3
# Added to a channel before its logarithm is taken, so that the noise of dark pixels does not pass for colour.
_NOISE = 6.0

WORDS = {True: "dirty", False: "clean", None: "unknown"}


@dataclass(frozen=True)
class Label:
    """What a look says of an object's hidden attribute.

    Parameters
    ----------
    is_dirty
        What it looks like; None if that cannot be told: too little of it was in view, or it has a pattern.
    share_in_view
        Share of its walls, inside and out, that was in view, in [0, 1]; None if nobody said.
    num_stained_px
        How many of its pixels look stained.
    num_seen_px
        How many of its pixels were in view.
    """

    is_dirty: bool | None
    share_in_view: float | None = None
    num_stained_px: int = 0
    num_seen_px: int = 0

    @property
    def word(self) -> str:
        """``dirty``, ``clean`` or ``unknown``."""
        return WORDS[self.is_dirty]


@runtime_checkable
class Labeller(Protocol):
    """Whatever labels the objects of a view, such as a `StainCounter` or a function of one's own."""

    def __call__(self, view: View, cloud: Cloud) -> Sequence[Label]:
        """Label each object of a view.

        Parameters
        ----------
        view
            What `perceive` saw in the cloud.
        cloud
            The cloud.

        Returns
        -------
        Sequence of Label
            One an object, in the order of `View.objects`.
        """
        ...


@dataclass(frozen=True)
class StainCounter:
    """Counts the stained pixels of each object; one with enough of them is dirty.

    The hue of a colour is the logarithms of its channels less their mean, which light and shade do not change. A pixel
    is stained if it is darker than the object's median, and its hue is nearer to that of a stain than to the object's
    own, the median over its pixels, by a margin that noise rarely crosses. On a glaze as brown as a stain no stain is
    seen. An object half of whose pixels are farther than the margin from that median has a pattern, and no hue of its
    own to tell stains from: it is not labelled.

    Parameters
    ----------
    fewest_px
        So many stained pixels make an object dirty; one with fewer pixels in view is not labelled [px].
    stain
        Red, green and blue of a stain, in any light.
    margin
        How much nearer a pixel's hue must be to the stain's, as a distance of logarithms.
    """

    fewest_px: int = 12
    stain: tuple[int, int, int] = (98, 62, 30)
    margin: float = 0.15

    def __call__(self, view: View, cloud: Cloud) -> tuple[Label, ...]:
        """Label each object of a view by its colours."""
        picture = pixel_colours(view.image, cloud).reshape(-1, 3)
        return tuple(self._label(seen, picture[seen.pixels]) for seen in view.objects)

    def _label(self, seen: SeenObject, colours: UInt8[np.ndarray, "px 3"]) -> Label:
        num_stained = int(self.is_stained(colours).sum())
        can_tell = len(colours) >= self.fewest_px and not self.is_patterned(colours)
        is_dirty = num_stained >= self.fewest_px if can_tell else None
        return Label(is_dirty, share_in_view(seen), num_stained, len(colours))

    def is_patterned(self, colours: UInt8[np.ndarray, "px 3"]) -> bool:
        """Whether one object has no hue of its own.

        Parameters
        ----------
        colours
            Red, green and blue of its pixels.
        """
        hues, _ = _hues_and_lightness(colours)
        return bool(np.median(np.linalg.norm(hues - np.median(hues, axis=0), axis=1)) > self.margin)

    def is_stained(self, colours: UInt8[np.ndarray, "px 3"]) -> Bool[np.ndarray, " px"]:
        """Which pixels of one object are stained.

        Parameters
        ----------
        colours
            Red, green and blue of its pixels.
        """
        hues, lightness = _hues_and_lightness(colours)
        (stain,), _ = _hues_and_lightness(np.array([self.stain], dtype=np.uint8))
        from_own, from_stain = (np.linalg.norm(hues - hue, axis=1) for hue in (np.median(hues, axis=0), stain))
        return (from_own - from_stain > self.margin) & (lightness < np.median(lightness))


def _hues_and_lightness(
    colours: UInt8[np.ndarray, "px 3"],
) -> tuple[Float[np.ndarray, "px 3"], Float[np.ndarray, " px"]]:
    """Logarithms of the channels less their mean, and that mean."""
    logarithms = np.log(colours + _NOISE)
    lightness = logarithms.mean(axis=1)
    return logarithms - lightness[:, None], lightness


def share_in_view(seen: SeenObject) -> float:
    """Share of an object's walls, inside and out, that is in view: what faces the camera and is not hidden.

    Parameters
    ----------
    seen
        An object, taken for a cup.
    """
    return FACING_SHARE * (1.0 - seen.occlusion)
