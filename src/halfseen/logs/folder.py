"""Logs on disk: a folder of Parquet files that is there whole or not at all, or the journal of a recorder.

::

    FOLDER/
      logs.json          format, version, the number of rows of each table and, if somebody said, the unit of rewards
      stages.parquet
      trajectories.parquet
      objects.parquet    where the stages have objects

What a Parquet file takes once it is read is asked before the library that reads it is: that ends the process where some
of what it would say of a column is broken. So the footer is read here. It is a struct of Thrift's compact protocol: a
number for each field, and a value for it.
"""

import json
import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from operator import index
from pathlib import Path
from struct import unpack
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute
import pyarrow.parquet as pq

from halfseen.errors import HalfseenError, LogError, within
from halfseen.logs.columns import checked_unit, converting, frame_of
from halfseen.logs.journal import is_journal
from halfseen.logs.missing import Filling
from halfseen.logs.recorded import journal_log
from halfseen.reading import (
    ALWAYS_UNPACKED,
    MOST_LEVELS,
    TABLE,
    WORDS,
    check_file,
    check_unpacked,
    json_of,
    read_text,
    reason_of,
)
from halfseen.writing import placed

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
    footer = _Footer(_footer_bytes(file))
    try:
        groups = footer.struct().get(_ROW_GROUPS, [])
        columns = [[chunk[_META_DATA] for chunk in group[_COLUMNS]] for group in groups]
        chunks = [[Chunk(index(of[_NUM_VALUES]), index(of[_UNCOMPRESSED])) for of in group] for group in columns]
    except (IndexError, KeyError, TypeError, AttributeError) as error:
        raise ValueError("its footer is broken") from error
    if any(number < 0 for group in chunks for chunk in group for number in chunk):
        raise ValueError("its footer counts fewer than no values")
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


BYTES_OF_VALUE = 8

compute: Any = pyarrow.compute


def check_unpacked_table(file: Path, num_bytes: int, opened: pq.ParquetFile) -> None:
    """Refuse a Parquet file that would take far more memory than its size tells.

    Parameters
    ----------
    file, num_bytes
        The file, and its size [B].
    opened
        The same, opened.

    Raises
    ------
    OSError
        As `halfseen.reading.check_unpacked`.
    ValueError
        Its footer is broken.
    """
    groups = chunks_of(file)
    if any(len(group) != opened.metadata.num_columns for group in groups):
        raise ValueError("its footer tells of other columns than its schema")
    check_unpacked(num_bytes, _bytes_of_values(groups, opened.schema))
    check_unpacked(num_bytes, bytes_of_texts(groups, file, opened))


def _bytes_of_values(groups: list[list[Chunk]], schema: pq.ParquetSchema) -> int:
    """At least what it takes [B]: by its values, as repeated ones take next to nothing."""
    sizes = [max(BYTES_OF_VALUE, schema.column(k).length) for k in range(len(schema))]
    return sum(
        max(chunk.num_bytes, size * chunk.num_values)
        for group in groups
        for size, chunk in zip(sizes, group, strict=True)
    )


