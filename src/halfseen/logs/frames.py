"""What a table may come as, and the one form in which it is kept: a pandas frame that survives Parquet unchanged."""

from collections.abc import Collection, Mapping
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
import pandas as pd
import pyarrow as pa

from halfseen.errors import LogError
from halfseen.reading import reason_of

LARGEST_FRACTION = 2**53
"""Beyond it, fractions tell no whole numbers apart."""


@runtime_checkable
class ArrowStream(Protocol):
    """Any table that speaks Arrow's C stream interface: pyarrow, polars, DuckDB, …."""

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """Hand the table over."""
        ...


FrameLike: TypeAlias = pd.DataFrame | ArrowStream | Mapping[str, Any]


def as_frame(name: str, data: object, own_columns: Collection[str] = ()) -> pd.DataFrame:
    """Copy a table into the form in which it is kept.

    The copy goes through Arrow, so that what is kept in memory and what comes back from disk are the same to the last
    type: lists become arrays, and text is text. Parquet knows no categories but of text, so that numbers that are said
    to be categories become text.

    Parameters
    ----------
    name
        What the table is called, for messages.
    data
        A pandas frame, an Arrow table or a dict of arrays.
    own_columns
        Columns in which categories are names, and stay what they are.

    Raises
    ------
    LogError
        The data are no table, or a column mixes types.
    """
    try:
        frame = data if isinstance(data, pd.DataFrame) else _from_other(data)
    except (ValueError, TypeError, LookupError, AttributeError, pa.ArrowException) as error:
        # What pandas noted of an Arrow table may be broken.
        raise LogError(
            f"{name}: not a table ({reason_of(error)}); give a pandas frame, an Arrow table or a dict of arrays"
        ) from error
    labels = [label for label in frame.columns if not isinstance(label, str)]
    if labels:
        raise LogError(f"{name}: column {labels[0]!r} has a name that is not text; rename it")
    repeated = frame.columns[frame.columns.duplicated()]
    if len(repeated):
        raise LogError(f"{name}: there are two columns {repeated[0]!r}; drop or rename one")
    return through_arrow(name, _with_categories_of_text(frame, own_columns))


def through_arrow(name: str, frame: pd.DataFrame) -> pd.DataFrame:
    """Copy a frame to Arrow and back, after which doing so again changes nothing."""
    plain = frame.reset_index(drop=True).copy()
    plain.attrs = {}
    others = [label for label, dtype in plain.dtypes.items() if not _is_number(dtype)]
    if not others:
        return plain
    try:
        table = pa.Table.from_pandas(plain[others], preserve_index=False)
    except (pa.ArrowException, TypeError, ValueError) as error:
        reason = "; ".join(str(part) for part in error.args)
        raise LogError(f"{name}: a column cannot be stored ({reason}); give each column one type") from error
    plain[others] = table.cast(_stored_schema(table.schema)).to_pandas()
    return plain


def _with_categories_of_text(frame: pd.DataFrame, but: Collection[str]) -> pd.DataFrame:
    texts = {
        label: frame[label].cat.rename_categories(dtype.categories.map(str))
        for label, dtype in frame.dtypes.items()
        if isinstance(dtype, pd.CategoricalDtype) and len(dtype.categories) and label not in but
    }
    return frame.assign(**texts) if texts else frame


def _is_number(dtype: Any) -> bool:
    """Tell whether Arrow gives a column of this type back as it is, and would cost time alone."""
    if isinstance(dtype, pd.BooleanDtype):
        return True
    return isinstance(dtype, np.dtype) and dtype.isnative and dtype.kind in "biuf" and dtype.itemsize in (1, 4, 8)


def _stored_schema(schema: pa.Schema) -> pa.Schema:
    """Parquet has no time stamps of whole seconds, nor categories but of text; so we have none."""
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
        return _from_arrow(pa.table(data))
    raise TypeError(f"it is a {type(data).__name__}")


def _from_arrow(table: pa.Table) -> pd.DataFrame:
    """Make a frame; whole numbers with nulls become fractions, but where fractions do not tell them apart."""
    frame = table.to_pandas()
    for name, column in zip(table.column_names, table.columns, strict=True):
        if column.null_count and pa.types.is_integer(column.type) and _is_beyond_fractions(column):
            frame[name] = column.to_pandas(types_mapper={column.type: pd.Int64Dtype()}.get)
    return frame


def _is_beyond_fractions(column: pa.ChunkedArray) -> bool:
    numbers = column.drop_null().to_numpy()
    return len(numbers) > 0 and max(-int(numbers.min()), int(numbers.max())) > LARGEST_FRACTION


def _column(values: Any) -> Any:
    return values.to_pandas() if isinstance(values, pa.Array | pa.ChunkedArray) else values
