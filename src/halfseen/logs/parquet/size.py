"""What a Parquet file takes once it is read, before it is read."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pyarrow.parquet as pq

from halfseen.logs.parquet.footer import Chunk, chunks_of
from halfseen.reading import ALWAYS_UNPACKED, check_unpacked

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
