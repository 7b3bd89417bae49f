"""What is done stays done: one file a repetition, whole or not there, so that a killed study goes on."""

import json
import os
import shutil
from pathlib import Path
from typing import Any

from halfseen.errors import ArgumentError

FINGERPRINT = "design.json"


def write_text(path: Path, text: str) -> None:
    """Write a file under a temporary name and rename it, so that it is never half there."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)


def as_json(value: Any) -> str:
    """The same bytes for the same value; NaN is refused."""
    return json.dumps(value, indent=1, sort_keys=True, allow_nan=False) + "\n"


class Store:
    """The folder where a study keeps its pieces.

    Parameters
    ----------
    folder
        Where the study writes.
    fingerprint
        What the pieces depend on; pieces of another study are never mixed in.
    is_resumed
        Keep the pieces that are there; otherwise begin anew.

    Raises
    ------
    ArgumentError
        The folder cannot be written, or holds pieces of another study that are to be resumed.
    """

    def __init__(self, folder: Path, fingerprint: dict[str, Any], is_resumed: bool) -> None:
        self.folder = folder
        self._pieces = folder / "progress"
        try:
            if not is_resumed and self._pieces.exists():
                shutil.rmtree(self._pieces)
            self._pieces.mkdir(parents=True, exist_ok=True)
            self._claim(as_json(fingerprint))
        except OSError as error:
            raise ArgumentError(
                f"--out {folder}: cannot be written ({error.strerror}); name a folder that you may write"
            ) from error

    def _claim(self, fingerprint: str) -> None:
        path = self._pieces / FINGERPRINT
        if path.exists() and path.read_text(encoding="utf-8") != fingerprint:
            raise ArgumentError(
                f"--resume: {self._pieces} belongs to a study of another design, seed or version; leave --resume out "
                "to begin anew, or name another --out"
            )
        write_text(path, fingerprint)

    def get(self, name: str) -> Any | None:
        """Read a piece, or None if it is not there."""
        path = self._pieces / f"{name}.json"
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None

    def put(self, name: str, value: Any) -> Any:
        """Keep a piece, and return it as it will be read."""
        text = as_json(value)
        write_text(self._pieces / f"{name}.json", text)
        return json.loads(text)
