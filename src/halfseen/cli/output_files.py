"""Files that a verb draws: refused before any work where they could not be written, or would take something's place."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from halfseen.errors import ArgumentError


def refuse_output(file: Path, what: str, endings: Sequence[str], overwrite: bool, inputs: Iterable[Path] = ()) -> None:
    """Refuse a file that could not be written, or that is not to be replaced.

    Parameters
    ----------
    file
        Where to.
    what
        What is drawn, such as ``"a picture"``.
    endings
        That its name may have.
    overwrite
        Whether a file that is there may go.
    inputs
        What is looked at; it is never replaced.

    Raises
    ------
    ArgumentError
        It has another ending, is an input, no file, there already, or in a folder that cannot be written.
    """
    from halfseen.writing import refuse_unwritable

    refuse_unwritable(file.parent)
    if file.suffix.lower() not in endings:
        raise ArgumentError(f"{file}: {what} ends in {' or '.join(endings)}; give one of these endings")
    if any(one.exists() and file.exists() and file.samefile(one) for one in inputs):
        raise ArgumentError(f"{file}: it is what is to be looked at, and is not replaced; choose another file")
    if file.is_dir():
        raise ArgumentError(f"{file}: it is a folder; give the name of a file in it")
    if file.exists() and not file.is_file():
        raise ArgumentError(f"{file}: it is a device, a pipe or the like, and not replaced; choose another file")
    if (file.exists() or file.is_symlink()) and not overwrite:
        raise ArgumentError(f"{file}: it is there already; choose another file, or pass --overwrite to replace it")
