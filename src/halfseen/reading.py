"""The one entry for bytes: input must be a regular file of bounded size, with bounded nesting.

Input is refused before it is read, with an `OSError` that names the file, or a `ValueError` without one; each reader
wraps either in its own message. The environment variable ``HALFSEEN_LARGEST_MB`` overrides the largest size of a file,
packed or unpacked.
"""

import json
import os
import re
import stat
import tomllib
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from errno import EFBIG, EINVAL
from io import BufferedReader, TextIOWrapper
from math import isfinite, prod
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from halfseen.errors import HalfseenError, LogError

LARGEST_MB = "HALFSEEN_LARGEST_MB"
"""Environment variable that overrides every bound below [MB]."""
WORDS, CLOUD, NUMBERS, TABLE = 32 * 10**6, 10**9, 4 * 10**9, 64 * 10**9
"""Most bytes of a text file (settings, labels, rules), of a cloud, of stored numbers, and of a table of a log."""
UNPACKED = 16 * 10**9
"""Most bytes of anything once unpacked."""
ALWAYS_UNPACKED, LARGEST_RATIO = 256 * 10**6, 200
"""Unpacked bytes that are always allowed; above that, at most this many times the packed size."""
MOST_LEVELS = 64
"""Deepest nesting of lists and objects."""

_SURROGATE, _SURROGATE_BYTES = re.compile(r"\\u[dD][89a-fA-F]"), re.compile(rb"\\u[dD][89a-fA-F]|\xed[\xa0-\xbf]")
_OF_PROGRAMMERS = re.compile(
    r"object has no|object of type|not (iterable|subscriptable|callable|supported between)|unhashable|NoneType|"
    r"index out of (range|bounds)|unsupported operand|broadcast|\d validation errors? for|to unpack|"
    r"positional argument|<(class|function|module) |must be (real number|str)|[Aa]ssert"
)
"""Messages that libraries address to programmers, although the cause is a broken file."""

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
_HEADERS: dict[tuple[int, int], Callable[..., Any]] = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def check_file(path: Path, most_bytes: int = WORDS) -> int:
    """Refuse a path that is no regular file, after following links, or a file that is too large; return its size [B].

    Parameters
    ----------
    path
        Path of the file.
    most_bytes
        Largest allowed size [B].

    Raises
    ------
    OSError
        The file is refused or missing, or its status cannot be read.
    """
    return _checked(path.stat(), path, most_bytes)


def opened(path: Path, most_bytes: int = WORDS) -> BufferedReader:
    """Open a regular file of at most `most_bytes`; errors as in `check_file`.

    The opened file is checked again, as another may have taken its place since; opening a pipe does not block.
    """
    check_file(path, most_bytes)
    file = os.fdopen(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)), "rb")
    try:
        _checked(os.fstat(file.fileno()), path, most_bytes)
    except OSError:
        file.close()
        raise
    return file


def opened_text(path: Path, most_bytes: int = WORDS) -> TextIOWrapper:
    """Open a regular UTF-8 file for `csv`, with its line ends unchanged; errors as in `check_file`."""
    return TextIOWrapper(opened(path, most_bytes), encoding="utf-8-sig", newline="")


def read_bytes(path: Path, most_bytes: int = WORDS) -> bytes:
    """Read a regular file of at most `most_bytes`; errors as in `check_file`.

    A file that grows in the meantime is refused, too.
    """
    with opened(path, most_bytes) as file:
        num_bytes = os.fstat(file.fileno()).st_size
        # A read allocates all of the requested size at once.
        content = file.read(num_bytes + 1)
    if len(content) > num_bytes:
        raise OSError(EINVAL, "it grows while it is read; wait until it is written", str(path))
    return content


def read_text(path: Path, most_bytes: int = WORDS) -> str:
    """Read a regular UTF-8 file, with or without a BOM; errors as in `check_file`, and UnicodeDecodeError."""
    return read_bytes(path, most_bytes).decode("utf-8-sig")


