"""Parquet files of logs: writing a folder of them all or nothing, and bounding a file's memory before reading it.

Some broken column metadata make the Parquet library abort the process. So the footer is parsed here first: a struct of
Thrift's compact protocol, with a number and a value for each field.
"""

import json
from collections.abc import Mapping
from operator import index
from pathlib import Path
from struct import unpack
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute
import pyarrow.parquet as pq

from halfseen.reading import ALWAYS_UNPACKED, MOST_LEVELS, TABLE, WORDS, check_file, check_unpacked
from halfseen.writing import placed

MANIFEST = "logs.json"
FORMAT, VERSION = "halfseen-logs", 2
TABLES = ("stages", "trajectories", "objects")
ROWS_IN_GROUP = 65_536
"""Rows of a row group, which is read as a whole."""


def write_tables(
    folder: Path, tables: Mapping[str, pd.DataFrame], *, overwrite: bool, reward_unit: str | None = None
) -> None:
    """Write tables beside `folder`, then rename them into place.

    Raises
    ------
    ArgumentError
        The folder exists, holds something other than logs, or cannot be written.
    """
    with placed(folder, overwrite=overwrite, marker=MANIFEST) as fresh:
        for name, table in tables.items():
            arrow = pa.Table.from_pandas(table, preserve_index=False)
            pq.write_table(arrow, fresh / f"{name}.parquet", ROWS_IN_GROUP, compression="zstd")
        write_manifest(fresh, {name: len(table) for name, table in tables.items()}, reward_unit)


def write_manifest(folder: Path, num_rows: Mapping[str, int], reward_unit: str | None) -> None:
    """Write the number of rows of each table of a folder, and the unit of rewards if there is one."""
    manifest: dict[str, Any] = {"format": FORMAT, "version": VERSION, "rows": num_rows}
    manifest |= {} if reward_unit is None else {"reward_unit": reward_unit}
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


MAGIC = b"PAR1"
_ROW_GROUPS, _COLUMNS, _META_DATA, _NUM_VALUES, _UNCOMPRESSED = 4, 1, 3, 5, 6
"""Field numbers: in the file, in a row group, in a column chunk, and two in its metadata."""


class Chunk(NamedTuple):
    """Values of a column in a row group."""

    num_values: int
    """Number of values, including nulls and items of lists."""
    num_bytes: int
    """Uncompressed size [B]."""


def chunks_of(file: Path) -> list[list[Chunk]]:
    """Column chunks of each row group, in the order of the columns.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        The footer is missing, broken or encrypted.
    """
    footer = _Footer(_footer_bytes(file))
    try:
        groups = footer.struct().get(_ROW_GROUPS, [])
        columns = [[chunk[_META_DATA] for chunk in group[_COLUMNS]] for group in groups]
        chunks = [[Chunk(index(of[_NUM_VALUES]), index(of[_UNCOMPRESSED])) for of in group] for group in columns]
    except (IndexError, KeyError, TypeError, AttributeError) as error:
        raise ValueError("its footer is broken") from error
    if any(number < 0 for group in chunks for chunk in group for number in chunk):
        raise ValueError("its footer has a negative number of values")
    return chunks


def _footer_bytes(file: Path) -> bytes:
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
    """Sequential reader of values in the compact protocol."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._at = 0
        self._level = 0

    def struct(self) -> dict[int, Any]:
        """Read a struct: its fields by number."""
        self._level += 1
        if self._level > MOST_LEVELS:
            raise ValueError("its footer is nested too deep")
        fields, number = {}, 0
        while header := self._byte():
            step, kind = header >> 4, header & 15
            number = number + step if step else self._signed()
            fields[number] = kind == 1 if kind in (1, 2) else self._value(kind)
        self._level -= 1
        return fields

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
        raise ValueError(f"its footer has a value of unknown kind {kind}")

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


BYTES_OF_VALUE = 8

compute: Any = pyarrow.compute


def parquet_file(file: Path) -> pq.ParquetFile:
    """Open a Parquet file, unless it is too large or would take far more memory than its size suggests.

    Raises
    ------
    OSError
        As `halfseen.reading.check_file` and `halfseen.reading.check_unpacked`.
    ValueError
        Its footer is broken.
    """
    num_bytes = check_file(file, TABLE)
    opened, groups = pq.ParquetFile(file), chunks_of(file)
    if any(len(group) != opened.metadata.num_columns for group in groups):
        raise ValueError("its footer and its schema have different columns")
    check_unpacked(num_bytes, _bytes_of_values(groups, opened.schema))
    check_unpacked(num_bytes, bytes_of_texts(groups, file, opened))
    return opened


def _bytes_of_values(groups: list[list[Chunk]], schema: pq.ParquetSchema) -> int:
    """Lower bound of a file's memory [B] from its number of values: repeated values compress to almost nothing."""
    sizes = [max(BYTES_OF_VALUE, schema.column(k).length) for k in range(len(schema))]
    return sum(
        max(chunk.num_bytes, size * chunk.num_values)
        for group in groups
        for size, chunk in zip(sizes, group, strict=True)
    )


def bytes_of_texts(groups: list[list[Chunk]], file: Path, opened: pq.ParquetFile) -> int:
    """Memory of the texts of a file [B], counted only for columns where it could be large.

    A text that is stored once may occur in every row, so it is counted once per row. Counting holds each text only as
    often as it is stored.
    """
    schema = opened.schema
    texts = [k for k in range(len(schema)) if schema.column(k).physical_type == "BYTE_ARRAY"]
    num_bytes = 0
    for k in texts:
        if sum(group[k].num_values * group[k].num_bytes for group in groups) > ALWAYS_UNPACKED:
            column = schema.column(k).path
            stored = pq.ParquetFile(file, read_dictionary=[column], metadata=opened.metadata)
            for number in range(len(groups)):
                num_bytes += sum(map(_bytes_as_often, stored.read_row_group(number, [column]).column(0).chunks))
    return num_bytes


def _bytes_as_often(values: pa.Array) -> int:
    """Memory of dictionary-encoded texts, inside lists and structs, too [B]."""
    kind = values.type
    if pa.types.is_dictionary(kind):
        lengths = compute.binary_length(values.dictionary).fill_null(0).to_numpy(zero_copy_only=False)
        counts = np.bincount(values.indices.drop_null().to_numpy(), minlength=len(lengths))
        return int(counts @ lengths.astype(np.int64))
    if pa.types.is_struct(kind):
        return sum(map(_bytes_as_often, values.flatten()))
    return _bytes_as_often(values.flatten()) if pa.types.is_nested(kind) else values.nbytes
