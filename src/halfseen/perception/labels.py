"""Labels: which objects look dirty, from their visible colours or from a file, and how much of each was in view.

A CSV or JSON file with one entry per object supports labels from sources other than colour.
"""

import csv
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from halfseen.errors import ArgumentError, CloudError
from halfseen.perception.clouds import Cloud, Picture
from halfseen.perception.range_image import RangeImage
from halfseen.perception.view import SeenObject, View
from halfseen.reading import json_of, opened_text, read_text, reason_of
from halfseen.shapes import Bool, Float, UInt8


def pixel_colours(image: RangeImage, cloud: Cloud) -> Picture:
    """Give each pixel the colour of its point, the nearest of those that project into it.

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
    # The nearest point comes last and is kept; ties in depth are broken as in the range image.
    order = shown[np.lexsort((seen_m[:, 1], seen_m[:, 0], seen_m[:, 2]))[::-1]]
    picture = np.zeros((image.depth_m.size, 3), dtype=np.uint8)
    picture[image.pixel_of_point[order]] = cloud.colours[order]
    return picture.reshape(*image.depth_m.shape, 3)


# Share of a cup's walls, inside and out, that faces a camera, on average over unoccluded cups: half of the outside, and
# the part of the inside that shows through the mouth.
FACING_SHARE = 0.3
# Added to a channel before the logarithm, so that the noise of dark pixels does not look like colour.
_NOISE = 6.0
# A picture with fewer pixels whose channels differ by more than this is grey, or was never filled in; it tells nothing.
_GREY, _LEAST_COLOURED = 1, 0.01
_DARK = 20.0  # median of an object, of 255, below which over half of the stains that show in full light are missed

WORDS = {True: "dirty", False: "clean", None: "unknown"}


@dataclass(frozen=True)
class Label:
    """A look's label of an object's hidden attribute.

    Parameters
    ----------
    is_dirty
        Whether it looks dirty; None if unknown, because too little of it was in view or it has a pattern.
    share_in_view
        Share of its walls, inside and out, that was in view, in [0, 1]; None if unknown.
    num_stained_px
        Number of its pixels that look stained.
    num_seen_px
        Number of its pixels in view.
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
    """Labels the objects of a view; a `StainCounter`, for example, or a user's function."""

    def __call__(self, view: View, cloud: Cloud) -> Sequence[Label]:
        """Label each object of a view.

        Parameters
        ----------
        view
            View of the cloud from `perceive`.
        cloud
            The cloud.

        Returns
        -------
        Sequence of Label
            One per object, in the order of `View.objects`.
        """
        ...