def json_of(text: str | bytes, *, any_number: bool = False) -> Any:
    r"""Read JSON with finite numbers of at most 64 bits and each name once, nested no deeper than `MOST_LEVELS`.

    With `any_number`, NaN and larger numbers are read, too, as floats. A lone surrogate, as ``\ud800``, is refused.

    Raises
    ------
    ValueError
        The text is not such JSON.
    """
    strict = {"parse_constant": _refuse_constant, "parse_int": _whole, "parse_float": _number}
    numbers: Any = {"parse_int": _of_digits} if any_number else strict
    read = _parsed(lambda: json.loads(text, object_pairs_hook=named_once, **numbers))
    check_levels(read)
    if _SURROGATE.search(text) if isinstance(text, str) else _SURROGATE_BYTES.search(text):
        _refuse_surrogates(read)
    return read


def _refuse_surrogates(read: Any) -> None:
    try:
        json.dumps(read, ensure_ascii=False).encode()
    except UnicodeEncodeError as error:
        raise ValueError(f"{error.object[error.start]!a} is half of a character, without its other half") from None


def named_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Build an object of JSON; raises ValueError if it has a name twice, of which `json` would drop one silently."""
    values = dict(pairs)
    if len(values) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{twice[:40]!r} is given twice in an object")
    return values


def toml_of(text: str) -> dict[str, Any]:
    """Read TOML nested no deeper than `MOST_LEVELS`.

    Raises
    ------
    ValueError
        The text is not such TOML.
    """
    read = _parsed(lambda: tomllib.loads(text))
    check_levels(read)
    return read


def check_levels(value: Any) -> None:
    """Refuse lists and objects that are nested deeper than `MOST_LEVELS`.

    Raises
    ------
    ValueError
        They are nested deeper.
    """
    level: list[Any] = [value]
    for _ in range(MOST_LEVELS + 1):
        within: Iterable[Any] = (
            each.values() if isinstance(each, dict) else each for each in level if isinstance(each, dict | list)
        )
        level = [child for children in within for child in children if isinstance(child, dict | list)]
        if not level:
            return
    raise ValueError(f"it is nested more than {MOST_LEVELS} levels deep")


def check_unpacked(packed_bytes: int, unpacked_bytes: int) -> None:
    """Refuse content that would take far more memory than its packed size suggests.

    Parameters
    ----------
    packed_bytes, unpacked_bytes
        Sizes before and after unpacking [B].

    Raises
    ------
    OSError
        The unpacked size is above `UNPACKED`, or above `LARGEST_RATIO` times the packed size.
    """
    asked = max(ALWAYS_UNPACKED, min(UNPACKED, LARGEST_RATIO * packed_bytes))
    if unpacked_bytes > _most(asked):
        raise OSError(EFBIG, f"unpacked, {_too_large(unpacked_bytes, asked)}")


def read_arrays(path: Path, names: Collection[str] | None = None, most_bytes: int = NUMBERS) -> dict[str, np.ndarray]:
    """Read arrays of an ``.npz`` file; sizes are checked against those that its members and their headers state.

    Parameters
    ----------
    path
        Path of the file.
    names
        Arrays to read, of those present; None for all.
    most_bytes
        Largest allowed size of the file [B].

    Raises
    ------
    OSError
        As in `check_file`; or the arrays would take far more than the file does.
    ValueError
        The file is not an ``.npz`` file, is truncated, or holds objects.
    """
    with _archive(path, most_bytes) as (archive, num_bytes):
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        wanted = {name: info for name, info in members.items() if names is None or name in names}
        check_unpacked(num_bytes, sum(info.file_size for info in wanted.values()))
        return {name: _array(archive, info) for name, info in wanted.items()}


def names_in_archive(path: Path, most_bytes: int = NUMBERS) -> list[str]:
    """Return the names of the arrays of an ``.npz`` file; errors as in `read_arrays`."""
    with _archive(path, most_bytes) as (archive, _):
        return [name.removesuffix(".npy") for name in archive.namelist()]


@contextmanager
def _archive(path: Path, most_bytes: int) -> Iterator[tuple[zipfile.ZipFile, int]]:
    """Open an ``.npz`` file; and its size [B]."""
    try:
        with opened(path, most_bytes) as file, zipfile.ZipFile(file) as archive:
            yield archive, os.fstat(file.fileno()).st_size
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise ValueError(f"cut short, or not an .npz file: {reason_of(error)}") from error


def reason_of(error: Exception) -> str:
    """Say in one short line why input could not be read.

    Parameters
    ----------
    error
        The exception, raised here or by another library.
    """
    words = getattr(error, "strerror", None) or str(error)
    line = (words.splitlines() or [type(error).__name__])[0][:200]
    if isinstance(error, KeyError) and " " not in line:
        return f"it lacks {line}"
    return "its parts do not fit together" if _OF_PROGRAMMERS.search(line) else line


@contextmanager
def refused(
    place: object,
    trouble: str,
    remedy: str,
    missing: str | None = None,
    passed: tuple[type[Exception], ...] = (HalfseenError, MemoryError),
) -> Iterator[None]:
    """Refuse input that a library cannot read; on a broken file a library may raise nearly anything.

    Raises
    ------
    LogError
        Any exception was raised except those in `passed`; `missing` is the message for a missing file.
    """
    try:
        yield
    except passed:
        raise
    except Exception as error:
        if missing is not None and isinstance(error, FileNotFoundError):
            raise LogError(f"{place}: {missing}") from error
        raise LogError(f"{place}: {trouble} ({reason_of(error)}); {remedy}") from error


def _checked(status: os.stat_result, path: Path, most_bytes: int) -> int:
    if not stat.S_ISREG(status.st_mode):
        kind = next((kind for is_kind, kind in _KINDS if is_kind(status.st_mode)), "something else")
        link = f" (the link leads to {os.path.realpath(path)})" if path.is_symlink() else ""
        raise OSError(EINVAL, f"it is {kind}, not a file{link}; give a file", str(path))
    if status.st_size > _most(most_bytes):
        raise OSError(EFBIG, _too_large(status.st_size, most_bytes), str(path))
    return status.st_size


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(info) as member:
        version = np.lib.format.read_magic(member)
        if version not in _HEADERS:
            raise ValueError(f"{info.filename} has the version {version} of its format, which is not supported")
        shape, _, dtype = _HEADERS[version](member)
        if dtype.hasobject:
            raise ValueError(f"{info.filename} holds objects; only plain arrays are read, never pickled objects")
        if member.tell() + prod(shape) * dtype.itemsize != info.file_size:
            raise ValueError(f"{info.filename} announces {dtype} of shape {shape}, but holds {info.file_size} bytes")
    with archive.open(info) as member:
        return np.lib.format.read_array(member, allow_pickle=False)


def _parsed(parse: Callable[[], Any]) -> Any:
    try:
        return parse()
    except RecursionError:
        raise ValueError(f"it is nested more than {MOST_LEVELS} levels deep") from None


def _of_digits(digits: str) -> int | float:
    return int(digits) if len(digits) <= 20 and -(2**63) <= int(digits) < 2**64 else float(digits)


def _whole(digits: str) -> int | float:
    if isinstance(number := _of_digits(digits), float):
        raise ValueError(f"{digits[:24]}… is not a 64-bit whole number")
    return number


def _number(digits: str) -> float:
    number = float(digits)
    return number if isfinite(number) else _refuse_constant(digits[:24])


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a JSON number")


def _most(most_bytes: int) -> int:
    given = os.environ.get(LARGEST_MB, "")
    return int(given) * 10**6 if given.isascii() and given.isdigit() else most_bytes


def _too_large(num_bytes: int, most_bytes: int) -> str:
    return (
        f"it has {num_bytes / 1e6:,.0f} MB, and at most {_most(most_bytes) / 1e6:,.0f} MB are read; give a smaller "
        f"one, or set {LARGEST_MB} to allow it"
    )
