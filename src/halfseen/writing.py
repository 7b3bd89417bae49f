"""A folder that is there whole or not at all: written under another name, then renamed."""

import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from halfseen.errors import ArgumentError


@contextmanager
def placed(target: Path, *, overwrite: bool = False, marker: str | None = None, kind: str = "logs") -> Iterator[Path]:
    """Give an empty folder to write into, and put it at `target` once all went well.

    Parameters
    ----------
    target
        Where the folder goes; missing parents are made.
    overwrite
        Replace what is there, if it holds `marker`.
    marker
        A file that every folder of this kind holds.
    kind
        What such a folder holds, for the message.

    Raises
    ------
    ArgumentError
        Something is there already and is not to be replaced, or the folder cannot be written.
    """
    refuse_taken(target, overwrite, marker, kind)
    place = target.absolute()
    tag = uuid.uuid4().hex
    fresh, old = place.with_name(f".{place.name}.{tag}.new"), place.with_name(f".{place.name}.{tag}.old")
    try:
        fresh.mkdir(parents=True)
        yield fresh
        _swap(fresh, place, old)
    except OSError as error:
        raise ArgumentError(
            f"{target}: cannot be written ({error.strerror or error}); choose another folder"
        ) from error
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def refuse_taken(target: Path, overwrite: bool, marker: str | None, kind: str) -> None:
    """Refuse a target where something is that is not to be replaced; to be called before long work, too.

    Raises
    ------
    ArgumentError
        It is there and `overwrite` is False, or it does not hold `marker`.
    """
    try:
        is_there = target.exists() or target.is_symlink()
        is_ours = marker is not None and (target / marker).exists()
    except OSError as error:
        raise ArgumentError(f"{target}: cannot be written ({error.strerror}); choose another folder") from error
    if is_there and not overwrite:
        raise ArgumentError(
            f"{target}: it is there already; choose another folder, or pass --overwrite (overwrite=True) to replace it"
        )
    if is_there and not is_ours:
        raise ArgumentError(
            f"{target}: it holds no {kind} ({marker} is missing), so it is not replaced; choose another folder"
        )


def _swap(fresh: Path, target: Path, old: Path) -> None:
    """Put `fresh` in the place of `target`; what was there comes back if that fails."""
    if not target.exists():
        fresh.rename(target)
        return
    target.rename(old)
    try:
        fresh.rename(target)
    except OSError:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)
