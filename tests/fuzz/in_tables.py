"""Mutators of tables of any format: what they write is whole, and a cell, a type or a name in it is another."""

import csv
import io
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fuzz.hostile import IN_TEXT, NUMBERS, WORDS, pick

Rng = np.random.Generator
KINDS = ("name", "rows", "dropped", "added", *["cell", "type", "turned", "elsewhere"] * 2)
ADDED = (*WORDS[5:8], "x9", "reward", "robot", "Reward", "probability")
CELLS = (*NUMBERS, *WORDS, None, [], [None], [float("nan")], [1e308] * 3, True)
UNTRUE = (b"{", b"\xff", b"[" * 10_000, b'{"columns": 1}', b'{"index_columns": [{}]}', b'{"index_columns": ["x"]}')
"""What pandas never says of a table of Parquet."""
NO_ARRAY = (pa.ArrowException, TypeError, ValueError, OverflowError, UnicodeError)


def other_table(rng: Rng, table: pa.Table) -> tuple[pa.Table, str]:
    """Another cell, type, name, order or number of rows of a table with rows and columns."""
    kind, place = pick(rng, KINDS), int(rng.integers(table.num_columns))
    name, column = table.column_names[place], table.column(place)
    names = list(table.column_names)
    names[place] = _as_unicode(pick(rng, (*WORDS, *names)))
    others = {
        "cell": lambda: table.set_column(place, name, _with_cell(rng, column)),
        "type": lambda: table.set_column(place, name, _of_type(rng, column)),
        "name": lambda: table.rename_columns(
            [*table.column_names[:place], pick(rng, names), *table.column_names[place + 1 :]]
        ),
        "rows": lambda: table.take(pa.array(rng.integers(len(table), size=int(rng.integers(len(table) + 4))))),
        "dropped": lambda: table.remove_column(place),
        "added": lambda: table.append_column(_as_unicode(pick(rng, ADDED)), _of_type(rng, column)),
        "turned": lambda: table.set_column(place, name, column.take(pa.array(rng.permutation(len(table))))),
        "elsewhere": lambda: table.set_column(place, name, table.column(int(rng.integers(table.num_columns)))),
    }
    return others[kind](), f"{name[:40]}: {kind}"


def _as_unicode(word: str) -> str:
    return word.encode("utf-8", "replace").decode()


def _with_cell(rng: Rng, column: pa.ChunkedArray) -> pa.Array:
    values = column.to_pylist()
    which = range(len(values)) if not rng.integers(4) else [int(rng.integers(len(values)))]
    for _ in range(20):
        new = pick(rng, IN_TEXT if pa.types.is_string(column.type) and rng.integers(2) else CELLS)
        changed = [new if k in which else value for k, value in enumerate(values)]
        try:
            return pa.array(changed, type=column.type if rng.integers(3) else None)
        except NO_ARRAY:
            continue
    return column.combine_chunks()


def _of_type(rng: Rng, column: pa.ChunkedArray) -> pa.Array:
    values, num = column.to_pylist(), len(column)
    whole = pa.array(range(num))
    makers = (
        lambda: pa.array(values).dictionary_encode(),
        lambda: pa.array([str(value) for value in values]).dictionary_encode(),
        lambda: pa.array([{"a": value} for value in values]),
        lambda: pa.array([[value] for value in values]),
        lambda: pa.array([[[{"a": value}]] for value in values]),
        lambda: pa.array([str(value) for value in values]),
        lambda: pa.array([str(value).encode() for value in values]),
        lambda: pa.array([value is not None for value in values]),
        lambda: pa.nulls(num),
        lambda: pa.nulls(num, pa.float64()),
        lambda: pa.array([[0.5] * 3] * num, pa.list_(pa.float64(), 3)),
        lambda: pa.array([[("a", 1)]] * num, pa.map_(pa.string(), pa.int64())),
        *(lambda kind=kind: whole.cast(kind) for kind in (pa.timestamp("ns"), pa.duration("s"), pa.decimal128(38, 10))),
        lambda: whole.cast(pa.float16()) if num < 2000 else whole,
        lambda: whole.cast(pa.uint64()),
        lambda: pa.array([2**63 + k for k in range(num)], pa.uint64()),
        lambda: pa.array(rng.normal(size=num).astype(np.float32)),
        lambda: pa.array(rng.normal(size=num) * 1e300),
        lambda: pa.array(np.full(num, pick(rng, NUMBERS[:15]), dtype=np.float64)),
        lambda: pa.array(values),
    )
    try:
        return pick(rng, makers)()
    except NO_ARRAY:
        return whole


