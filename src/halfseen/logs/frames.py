"""Input forms of a table, and its stored form: a pandas frame that survives Parquet unchanged."""

import json
import re
from collections.abc import Collection, Mapping
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute

from halfseen.errors import LogError
from halfseen.logs.columns import COLUMNS, LARGEST_FRACTION, refuse_repeated, shown
from halfseen.reading import refused

compute: Any = pyarrow.compute
_KEPT_IN_ARROW = re.compile(r"(dictionary|(large_|fixed_size_)?list|struct|map|double|float|halffloat)\b.*\[pyarrow\]")
"""Column types of pandas that become numpy types."""


@runtime_checkable
class ArrowStream(Protocol):
    """Any table with Arrow's C stream interface: pyarrow, polars, DuckDB, …."""

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """Export the table."""
        ...


FrameLike: TypeAlias = pd.DataFrame | ArrowStream | Mapping[str, Any]


def as_frame(name: str, data: object) -> pd.DataFrame:
    """Copy a table into its stored form.

    The copy goes through Arrow, so that tables in memory and tables read back from disk have the same types: lists
    become arrays, and text stays text. Parquet has only text categories, so numeric categories become text.

    Parameters
    ----------
    name
        Name of the table; categories of its reserved columns are names, and keep their type.
    data
        A pandas frame, an Arrow table or a dict of arrays.

    Raises
    ------
    LogError
        The data are not a table, or a column mixes types.
    """
    # The pandas metadata of an Arrow table may be broken.
    with refused(name, "not a table", "give a pandas frame, an Arrow table or a dict of arrays"):
        frame = data if isinstance(data, pd.DataFrame) else _from_other(data)
    labels = [label for label in frame.columns if not isinstance(label, str)]
    if labels:
        raise LogError(f"{name}: column {labels[0]!r} has a name that is not text; rename it")
    refuse_repeated(name, list(frame.columns))
    return through_arrow(name, _with_categories_of_text(frame, COLUMNS.get(name, ())).copy())


def through_arrow(name: str, frame: pd.DataFrame) -> pd.DataFrame:
    """Convert a frame to Arrow and back, so that a second conversion changes nothing; its numbers are not copied."""
    plain = _in_native_order(frame.copy(deep=False))
    plain.index, plain.attrs = pd.RangeIndex(len(frame)), {}
    others = [label for label, dtype in plain.dtypes.items() if not _is_number(dtype)]
    if not others:
        return plain
    try:
        table = pa.Table.from_pandas(plain[others], preserve_index=False)
    except OverflowError as error:
        raise LogError(
            f"{name}: {_beyond_64_bits(plain[others])}; give names as text, and other numbers as fractions"
        ) from error
    except (pa.ArrowException, TypeError, ValueError) as error:
        reason = "; ".join(str(part) for part in error.args)
        raise LogError(f"{name}: a column cannot be stored ({reason}); give each column one type") from error
    _refuse_null_characters(name, table)
    plain[others] = frame_of(table.cast(_stored_schema(table.schema)))
    return plain


def _in_native_order(frame: pd.DataFrame) -> pd.DataFrame:
    """Convert numbers to native byte order; those from HDF5 or netCDF may have the other."""
    dtypes = {label: dtype for label, dtype in frame.dtypes.items() if isinstance(dtype, np.dtype)}
    swapped = {label: dtype.newbyteorder("=") for label, dtype in dtypes.items() if not dtype.isnative}
    return frame.astype(swapped) if swapped else frame


def _beyond_64_bits(frame: Any) -> str:
    """Name the first whole number that does not fit into 64 bits."""
    for label, values in frame.items():
        for value in values[values.notna()] if values.dtype == object else ():
            if isinstance(value, int) and not -(2**63) <= value < 2**63:
                return f"column {label!r} holds {shown(value)}, beyond 64-bit integers"
    return "a column holds a number that is too large to be stored"


