"""What is done stays done: one file a piece, whole or not there, so that a killed study goes on.

A piece is kept with a digest of itself and of the study that it belongs to: one that was changed, or that another study
wrote into the same folder meanwhile, is refused and not believed.
"""

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.reading import NUMBERS, json_of, read_text, reason_of
from halfseen.writing import write_file

FINGERPRINT = "design.json"


def as_json(value: Any) -> str:
    """The same bytes for the same value; NaN is refused."""
    plain = json.dumps(
        value, indent=1, sort_keys=True, allow_nan=False, default=lambda array: np.asarray(array).tolist()
    )
    return plain + "\n"


class Store:
    """The folder where an experiment keeps its pieces; those of another `fingerprint` are never mixed in."""

    def __init__(self, folder: Path, fingerprint: dict[str, Any], is_resumed: bool) -> None:
        self.folder = folder
        claim, path = as_json(fingerprint), folder / FINGERPRINT
        try:
            if not is_resumed and folder.exists():
                if not path.is_file() and any(folder.iterdir()):
                    raise ArgumentError(
                        f"--out: {folder} holds no study ({FINGERPRINT} is missing), so it is not removed; name "
                        "another folder"
                    )
                shutil.rmtree(folder)
            held = read_text(path) if path.exists() else claim
        except (OSError, UnicodeDecodeError) as error:
            raise ArgumentError(
                f"--out {folder}: cannot be written ({reason_of(error)}); name a folder that you may write"
            ) from error
        if held != claim:
            raise ArgumentError(
                f"--resume: {folder} belongs to a study of another design, seed or version; leave --resume out "
                "to begin anew, or name another --out"
            )
        write_file(path, claim)
        self._claim = claim

    def has(self, name: str) -> bool:
        """Whether a piece is there."""
        return self._file(name).exists()

    def keep(self, name: str, piece: Any) -> None:
        """Keep a piece."""
        write_file(self._file(name), as_json({"piece": piece, "sha256": self._digest(piece)}))

    def read(self, name: str) -> Any:
        """Read a piece.

        Raises
        ------
        ArgumentError
            It cannot be read, was changed, or is of another study.
        """
        path = self._file(name)
        try:
            kept = json_of(read_text(path, NUMBERS))
            if not (isinstance(kept, dict) and kept.get("sha256") == self._digest(kept.get("piece"))):
                raise ValueError("it was changed, or another study wrote it")
        except (OSError, ValueError) as error:
            raise ArgumentError(
                f"--out: {path} cannot be read ({reason_of(error)}); remove it and go on with "
                "--resume: it is made again"
            ) from error
        return kept["piece"]

    def kept(self, name: str, make: Callable[[], Any]) -> Any:
        """Read a piece, which is made if it is not there; what was made is returned as it will be read."""
        if not self.has(name):
            self.keep(name, make())
        return self.read(name)

    def _digest(self, piece: Any) -> str:
        return hashlib.sha256((self._claim + as_json(piece)).encode()).hexdigest()

    def _file(self, name: str) -> Path:
        return self.folder / f"{name}.json"
