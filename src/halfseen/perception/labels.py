"""Labels: which objects look dirty, from the colours in view of each, or from a file; and how much of each was in view.

A file, CSV or JSON with an entry an object, is for anyone who labels by other means than colour.
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


KEYS = ("object", "label", "share_in_view")
_OF_WORD = {word: is_dirty for is_dirty, word in WORDS.items()}


@dataclass(frozen=True)
class LabelFile:
    """Labels objects as a file says (a `Labeller`); what was in view it takes from the view, unless the file says.

    Parameters
    ----------
    path
        As `read_labels` takes it.
    """

    path: Path

    def __call__(self, view: View, cloud: Cloud) -> tuple[Label, ...]:
        """Label each object of a view as the file says."""
        labels = read_labels(self.path, len(view.objects))
        return tuple(
            replace(label, share_in_view=share_in_view(seen)) if label.share_in_view is None else label
            for seen, label in zip(view.objects, labels, strict=True)
        )


def labels_of(view: View, cloud: Cloud, file: Path | None = None) -> Sequence[Label] | None:
    """Label what is seen: as a file says, else by colour; None where there is neither.

    Parameters
    ----------
    view, cloud
        The cloud, and what was seen in it.
    file
        Labels, as `read_labels` takes them.

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
        ``.csv`` with columns ``object``, ``label`` (dirty, clean or unknown) and, if wanted, ``share_in_view``, in
        [0, 1]; or ``.json``, a list of objects with these keys.
    num_objects
        How many objects there are.

    Returns
    -------
    tuple of Label
        In the order of the objects.

    Raises
    ------
    ArgumentError
        The file cannot be read, or a row is wrong, missing or there twice; file and row are named.
    """
    path = Path(path)
    labels: dict[int, Label] = {}
    for number, entry in enumerate(_entries(path), start=1):
        where = f"{path}: row {number}"
        which = _object(entry, num_objects, where)
        if which in labels:
            raise ArgumentError(f"{where}: object {which} is labelled before; give one row an object")
        labels[which] = Label(_is_dirty(entry, where), _share(entry, where))
    missing = [which for which in range(num_objects) if which not in labels]
    if missing:
        raise ArgumentError(
            f"{path}: object {missing[0]} of {num_objects} has no label; give one row an object, 'unknown' where "
            "nothing can be said"
        )
    return tuple(labels[which] for which in range(num_objects))


def _entries(path: Path) -> list[dict[str, Any]]:
    reader = {".csv": _csv_entries, ".json": _json_entries}.get(path.suffix.lower())
    if reader is None:
        raise ArgumentError(f"{path}: labels are a file that ends in .csv or .json")
    try:
        entries = reader(path)
    except (OSError, ValueError, RecursionError, csv.Error) as error:
        raise ArgumentError(f"{path}: it cannot be read as labels ({reason_of(error)})") from error
    for number, entry in enumerate(entries, start=1):
        if not {"object", "label"} <= set(entry) <= set(KEYS):
            raise ArgumentError(
                f"{path}: row {number} has {', '.join(map(str, entry)) or 'nothing'}; it has object, label and, if "
                "wanted, share_in_view, and nothing else"
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
        raise ValueError("it is no list of objects with the keys object and label")
    return read


def _object(entry: dict[str, Any], num_objects: int, where: str) -> int:
    given = str(entry["object"])
    if not (given.isascii() and given.isdigit() and int(given) < num_objects):
        raise ArgumentError(
            f"{where}: object is {entry['object']!r}, and the view has objects 0 to {num_objects - 1}; number them as "
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
        raise ArgumentError(f"{where}: share_in_view is {given!r}; it is a number from 0 to 1, or left out")
    return share