def bytes_of_texts(groups: list[list[Chunk]], file: Path, opened: pq.ParquetFile) -> int:
    """What its texts take [B], where that could be much.

    A text that is stored once may stand in every row, so it is counted as often. Of a text no more is held meanwhile
    than is stored.
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
    """What texts take that are stored once each, at the bottom of lists and structs [B]."""
    kind = values.type
    if pa.types.is_dictionary(kind):
        lengths = compute.binary_length(values.dictionary).fill_null(0).to_numpy(zero_copy_only=False)
        counts = np.bincount(values.indices.drop_null().to_numpy(), minlength=len(lengths))
        return int(counts @ lengths.astype(np.int64))
    if pa.types.is_struct(kind):
        return sum(map(_bytes_as_often, values.flatten()))
    return _bytes_as_often(values.flatten()) if pa.types.is_nested(kind) else values.nbytes


Place = Any
"""A `Path`, or what does the same in a store (``UPath``)."""


def place_of(address: str | Path | Place) -> Place:
    """Find a folder by its path or its address.

    Parameters
    ----------
    address
        A path, or an address that ``fsspec`` knows how to open.

    Raises
    ------
    LogError
        There is no such kind of store, or what opens it is not installed.
    """
    if not isinstance(address, str) or not is_remote(address):
        return address if not isinstance(address, str) else Path(address)
    # A store needs a library that nothing else does.
    from upath import UPath

    try:
        place = UPath(address)
        place.fs  # noqa: B018 - what opens the store loads here
    except (ImportError, ValueError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise LogError(f"{address}: it cannot be opened ({reason}); install that, or copy the folder here") from error
    return place


def is_remote(address: str) -> bool:
    """Whether it is the address of a store."""
    return "://" in address


@contextmanager
def asking(place: Place) -> Iterator[None]:
    """Tell what a store answers, whatever its library raises, in one line with the place.

    Raises
    ------
    LogError
        The store refused, or was not reached.
    """
    try:
        yield
    except (HalfseenError, FileNotFoundError):
        raise
    except Exception as error:
        if isinstance(place, Path):
            raise
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise LogError(f"{place}: the store did not answer ({reason}); check the address and your access") from error


MANIFEST = "logs.json"
FORMAT, VERSION = "halfseen-logs", 2
TABLES = ("stages", "trajectories", "objects")
FOREIGN_TABLES = (".csv", ".tsv", ".txt", ".parquet")
"""Files of other programs, of which `halfseen convert` makes logs by a mapping."""
ROWS_IN_GROUP = 65_536
"""Rows that are read at once by anyone who wants one of them."""


class Folder(NamedTuple):
    """A folder of Parquet files, as its manifest describes it."""

    place: Place
    num_rows: dict[str, int]
    """Of each table."""
    reward_unit: str | None
    """What rewards are counted in; None if nobody has said."""
    filling: Filling | None = None
    """What stands for covariates of the stages that are null; None where null is refused."""

    def opened(self, name: str) -> pq.ParquetFile:
        """Open a table.

        Raises
        ------
        LogError
            The file is missing, broken, or has another number of rows.
        """
        file = self.place / f"{name}.parquet"
        try:
            # Not read_table, which makes columns of a folder that is called a=b.
            with asking(self.place):
                if isinstance(file, Path):
                    num_bytes = check_file(file, TABLE)
                    opened = pq.ParquetFile(file)
                    check_unpacked_table(file, num_bytes, opened)
                else:
                    opened = pq.ParquetFile(file.open("rb"))
        except FileNotFoundError as error:
            raise LogError(f"{file}: it is missing; copy the whole folder, or write the logs again") from error
        except MemoryError:
            raise
        except Exception as error:  # a broken file raises nearly anything
            raise broken_table(file, error) from error
        if opened.metadata.num_rows != self.num_rows[name]:
            raise LogError(
                f"{file}: it has {opened.metadata.num_rows} rows where {MANIFEST} counts {self.num_rows[name]}; files "
                "of two logs are mixed: write the logs again"
            )
        return opened

    def batches(self, name: str, columns: list[str] | None = None) -> Iterator[pa.RecordBatch]:
        """Read some columns of a table, or all, batch by batch.

        Raises
        ------
        LogError
            The file is missing or broken.
        """
        file = self.opened(name)
        try:
            yield from (batch for batch in file.iter_batches(ROWS_IN_GROUP, columns=columns) if len(batch))
        except (OSError, pa.ArrowException) as error:
            raise broken_table(self.place / f"{name}.parquet", error) from error


def read_folder(folder: Place) -> dict[str, Any]:
    """Read what `Logs` is made of, by name, whether `Logs.write` or a `LogRecorder` wrote the folder.

    Raises
    ------
    LogError
        The folder or one of its files is missing, broken or of another version.
    """
    is_here = isinstance(folder, Path)
    if is_here and not (folder / MANIFEST).exists() and is_journal(folder):
        return journal_log(folder)
    described = read_manifest(folder)
    tables: dict[str, Any] = {}
    for name in described.num_rows:
        try:
            tables[name] = frame_of(described.opened(name).read())
        except (HalfseenError, MemoryError):
            raise
        except Exception as error:  # pandas' own words in a broken file raise nearly anything
            raise broken_table(folder / f"{name}.parquet", error) from error
        # What was read is as large again as the table, and Arrow would keep the room.
        pa.default_memory_pool().release_unused()
    return {**tables, "reward_unit": described.reward_unit}


def write_tables(
    folder: Path, tables: Mapping[str, pd.DataFrame], *, overwrite: bool, reward_unit: str | None = None
) -> None:
    """Write tables beside `folder`, then put them in its place by renaming.

    Parameters
    ----------
    folder
        Where to.
    tables
        The tables by name.
    overwrite
        Replace logs that are already there.
    reward_unit
        What rewards are counted in; None if nobody has said.

    Raises
    ------
    ArgumentError
        The folder exists, holds something other than logs, or cannot be written.
    """
    with placed(folder, overwrite=overwrite, marker=MANIFEST) as fresh:
        for name, table in tables.items():
            arrow = pa.Table.from_pandas(table, preserve_index=False)
            pq.write_table(arrow, fresh / f"{name}.parquet", ROWS_IN_GROUP, compression="zstd")
        write_manifest(Folder(fresh, {name: len(table) for name, table in tables.items()}, reward_unit))


def write_manifest(folder: Folder) -> None:
    """Write down how many rows each table of a folder has, and the unit of rewards if there is one."""
    manifest: dict[str, Any] = {"format": FORMAT, "version": VERSION, "rows": folder.num_rows}
    if folder.reward_unit is not None:
        manifest["reward_unit"] = folder.reward_unit
    (folder.place / MANIFEST).write_text(json.dumps(manifest, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def read_manifest(folder: Place) -> Folder:
    """Read how many rows each table of a folder has, and the unit of rewards.

    Raises
    ------
    LogError
        The folder holds no logs or those of another version, or the unit is no short text.
    """
    file = folder / MANIFEST
    with asking(folder):
        is_there = folder.is_dir()
    if isinstance(folder, Path) and folder.is_file():
        is_table, line = (
            folder.suffix in FOREIGN_TABLES,
            f"halfseen convert {shlex.quote(str(folder))} --mapping-template --out cell.toml",
        )
        remedy = f"make a mapping of it: {line}" if is_table else "`halfseen convert --help` says which files are read"
        raise LogError(f"{folder}: it is a file, and no folder of logs; {remedy}")
    if not is_there:
        raise LogError(
            f"{folder}: there is no such folder; give the folder that Logs.write or `halfseen simulate` wrote"
        )
    try:
        with asking(folder):
            manifest = json_of(read_text(file) if isinstance(file, Path) else file.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise LogError(
            f"{file}: it is missing, so {folder} holds no logs; give a folder that Logs.write wrote"
        ) from error
    except (OSError, ValueError) as error:
        raise LogError(f"{file}: it cannot be read ({reason_of(error)}); write the logs again") from error
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise LogError(f"{file}: it does not describe logs; give a folder that Logs.write wrote")
    if manifest.get("version") != VERSION:
        raise LogError(
            f"{file}: version {repr(manifest.get('version'))[:40]} is not the {VERSION} that this halfseen reads; "
            + (converting(folder) if manifest.get("version") == 1 else "read it with the halfseen that wrote it")
        )
    with within(file):
        unit = checked_unit(manifest.get("reward_unit"))
    rows: Any = manifest.get("rows")
    is_right = isinstance(rows, dict) and {"stages", "trajectories"} <= set(rows) <= set(TABLES)
    is_right = is_right and all(isinstance(num, int) and num >= 0 for num in rows.values())
    if not is_right:
        raise LogError(f"{file}: rows {repr(rows)[:80]} does not count stages and trajectories; write the logs again")
    return Folder(folder, rows, unit)


def broken_table(file: Place, error: Exception) -> LogError:
    """Say that a table cannot be read, and why."""
    return LogError(f"{file}: it is no whole Parquet file ({reason_of(error)}); copy it again, or write the logs again")