def _refuse_null_characters(name: str, table: pa.Table) -> None:
    """Refuse text with NUL, which other programs read as its end (`LogError`)."""
    for label, column in zip(table.column_names, table.columns, strict=True):
        texts = column.cast(column.type.value_type) if pa.types.is_dictionary(column.type) else column
        if not (pa.types.is_string(texts.type) or pa.types.is_large_string(texts.type)):
            continue
        found = texts.filter(compute.match_substring(texts, "\0"))
        if len(found):
            raise LogError(
                f"{name}: column {label!r} holds {shown(found[0].as_py())}, which has the character NUL; end the text "
                "before it"
            )


def _with_categories_of_text(frame: pd.DataFrame, but: Collection[str]) -> pd.DataFrame:
    texts = {
        label: frame[label].cat.rename_categories(dtype.categories.map(str))
        for label, dtype in frame.dtypes.items()
        if isinstance(dtype, pd.CategoricalDtype) and len(dtype.categories) and label not in but
    }
    return frame.assign(**texts) if texts else frame


def _is_number(dtype: Any) -> bool:
    """Whether Arrow returns a column of this type unchanged, so that the conversion can be skipped."""
    if isinstance(dtype, pd.BooleanDtype):
        return True
    return isinstance(dtype, np.dtype) and dtype.isnative and dtype.kind in "biuf" and dtype.itemsize in (1, 4, 8)


def _stored_schema(schema: pa.Schema) -> pa.Schema:
    """Replace types that Parquet lacks: time stamps in whole seconds, and categories other than text."""
    for i, field in enumerate(schema):
        if pa.types.is_dictionary(field.type) and not pa.types.is_string(field.type.value_type):
            schema = schema.set(i, field.with_type(field.type.value_type))
        if pa.types.is_timestamp(field.type) and field.type.unit == "s":
            schema = schema.set(i, field.with_type(pa.timestamp("ms", field.type.tz)))
    return schema


def _from_other(data: object) -> pd.DataFrame:
    if isinstance(data, Mapping):
        return pd.DataFrame({key: _column(values) for key, values in data.items()})
    if isinstance(data, ArrowStream):
        return frame_of(pa.table(data))
    raise TypeError(f"it is a {type(data).__name__}")


def frame_of(table: pa.Table) -> pd.DataFrame:
    """Make a frame; decimals become floats, and whole numbers with nulls, unless too large to be exact as floats."""
    for k, field in enumerate(table.schema):
        if pa.types.is_decimal(field.type):  # by way of text: Arrow's own cast may err in the last digit
            table = table.set_column(k, field.name, table[k].cast(pa.string()).cast(pa.float64()))
    frame = _with_plain_types(table).to_pandas()
    for name, column in zip(table.column_names, table.columns, strict=True):
        if column.null_count and pa.types.is_integer(column.type):
            numbers = column.drop_null().to_numpy()
            if len(numbers) and max(-int(numbers.min()), int(numbers.max())) >= LARGEST_FRACTION:
                frame[name] = column.to_pandas(types_mapper={column.type: pd.Int64Dtype()}.get)
    return frame


def _with_plain_types(table: pa.Table) -> pa.Table:
    """Drop Arrow types from the pandas metadata: pandas cannot restore some, and others distinguish NaN from null."""
    notes = table.schema.pandas_metadata
    if not notes:
        return table
    for column in notes["columns"]:
        if _KEPT_IN_ARROW.fullmatch(str(column["numpy_type"])):
            column["numpy_type"] = "object"
    return table.replace_schema_metadata({**table.schema.metadata, b"pandas": json.dumps(notes).encode()})


def _column(values: Any) -> Any:
    if isinstance(values, pa.Array | pa.ChunkedArray):
        return frame_of(pa.table({"values": values}))["values"]
    # Otherwise pandas turns whole numbers with a null into floats.
    is_list = isinstance(values, list | tuple)
    return np.array([*values, None], dtype=object)[:-1] if is_list and any(each is None for each in values) else values