@dataclass(frozen=True)
class StainCounter:
    """Labels an object as dirty if it has enough stained pixels.

    The hue of a colour is the logarithms of its channels minus their mean; it does not depend on light and shade. A
    pixel is stained if it is darker than the object's median, and its hue is closer to that of a stain than to the
    object's own hue, the median over its pixels, by a margin that noise rarely exceeds. A stain on a glaze of the same
    brown is not detected. If half of an object's pixels are farther than the margin from that median, the object has a
    pattern and no hue of its own to compare with stains; it is not labelled. Nor is one with pixels so
    wide that a stain has too few of them, or so dark that they have no hue.

    Parameters
    ----------
    fewest_px
        Number of stained pixels from which an object is dirty; one with fewer visible pixels is not labelled [px].
    stain
        Red, green and blue of a stain, in any light.
    margin
        Required difference between a pixel's distances to its object's hue and to the stain's, in logarithms.
    widest_m
        Width of a pixel on an object beyond which the object is not labelled [m].
    """

    fewest_px: int = 12
    stain: tuple[int, int, int] = (98, 62, 30)
    margin: float = 0.15
    widest_m: float = 0.004

    def __call__(self, view: View, cloud: Cloud) -> tuple[Label, ...]:
        """Label each object of a view from its colours."""
        picture = pixel_colours(view.image, cloud).reshape(-1, 3)
        labels = tuple(self._label(seen, picture[seen.pixels], view.image) for seen in view.objects)
        apart = np.ptp(picture[view.image.is_return.ravel()].astype(np.int16), axis=1)
        if np.mean(apart > _GREY) > _LEAST_COLOURED:
            return labels
        return tuple(replace(label, is_dirty=None) for label in labels)

    def _label(self, seen: SeenObject, colours: UInt8[np.ndarray, "px 3"], image: RangeImage) -> Label:
        num_stained = int(self.is_stained(colours).sum())
        width_m = np.median(image.depth_m.ravel()[seen.pixels]) / image.intrinsics[0, 0]
        is_lit = np.median(colours.mean(axis=1)) >= _DARK if len(colours) >= self.fewest_px else False
        can_tell = bool(is_lit) and width_m <= self.widest_m and not self.is_patterned(colours)
        is_dirty = num_stained >= self.fewest_px if can_tell else None
        return Label(is_dirty, share_in_view(seen), num_stained, len(colours))

    def is_patterned(self, colours: UInt8[np.ndarray, "px 3"]) -> bool:
        """Whether an object has no hue of its own.

        Parameters
        ----------
        colours
            Red, green and blue of its pixels.
        """
        hues, _ = _hues_and_lightness(colours)
        return bool(np.median(np.linalg.norm(hues - np.median(hues, axis=0), axis=1)) > self.margin)

    def is_stained(self, colours: UInt8[np.ndarray, "px 3"]) -> Bool[np.ndarray, " px"]:
        """Mask of the stained pixels of an object.

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
    """Logarithms of the channels minus their mean, and that mean."""
    logarithms = np.log(colours + _NOISE)
    lightness = logarithms.mean(axis=1)
    return logarithms - lightness[:, None], lightness


def share_in_view(seen: SeenObject) -> float:
    """Share of an object's walls, inside and out, that is in view: facing the camera and not hidden.

    Parameters
    ----------
    seen
        An object, assumed to be a cup.
    """
    return FACING_SHARE * (1.0 - seen.occlusion)


KEYS = ("object", "label", "share_in_view")
_OF_WORD = {word: is_dirty for is_dirty, word in WORDS.items()}


@dataclass(frozen=True)
class LabelFile:
    """Labels objects from a file (a `Labeller`); shares in view come from the view unless the file gives them.

    Parameters
    ----------
    path
        File for `read_labels`.
    """

    path: Path

    def __call__(self, view: View, cloud: Cloud) -> tuple[Label, ...]:
        """Label each object of a view from the file."""
        labels = read_labels(self.path, len(view.objects))
        return tuple(
            replace(label, share_in_view=share_in_view(seen)) if label.share_in_view is None else label
            for seen, label in zip(view.objects, labels, strict=True)
        )


def labels_of(view: View, cloud: Cloud, file: Path | None = None) -> Sequence[Label] | None:
    """Label the objects of a view from a file if given, otherwise by colour; None if there is neither.

    Parameters
    ----------
    view, cloud
        The view and its cloud.
    file
        File of labels for `read_labels`.

    Raises
    ------
    ArgumentError
        The file cannot be read, or does not label these objects.
    """
    if file is not None:
        return LabelFile(file)(view, cloud)
    return None if cloud.colours is None else StainCounter()(view, cloud)


def read_labels(path: str | os.PathLike[str], num_objects: int) -> tuple[Label, ...]:
    """Read a label for each object, numbered from 0 as `halfseen look` numbers them.

    Parameters
    ----------
    path
        ``.csv`` with columns ``object``, ``label`` (dirty, clean or unknown) and, optionally, ``share_in_view``, in
        [0, 1]; or ``.json``, a list of objects with these keys.
    num_objects
        Number of objects.

    Returns
    -------
    tuple of Label
        In the order of the objects.

    Raises
    ------
    ArgumentError
        The file cannot be read, or a row is invalid, missing or duplicate; the message names file and row.
    """
    path = Path(path)
    labels: dict[int, Label] = {}
    for number, entry in enumerate(_entries(path), start=1):
        where = f"{path}: row {number}"
        which = _object(entry, num_objects, where)
        if which in labels:
            raise ArgumentError(f"{where}: object {which} has a label already; give one row per object")
        labels[which] = Label(_is_dirty(entry, where), _share(entry, where))
    missing = [which for which in range(num_objects) if which not in labels]
    if missing:
        raise ArgumentError(
            f"{path}: object {missing[0]} of {num_objects} has no label; give one row per object, with 'unknown' if "
            "its state is unclear"
        )
    return tuple(labels[which] for which in range(num_objects))


def _entries(path: Path) -> list[dict[str, Any]]:
    reader = {".csv": _csv_entries, ".json": _json_entries}.get(path.suffix.lower())
    if reader is None:
        raise ArgumentError(f"{path}: labels must be a .csv or .json file")
    try:
        entries = reader(path)
    except (OSError, ValueError, RecursionError, csv.Error) as error:
        raise ArgumentError(f"{path}: it cannot be read as labels ({reason_of(error)})") from error
    for number, entry in enumerate(entries, start=1):
        if not {"object", "label"} <= set(entry) <= set(KEYS):
            raise ArgumentError(
                f"{path}: row {number} has {', '.join(map(str, entry)) or 'nothing'}; give object, label and, "
                "optionally, share_in_view, and nothing else"
            )
    return entries


def _csv_entries(path: Path) -> list[dict[str, Any]]:
    with opened_text(path) as file:
        rows = [[cell.strip() for cell in row] for row in csv.reader(file) if any(cell.strip() for cell in row)]
    head, *rows = rows or [[]]
    for number, row in enumerate(rows, start=1):
        if len(row) != len(head):
            raise ValueError(f"row {number} has {len(row)} cells, and the first line {len(head)}")
    return [{name: cell for name, cell in zip(head, row, strict=True) if cell or name == "label"} for row in rows]


def _json_entries(path: Path) -> list[dict[str, Any]]:
    read = json_of(read_text(path))
    if not isinstance(read, list) or not all(isinstance(entry, dict) for entry in read):
        raise ValueError("it is not a list of objects with the keys object and label")
    return read


def _object(entry: dict[str, Any], num_objects: int, where: str) -> int:
    given = str(entry["object"])
    if not (given.isascii() and given.isdigit() and int(given) < num_objects):
        raise ArgumentError(
            f"{where}: object is {entry['object']!r}, but the view has objects 0 to {num_objects - 1}; number them as "
            "`halfseen look` does"
        )
    return int(given)


def _is_dirty(entry: dict[str, Any], where: str) -> bool | None:
    if entry["label"] not in WORDS.values():
        raise ArgumentError(f"{where}: label is {entry['label']!r}; give {', '.join(WORDS.values())}")
    return _OF_WORD[entry["label"]]


def _share(entry: dict[str, Any], where: str) -> float | None:
    given = entry.get("share_in_view")
    if given is None:
        return None
    try:
        share = float(given)
    except (TypeError, ValueError):
        share = float("nan")
    if not 0.0 <= share <= 1.0:
        raise ArgumentError(f"{where}: share_in_view is {given!r}; give a number from 0 to 1, or leave it out")
    return share
