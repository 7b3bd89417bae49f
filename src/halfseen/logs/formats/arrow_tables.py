"""Tables of Parquet, CSV and Arrow files that others wrote, as arrays with a row a step; sizes are checked first."""

import mmap
import re
import struct
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as arrow_csv
import pyarrow.parquet as pq

from halfseen.errors import HalfseenError, LogError
from halfseen.logs.columns import shown
from halfseen.logs.formats.column_types import from_list_texts
from halfseen.logs.parquet import check_unpacked_table
from halfseen.reading import MOST_LEVELS, TABLE, check_file, check_unpacked, opened, reason_of
from halfseen.shapes import Shaped

PARQUET, CSV, ARROW = (".parquet",), (".csv",), (".arrow", ".feather")
TABLE_FILES = PARQUET + CSV + ARROW
_COMPRESSED = re.compile(rb"\x28\xb5\x2f\xfd|\x04\x22\x4d\x18", re.DOTALL)
"""How a buffer begins that Arrow packed, by zstd or lz4; eight bytes before say how large it is unpacked."""


def read_tables(files: Sequence[Path], columns: Iterable[str] | None = None) -> pa.Table:
    """Read files of one table, one below the other.

    Parameters
    ----------
    files
        Parquet, CSV or Arrow (Feather) by their endings.
    columns
        Which columns are read of a Parquet file; None for all.

    Raises
    ------
    LogError
        A file is missing, broken, too large, or has other columns than the first; or there is no row in any.
    """
    wanted = None if columns is None else list(columns)
    tables = [_read(file, wanted) for file in files]
    for file, table in zip(files, tables, strict=True):
        if not table.schema.equals(tables[0].schema):
            differing = set(table.schema) ^ set(tables[0].schema)
            names = ", ".join(sorted({field.name for field in differing})) or "other orders"
            raise LogError(
                f"{file}: its columns are not those of {files[0]} ({names}); give files of one table, or convert each "
                "alone"
            )
    if not any(table.num_rows for table in tables):
        raise LogError(f"{', '.join(map(str, files[:3]))}: there is no row; give a table with one at least")
    return pa.concat_tables(tables)


def names_in(file: Path) -> list[str]:
    """Name the columns of a Parquet file.

    Raises
    ------
    LogError
        It is missing or broken.
    """
    return [str(name) for name in _wrapped(file, lambda: _parquet(file).schema_arrow.names)]


def flattened(place: str, table: pa.Table) -> pa.Table:
    """Take structs apart into columns of their own, named ``outer.inner``.

    Parameters
    ----------
    place
        What to call the table in messages.
    table
        As it was read.

    Raises
    ------
    LogError
        Two columns have the same name then.
    """
    for _ in range(MOST_LEVELS):
        if not any(pa.types.is_struct(kind) for kind in table.schema.types):
            break
        table = table.flatten()
    _refuse_repeated(place, table.column_names)
    return table


def as_array(place: str, table: pa.Table, name: str) -> Shaped[np.ndarray, "N ..."]:
    """Bring a column into an array with a row a step; lists of one length become further axes.

    Null is NaN among numbers and None among text.

    Parameters
    ----------
    place
        What to call the table in messages.
    table
        Where the column is.
    name
        Of the column.

    Raises
    ------
    LogError
        Lists differ in length, one is missing, or the column is of a type that no array holds.
    """
    try:
        return _array(place, name, table[name].combine_chunks())
    except (pa.ArrowException, ValueError, NotImplementedError) as error:
        raise LogError(
            f"{place}: {name} holds {table.schema.field(name).type}, which is not read; convert it"
        ) from error


