"""A folder of a policy that is there whole or not at all, and in which no byte has changed."""

import hashlib
from pathlib import Path

from halfseen.errors import PolicyError
from halfseen.writing import left_aside, placed, refuse_taken

RECORD, ARRAYS, DIGESTS = "policy.json", "policy.safetensors", "policy.sha256"


def check_target(folder: Path, overwrite: bool) -> None:
    """Refuse a folder that a policy cannot be written to; call it before long work.

    Raises
    ------
    ArgumentError
        Something is there and shall not be replaced, or is no policy.
    """
    refuse_taken(folder, overwrite, RECORD, "policy")


def write_files(folder: Path, record: bytes, arrays: bytes, *, overwrite: bool) -> None:
    """Write the files beside `folder`, then put them in its place by renaming.

    Raises
    ------
    ArgumentError
        The folder is there already, holds something other than a policy, or cannot be written.
    """
    with placed(folder, overwrite=overwrite, marker=RECORD, kind="policy") as fresh:
        (fresh / ARRAYS).write_bytes(arrays)
        (fresh / RECORD).write_bytes(record)
        (fresh / DIGESTS).write_bytes(_digests(record, arrays))


def read_files(folder: Path) -> tuple[bytes, bytes]:
    """Read policy.json and policy.safetensors.

    Raises
    ------
    PolicyError
        The folder or a file is missing or cannot be read, or a byte of a file is not what it was.
    """
    if not folder.is_dir():
        raise PolicyError(f"{folder}: there is no such folder; {_remedy(folder)}")
    record, arrays, digests = (_read(folder / name) for name in (RECORD, ARRAYS, DIGESTS))
    if digests == _digests(record, arrays):
        return record, arrays
    changed = [name for name, data in ((RECORD, record), (ARRAYS, arrays)) if _line(name, data) not in digests]
    raise PolicyError(
        f"{folder / (changed or [DIGESTS])[0]}: it is not as it was written (its SHA-256 does not agree with "
        f"{DIGESTS}); copy the whole folder again, or learn anew"
    )


def _remedy(folder: Path) -> str:
    """What to do where no folder is."""
    aside = left_aside(folder)
    if aside is None:
        return "give the folder that `halfseen learn` wrote"
    return f"replacing it was interrupted, and what was there is {aside}: rename it back"


def _digests(record: bytes, arrays: bytes) -> bytes:
    return _line(RECORD, record) + _line(ARRAYS, arrays)


def _line(name: str, data: bytes) -> bytes:
    return f"{hashlib.sha256(data).hexdigest()}  {name}\n".encode()


def _read(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except FileNotFoundError as error:
        raise PolicyError(
            f"{file}: it is missing, so {file.parent} is no whole policy; copy the whole folder again, or learn anew"
        ) from error
    except OSError as error:
        raise PolicyError(f"{file}: it cannot be read ({error.strerror}); copy the whole folder again") from error
