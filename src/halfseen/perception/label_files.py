"""Labels from a file, for anyone who labels by other means than colour: CSV, or JSON, an entry an object."""

import csv
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from halfseen.errors import ArgumentError
from halfseen.perception.clouds import Cloud
from halfseen.perception.labels import WORDS, Label, StainCounter, share_in_view
from halfseen.perception.view import View
from halfseen.reading import json_of, opened_text, read_text, reason_of

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