def _cells(table: pa.Table, kinds: tuple[type, ...]) -> list[list[Any]]:
    """Rows, as text where a value is of none of some kinds."""
    rows = zip(*(column.to_pylist() for column in table.columns), strict=True)
    return [[cell if cell is None or isinstance(cell, kinds) else str(cell) for cell in row] for row in rows]


def of_csv(rng: Rng, file: Path) -> str:
    """Another table, a cell too many, or another separator."""
    rows = list(csv.reader(io.StringIO(file.read_text(errors="replace"))))
    mutation, width = pick(rng, (*["table"] * 7, "more", ";")), len(rows[0])
    if mutation == "table":
        columns = [pa.array(each) for each in zip(*((row + [""] * width)[:width] for row in rows[1:]), strict=True)]
        table, mutation = other_table(rng, pa.Table.from_arrays(columns, rows[0]))
        rows = [table.column_names, *_cells(table, ())]
    elif mutation == "more":
        rows[int(rng.integers(len(rows)))].append(pick(rng, IN_TEXT))
    text = io.StringIO()
    csv.writer(text, delimiter=";" if mutation == ";" else ",").writerows(rows)
    file.write_bytes(text.getvalue().encode("utf-8", errors="surrogatepass"))
    return mutation


def of_parquet(rng: Rng, file: Path) -> str:
    """Another table, or metadata that lie."""
    table, mutation = pq.ParquetFile(io.BytesIO(file.read_bytes())).read(), "metadata"
    if rng.integers(12):
        table, mutation = other_table(rng, table)
    else:
        table = table.replace_schema_metadata({b"pandas": pick(rng, UNTRUE), b"halfseen": b"\x00"})
    pq.write_table(table, file)
    return mutation


def of_sqlite(rng: Rng, file: Path) -> str:
    """Another table in the place of one, or one less."""
    with closing(sqlite3.connect(file)) as base:
        name = pick(rng, [row[0] for row in base.execute("select name from sqlite_master where type = 'table'")])
        found = base.execute(f'select * from "{name}"')
        names, columns = [each[0] for each in found.description], zip(*found.fetchall(), strict=True)
        base.execute(f'drop table "{name}"')
        mutation = "dropped"
        if rng.integers(8):
            table, mutation = other_table(rng, pa.Table.from_arrays([pa.array(values) for values in columns], names))
            quoted = ['"' + each.replace('"', '""') + '"' for each in table.column_names]
            base.execute(f'create table "{name}" ({", ".join(quoted)})')
            places = ", ".join("?" * len(quoted))
            base.executemany(f'insert into "{name}" values ({places})', _cells(table, (int, float, bytes)))
        base.commit()
    return f"{name}: {mutation}"


def bomb(rng: Rng, file: Path) -> str:
    """Few bytes that take many: a table of one value, well packed."""
    if rng.integers(2):
        text = pa.DictionaryArray.from_arrays([0] * 20_000, ["n" * 10**5])
        table = pa.table({"trajectory": [1] * 20_000, "x9": text})
    else:
        values = pick(rng, ([0] * 10, [[0.0] * 1000] * 10))
        block = pa.table({"trajectory": pa.array([1] * 10), "stage": pa.array(range(10)), "x9": values})
        table = pa.concat_tables([block] * 3000).combine_chunks()
    pq.write_table(table, file, compression="zstd")
    return "a bomb"