def _array(place: str, name: str, values: Any) -> np.ndarray:
    if isinstance(values, pa.ChunkedArray):
        values = values.chunk(0) if values.num_chunks else pa.array([], values.type)
    if isinstance(values, pa.ExtensionArray):
        values = values.storage
    kind = values.type
    if pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind):
        lengths = np.array(values.value_lengths().fill_null(-1))
        wrong = (lengths != lengths[:1]) | (lengths == -1)
        if wrong.any():
            row = int(np.argmax(wrong))
            found = "null" if lengths[row] == -1 else f"{lengths[row]} values where row 0 has {lengths[0]}"
            raise LogError(f"{place}, row {row}: {name} has {found}; give every step as many")
        inner = _array(place, name, values.flatten())
        return inner.reshape(len(lengths), int(lengths[0]) if len(lengths) else 0, *inner.shape[1:])
    if pa.types.is_dictionary(kind):
        values = values.dictionary_decode()
    if pa.types.is_decimal(values.type):
        values = values.cast(pa.float64())
    if pa.types.is_string(values.type) or pa.types.is_large_string(values.type) or pa.types.is_null(values.type):
        return np.array(values.to_pylist(), dtype=object)
    return values.to_numpy(zero_copy_only=False)


def _read(file: Path, columns: list[str] | None) -> pa.Table:
    if file.suffix in PARQUET:
        table = _wrapped(file, lambda: _parquet(file).read(columns))
    elif file.suffix in CSV:
        table = _wrapped(file, lambda: _csv(file))
    else:
        table = _wrapped(file, lambda: _arrow(file))
    missing = [name for name in columns or () if name not in table.column_names]
    if missing:
        raise LogError(
            f"{file}: there is no column {missing[0]!r} among {', '.join(table.column_names)}; copy it again"
        )
    _refuse_repeated(str(file), table.column_names)
    return table.replace_schema_metadata(None)


def _refuse_repeated(place: str, names: list[str]) -> None:
    counted = Counter(names)
    if len(counted) < len(names):
        raise LogError(f"{place}: there are two columns {shown(counted.most_common(1)[0][0])}; drop or rename one")


def _parquet(file: Path) -> pq.ParquetFile:
    num_bytes = check_file(file, TABLE)
    table = pq.ParquetFile(file)
    check_unpacked_table(file, num_bytes, table)
    return table


def _csv(file: Path) -> pa.Table:
    with opened(file, TABLE) as bytes_in:
        table = arrow_csv.read_csv(
            bytes_in,
            read_options=arrow_csv.ReadOptions(use_threads=False),
            parse_options=arrow_csv.ParseOptions(newlines_in_values=True),
            convert_options=arrow_csv.ConvertOptions(
                null_values=[""], strings_can_be_null=True, quoted_strings_can_be_null=False
            ),
        )
    lists = {name: from_list_texts(table[name]) for name in table.column_names}
    return pa.table({name: table[name] if lists[name] is None else lists[name] for name in table.column_names})


def _arrow(file: Path) -> pa.Table:
    num_bytes = check_file(file, TABLE)
    with file.open("rb") as held, mmap.mmap(held.fileno(), 0, access=mmap.ACCESS_READ) as content:
        check_unpacked(num_bytes, _unpacked(content))
        is_file = content[:6] == b"ARROW1"
    try:
        with pa.OSFile(str(file)) as source:
            table = (pa.ipc.open_file if is_file else pa.ipc.open_stream)(source).read_all()
    except MemoryError as error:
        raise OSError(f"it asks for more memory than there is: {error}") from error
    table.validate(full=True)
    return table


def _unpacked(content: mmap.mmap) -> int:
    """What the packed buffers of an Arrow file say that they take unpacked [B]."""
    found = [match.start() for match in _COMPRESSED.finditer(content) if match.start() >= 8]
    sizes = [struct.unpack_from("<q", content, start - 8)[0] for start in found if start % 8 == 0]
    return sum(size for size in sizes if size > 0)


def _wrapped(file: Path, read: Any) -> Any:
    try:
        return read()
    except FileNotFoundError as error:
        raise LogError(f"{file}: it is missing; copy the whole dataset again") from error
    except (HalfseenError, MemoryError):
        raise
    except Exception as error:  # a broken file raises nearly anything
        raise LogError(
            f"{file}: it is no whole table ({reason_of(error)}); mend it, or copy or export it again"
        ) from error
