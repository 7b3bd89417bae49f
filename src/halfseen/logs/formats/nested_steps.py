"""Tables of RLDS with one row an episode, whose steps are a list of structs, as data frames of TFDS become Parquet."""

from pathlib import Path

import pyarrow as pa

from halfseen.errors import warn
from halfseen.logs.parquet import compute

LAST = "is_last"


def has_steps(schema: pa.Schema) -> bool:
    """Whether a table has one row a step, or one row an episode with its steps."""
    return LAST in schema.names or _nested(schema) is not None


def unnested(file: Path, table: pa.Table) -> pa.Table:
    """One row a step, which repeats the columns of its episode; any other table unchanged.

    Warns of episodes without steps, which leave no row.
    """
    name = _nested(table.schema)
    if name is None:
        return table
    lists = table[name].combine_chunks()
    episodes = compute.list_parent_indices(lists)
    num_empty = len(lists) - len(compute.unique(episodes))
    if num_empty:
        warn(file, f"left out: {num_empty:,} of {len(lists):,} episodes, without steps in {name!r}")
    rows = table.drop_columns([name]).take(episodes)
    steps = pa.Table.from_struct_array(compute.list_flatten(lists))
    return pa.Table.from_arrays([*rows.columns, *steps.columns], names=[*rows.column_names, *steps.column_names])


def _nested(schema: pa.Schema) -> str | None:
    """The column of steps, if any."""
    lists = (each for each in schema if pa.types.is_list(each.type) or pa.types.is_large_list(each.type))
    structs = (each for each in lists if pa.types.is_struct(each.type.value_type))
    return next((each.name for each in structs if each.type.value_type.get_field_index(LAST) >= 0), None)
