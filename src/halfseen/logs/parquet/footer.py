"""What the footer of a Parquet file says of its columns, read without the library that reads the rest.

That library ends the process where some of what it would tell of a column is broken. The footer is a
struct of Thrift's compact protocol: a number for each field, and a value for it.
"""

from collections.abc import Iterator
from operator import index
from pathlib import Path
from struct import unpack
from typing import Any, NamedTuple

from halfseen.reading import MOST_LEVELS, WORDS

MAGIC = b"PAR1"
_ROW_GROUPS, _COLUMNS, _META_DATA, _NUM_VALUES, _UNCOMPRESSED = 4, 1, 3, 5, 6
"""Numbers of fields: in the file, a row group, a chunk of a column, and what is told of it."""


class Chunk(NamedTuple):
    """What a row group holds of a column."""

    num_values: int
    """Nulls, and those of lists, included."""
    num_bytes: int
    """Once it is unpacked [B]."""


def chunks_of(file: Path) -> list[list[Chunk]]:
    """Give the chunks of each row group, in the order of the columns.

    Parameters
    ----------
    file
        A Parquet file.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        It has no footer, or one that is broken or encrypted.
    """
    footer = _Footer(_bytes(file))
    try:
        groups = footer.struct().get(_ROW_GROUPS, [])
        told = [[chunk[_META_DATA] for chunk in group[_COLUMNS]] for group in groups]
        chunks = [[Chunk(index(of[_NUM_VALUES]), index(of[_UNCOMPRESSED])) for of in group] for group in told]
    except (IndexError, KeyError, TypeError, AttributeError) as error:
        raise ValueError("its footer is broken") from error
    if any(number < 0 for group in chunks for chunk in group for number in chunk):
        raise ValueError("its footer counts fewer than no values")
    return chunks


def _bytes(file: Path) -> bytes:
    with file.open("rb") as stream:
        end = stream.seek(0, 2)
        stream.seek(max(end - 8, 0))
        tail = stream.read(8)
        num_bytes = unpack("<I", tail[:4])[0] if tail[4:] == MAGIC else end
        if num_bytes > min(end - 8, WORDS):
            raise ValueError("its footer is missing or too large")
        stream.seek(end - 8 - num_bytes)
        return stream.read(num_bytes)


class _Footer:
    """Values of the compact protocol, one after the other."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._at = 0
        self._level = 0

    def struct(self) -> dict[int, Any]:
        """Fields by their numbers."""
        return dict(self._fields())

    def _fields(self) -> Iterator[tuple[int, Any]]:
        self._level += 1
        if self._level > MOST_LEVELS:
            raise ValueError("its footer is nested too deep")
        number = 0
        while header := self._byte():
            step, kind = header >> 4, header & 15
            number = number + step if step else self._signed()
            yield number, kind == 1 if kind in (1, 2) else self._value(kind)
        self._level -= 1

    def _value(self, kind: int) -> Any:
        if kind in (1, 2, 3):
            return self._byte()
        if kind in (4, 5, 6):
            return self._signed()
        if kind == 7:
            return unpack("<d", self._taken(8))[0]
        if kind == 8:
            return self._taken(self._whole())
        if kind in (9, 10):
            header = self._byte()
            size = header >> 4 if header < 0xF0 else self._whole()
            return [self._value(header & 15) for _ in range(size)]
        if kind == 11:
            size = self._whole()
            kinds = self._byte() if size else 0
            return [(self._value(kinds >> 4), self._value(kinds & 15)) for _ in range(size)]
        if kind == 12:
            return self.struct()
        raise ValueError(f"its footer has a value of a kind {kind}, which there is not")

    def _byte(self) -> int:
        self._at += 1
        return self._content[self._at - 1]

    def _taken(self, num_bytes: int) -> bytes:
        if num_bytes > len(self._content) - self._at:
            raise IndexError(num_bytes)
        self._at += num_bytes
        return self._content[self._at - num_bytes : self._at]

    def _whole(self) -> int:
        number, shift = 0, 0
        while (byte := self._byte()) & 0x80:
            number |= (byte & 0x7F) << shift
            shift += 7
            if shift > 63:
                raise ValueError("its footer has a number of more than 64 bits")
        return number | byte << shift

    def _signed(self) -> int:
        number = self._whole()
        return number >> 1 ^ -(number & 1)
