"""Mutators that know a format: what they write is whole, and a value, a type or a name in it is another."""

import csv
import io
import json
import math
import sqlite3
import zipfile
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fuzz.hostile import IN_TEXT, LONG, NUMBERS, WORDS, any_value, pick

Rng = np.random.Generator

CSV_KINDS = ("cell", "cell", "cell", "elsewhere", "elsewhere", "header", "dropped", "more", ";")
OF_COLUMNS = ("turned", "turned", "elsewhere")


def of_json(rng: Rng, file: Path) -> str:
    """Another value, key or order somewhere in a JSON document, or in one line of several."""
    text = file.read_text(errors="replace")
    if file.suffix == ".jsonl":
        lines = text.splitlines() or [""]
        k = int(rng.integers(len(lines)))
        lines[k], told = _changed_json(rng, lines[k])
        file.write_text("\n".join(lines) + "\n", errors="surrogatepass")
        return f"{file.name}: line {k + 1}: {told}"
    new, told = _changed_json(rng, text)
    file.write_text(new, errors="surrogatepass")
    return f"{file.name}: {told}"


def _changed_json(rng: Rng, text: str) -> tuple[str, str]:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return text + "]", "bracket added"
    if not rng.integers(12):
        return _dumped(any_value(rng)), "another document"
    parents = list(_parents(value))
    if not parents:
        return _dumped(any_value(rng)), "another document"
    parent = pick(rng, parents)
    key = pick(rng, list(parent) if isinstance(parent, dict) else range(len(parent)))
    kind = pick(rng, ("value", "value", "value", "elsewhere", "elsewhere", "scaled", "scaled", "dropped", "renamed"))
    if kind == "value":
        parent[key] = any_value(rng)
    elif kind == "elsewhere":
        other = pick(rng, parents)
        parent[key] = json.loads(json.dumps(pick(rng, list(other.values()) if isinstance(other, dict) else other)))
    elif kind == "scaled":
        parent[key] = _scaled(rng, parent[key])
    elif kind == "dropped":
        del parent[key]
    elif isinstance(parent, dict):
        parent[pick(rng, WORDS)] = parent.pop(key)
    else:
        parent.insert(key, any_value(rng))
    return _dumped(value), f"{str(key)[:40]}: {kind}"


def _scaled(rng: Rng, value: Any) -> Any:
    """A value of the same kind: longer, shorter, turned or of another sign."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int) or (isinstance(value, float) and math.isfinite(value)):
        return pick(rng, (-value, value + 1, value - 1, 2 * value, 1000 * value, value // 7, round(value)))
    if isinstance(value, str):
        return pick(rng, (value + "x", value[:-1], value.upper(), value[::-1], value * 20))
    if isinstance(value, list):
        return pick(rng, (value[:-1], value[1:], value[::-1], value + value, [value], value[:1] * len(value)))
    return list(value.items()) if isinstance(value, dict) else [value]


def _parents(value: Any) -> Any:
    if isinstance(value, dict | list) and value:
        yield value
        for child in value.values() if isinstance(value, dict) else value[:200]:
            yield from _parents(child)


def _dumped(value: Any) -> str:
    return json.dumps(value, ensure_ascii=True)


def of_csv(rng: Rng, file: Path) -> str:
    """Another cell, column, header or separator."""
    rows = list(csv.reader(io.StringIO(file.read_text(errors="replace")))) or [[""]]
    row, kind = (
        rows[int(rng.integers(len(rows)))],
        pick(rng, CSV_KINDS),
    )
    column = int(rng.integers(max(1, len(rows[0]))))
    if kind == "cell" and row:
        row[column % len(row)] = pick(rng, IN_TEXT)
    elif kind == "elsewhere" and row:
        row[column % len(row)] = pick(rng, pick(rng, rows) or [""])
    elif kind == "header" and rows[0]:
        rows[0][column] = pick(rng, (*WORDS, *rows[0]))
    elif kind == "dropped":
        rows = [[cell for k, cell in enumerate(one) if k != column] for one in rows]
    else:
        row.append(pick(rng, IN_TEXT))
    text = io.StringIO()
    csv.writer(text, delimiter=";" if kind == ";" else ",").writerows(rows)
    file.write_bytes(text.getvalue().encode("utf-8", errors="surrogatepass"))
    return f"{file.name}: {kind}"


def of_toml(rng: Rng, file: Path) -> str:
    """Another value, key or table."""
    lines = file.read_text(errors="replace").splitlines()
    places = [k for k, line in enumerate(lines) if "=" in line and not line.lstrip().startswith("#")]
    values = (
        *("nan", "inf", "-inf", "1e308", "-1", "0", "9223372036854775808", "1e-320", '""', '"\\u001b[31mred"', "true"),
        *(f'"{LONG}"', "[]", "{}", "[nan, 0.0]", "[1e308, -1e308]", "[[[1]]]", "[" * 100 + "]" * 100, "1979-05-27"),
        *(
            '"/dev/zero"',
            '"../law"',
            '"> 1e308"',
            '"> nan"',
            '"> "',
            "{ stage = 1 }",
            "'''a\nb'''",
            "0x7fffffffffffffff",
        ),
    )
    if not places:
        lines.append(f"a = {pick(rng, values)}")
    elif rng.integers(4):
        k = pick(rng, places)
        lines[k] = f"{lines[k].partition('=')[0]}= {pick(rng, values)}"
    else:
        lines.insert(
            int(rng.integers(len(lines))), pick(rng, ("[[robot]]", "[rule]", "x = 1", lines[pick(rng, places)]))
        )
    file.write_text("\n".join(lines) + "\n")
    return f"{file.name}: another value"


def of_parquet(rng: Rng, file: Path) -> str:
    """Another cell, type, name or number of rows, and metadata that lie."""
    try:
        table = pq.ParquetFile(io.BytesIO(file.read_bytes())).read()
    except Exception:  # what an earlier mutation broke
        return f"{file.name}: as it is"
    if not len(table) or not table.num_columns:
        return f"{file.name}: as it is"
    kind = pick(rng, ("cell", "cell", "type", "type", "name", "rows", "dropped", "metadata", "added", *OF_COLUMNS))
    name = pick(rng, table.column_names)
    place = table.column_names.index(name)
    if kind == "cell":
        table = table.set_column(place, name, _with_cell(rng, table[name]))
    elif kind in ("type", "added"):
        told = name if kind == "type" else pick(rng, (*WORDS[5:8], "x9", "reward", "robot", "Reward", "probability"))
        told = told.encode("utf-8", "replace").decode()
        table = table.set_column(place, told, _of_type(rng, table[name])) if kind == "type" else table
        table = table if kind == "type" else table.append_column(told, _of_type(rng, table[name]))
    elif kind == "name":
        names = [word.encode("utf-8", "replace").decode() for word in (*WORDS, *table.column_names)]
        table = table.rename_columns([pick(rng, names) if each == name else each for each in table.column_names])
    elif kind == "rows":
        table = table.take(pa.array(rng.integers(len(table), size=int(rng.integers(len(table) + 4)))))
    elif kind == "dropped":
        table = table.drop_columns([name])
    elif kind == "turned":
        table = table.set_column(place, name, table[name].take(pa.array(rng.permutation(len(table)))))
    elif kind == "elsewhere":
        table = table.set_column(place, name, table[pick(rng, table.column_names)])
    else:
        broken = (
            b"{",
            b"\xff",
            b"[" * 10_000,
            b'{"columns": 1}',
            b'{"index_columns": [{}]}',
            b'{"index_columns": ["x"]}',
        )
        table = table.replace_schema_metadata({b"pandas": pick(rng, broken), b"halfseen": b"\x00"})
    whole = file.read_bytes()
    try:
        pq.write_table(table, file)
    except (pa.ArrowException, NotImplementedError):
        file.write_bytes(whole)  # Arrow deletes what it cannot write
        return flip_tail(rng, file)
    return f"{file.name}: {name[:40]}: {kind}"


def flip_tail(rng: Rng, file: Path) -> str:
    data = bytearray(file.read_bytes())
    data[-1 - int(rng.integers(min(len(data), 2000)))] ^= 1 << int(rng.integers(8))
    file.write_bytes(bytes(data))
    return f"{file.name}: a bit of the footer flipped"


def _with_cell(rng: Rng, column: pa.ChunkedArray) -> pa.Array:
    values = column.to_pylist()
    which = range(len(values)) if not rng.integers(4) else [int(rng.integers(len(values)))]
    for _ in range(20):
        new = pick(rng, (*NUMBERS, *WORDS, None, [], [None], [float("nan")], [1e308] * 3, True))
        changed = [new if k in which else value for k, value in enumerate(values)]
        try:
            return pa.array(changed, type=column.type if rng.integers(3) else None)
        except (pa.ArrowException, TypeError, ValueError, OverflowError, UnicodeError):
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
        lambda: whole.cast(pa.timestamp("ns")),
        lambda: whole.cast(pa.duration("s")),
        lambda: whole.cast(pa.decimal128(38, 10)),
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
    except (pa.ArrowException, TypeError, ValueError, OverflowError):
        return whole


def of_npz(rng: Rng, file: Path) -> str:
    """Arrays of other values, kinds and shapes, pictures that no camera takes, and headers that lie."""
    try:
        with np.load(io.BytesIO(file.read_bytes()), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except Exception:  # what an earlier mutation broke
        return f"{file.name}: as it is"
    name = pick(rng, list(arrays))
    array = np.atleast_1d(arrays[name])
    kind = pick(rng, ("cell", "type", "shape", "dropped", "header", "picture", "picture"))
    if kind == "cell":
        arrays[name] = _hostile_cells(rng, array)
    elif kind == "type":
        types = (np.float16, np.float32, np.int64, np.uint8, np.complex128, bool, "S8", "U8", "M8[s]", object)
        with np.errstate(all="ignore"), suppress(ValueError):  # text that is no time stays text
            arrays[name] = np.nan_to_num(array).astype(pick(rng, types))
    elif kind == "shape":
        shapes = (
            array[..., None],
            array[:0],
            array.ravel(),
            array[:1],
            array.T,
            array[()].sum(),
            array[None],
            array[..., :3],
        )
        arrays[name] = np.asarray(pick(rng, shapes))
    elif kind == "dropped":
        del arrays[name]
    elif kind == "picture" and _is_image(arrays.get("depth_m")):
        arrays["depth_m"] = strange_depth(rng, arrays["depth_m"])
    np.savez_compressed(file, allow_pickle=True, **arrays)
    if kind == "header":
        _lie_in_header(rng, file, name)
    return f"{file.name}: {name}: {kind}"


def _is_image(array: np.ndarray | None) -> bool:
    return array is not None and array.ndim == 2 and array.dtype.kind == "f"


def strange_depth(rng: Rng, depth: np.ndarray) -> np.ndarray:
    """Depth that no table returns: stripes, checks, noise, planes, steps [m]."""
    row, column = np.indices(depth.shape)
    period, low, high = int(rng.integers(1, 9)), rng.uniform(0.1, 2.0), rng.uniform(0.1, 5.0)
    images = (
        np.where(column // period % 2, low, high),
        np.where((row // period + column // period) % 2, low, high),
        np.where(column // period % 2, depth, np.nan),
        np.where(row // period % 2, depth, depth + 0.1),
        rng.uniform(0.1, high, depth.shape),
        depth + rng.normal(0.0, 10.0 ** rng.uniform(-4, 0), depth.shape),
        np.full(depth.shape, low),
        low + 0.01 * row,
        np.where(rng.random(depth.shape) < 0.9, np.nan, depth),
        depth * 10.0 ** rng.uniform(-3, 3),
        np.where((row == 3) & (column == 4), 999.0, depth),
        np.where(rng.random(depth.shape) < 0.01, rng.uniform(0.1, 999.0, depth.shape), depth),
        np.round(depth, 1),
        depth[::-1],
        depth.astype(np.float32),
    )
    return pick(rng, images)


def _hostile_cells(rng: Rng, array: np.ndarray) -> np.ndarray:
    changed = array.copy().reshape(-1)
    where = slice(None) if not rng.integers(4) else rng.integers(max(1, changed.size), size=int(rng.integers(1, 20)))
    with np.errstate(all="ignore"):
        value = np.asarray(pick(rng, NUMBERS[:15]))
        if changed.size:
            changed[where] = np.nan_to_num(value).astype(array.dtype) if array.dtype.kind in "iu" else value
    return changed.reshape(array.shape)


def _lie_in_header(rng: Rng, file: Path, name: str) -> None:
    shapes = ((10**9,), (10**6, 10**6), (-1,), (2**62, 2**62), (0,), (), (1,) * 70)
    descr = pick(rng, ("<f8", "|O", "<f4", "|S1000000000", "|V8", [("a", "<f8")], "<U1000000", "nonsense"))
    with zipfile.ZipFile(file) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    head = repr({"descr": descr, "fortran_order": False, "shape": pick(rng, shapes)}).encode() + b"\n"
    body = members[f"{name}.npy"]
    members[f"{name}.npy"] = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + body[128:]
    with zipfile.ZipFile(file, "w") as archive:
        for member, content in members.items():
            archive.writestr(member, content)


def of_safetensors(rng: Rng, file: Path) -> str:
    """Another header, or other numbers below it."""
    data = file.read_bytes()
    size = int.from_bytes(data[:8], "little")
    head, body = data[8 : 8 + size], bytearray(data[8 + size :])
    if rng.integers(2) and len(body) >= 8:
        place = 8 * int(rng.integers(len(body) // 8))
        body[place : place + 8] = np.float64(pick(rng, NUMBERS[:15])).tobytes()
        told = "another number"
    else:
        text, told = _changed_json(rng, head.decode(errors="replace"))
        head = text.encode("utf-8", "surrogatepass")
    file.write_bytes(len(head).to_bytes(8, "little") + head + bytes(body))
    return f"{file.name}: {told}"


def of_hdf5(rng: Rng, file: Path) -> str:
    """Another dataset or attribute, or one less."""
    import h5py

    try:
        with h5py.File(file, "r+") as opened:
            places: list[str] = []
            opened.visit(places.append)
            place = pick(rng, places) if places else "/"
            node, kind = opened[place], pick(rng, ("attribute", "dataset", "dataset", "dropped", "link"))
            if kind == "attribute":
                key = pick(rng, list(node.attrs) or ["new"])
                node.attrs[key] = pick(rng, (*NUMBERS[:16], "word", LONG, np.zeros(3), np.zeros(0)))
            elif kind == "dropped":
                del opened[place]
            elif kind == "link":
                del opened[place]
                opened[place] = pick(
                    rng, (h5py.SoftLink("/none"), h5py.SoftLink(f"/{place}"), h5py.ExternalLink("/dev/zero", "/"))
                )
            else:
                shape = node.shape if isinstance(node, h5py.Dataset) else (3,)
                size = (shape[0] if shape else 1) + int(rng.integers(-1, 2))
                new = pick(
                    rng,
                    (
                        np.full(max(0, size), pick(rng, NUMBERS[:15]), float),
                        np.arange(max(0, size)),
                        np.array([b"a"] * max(0, size)),
                        np.zeros((max(0, size), 0)),
                        np.zeros((max(0, size), 2, 2)),
                        np.array(3.0),
                        np.zeros(max(0, size), bool),
                        np.zeros(max(0, size), complex),
                    ),
                )
                del opened[place]
                opened[place] = new
    except Exception:  # what an earlier mutation broke, or HDF5 does not allow
        return flip_tail(rng, file)
    return f"{file.name}: {place}: {kind}"


def of_sqlite(rng: Rng, file: Path) -> str:
    """Another cell of a table, or a table less."""
    try:
        with closing(sqlite3.connect(file)) as base:
            tables = [row[0] for row in base.execute("select name from sqlite_master where type = 'table'")]
            table = pick(rng, tables)
            columns = [row[1] for row in base.execute(f'pragma table_info("{table}")')]
            if not rng.integers(8):
                base.execute(f'drop table "{table}"')
            else:
                value = pick(rng, (None, -1, 2**63 - 1, 0, "word", LONG, b"", b"\x00\x01\x00\x00" + b"\xff" * 8, 1e308))
                base.execute(
                    f'update "{table}" set "{pick(rng, columns)}" = ? where rowid = 1 + abs(random()) % 3', (value,)
                )
            base.commit()
    except (sqlite3.Error, OverflowError):
        return flip_tail(rng, file)
    return f"{file.name}: {table}: another cell"


def bomb(rng: Rng, file: Path) -> str:
    """Few bytes that take many: a table or an array of one value, well packed."""
    num = 2 * 10**8
    if file.suffix == ".npz":
        with (
            zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
            archive.open("depth_m.npy", "w") as member,
        ):
            member.write(
                b"\x93NUMPY\x01\x00v\x00"
                + f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({num}, 1), }}".ljust(117).encode()
                + b"\n"
            )
            for _ in range(num // 10**6):
                member.write(bytes(8 * 10**6))
        return f"{file.name}: a bomb"
    values = pick(rng, ([0] * 10, ["n" * 10**6] * 10, [[0.0] * 1000] * 10))
    block = pa.table({"path": pa.array([1] * 10), "stage": pa.array(range(10)), "x9": values})
    repeated = pa.concat_tables([block] * 3000).combine_chunks() if not isinstance(values[0], str) else None
    table = repeated or pa.table(
        {"path": [1] * 20_000, "x9": pa.DictionaryArray.from_arrays([0] * 20_000, ["n" * 10**5])}
    )
    pq.write_table(table, file, compression="zstd")
    return f"{file.name}: a bomb"


OF_FORMAT = {
    ".json": (of_json,),
    ".jsonl": (of_json,),
    ".csv": (of_csv,),
    ".toml": (of_toml,),
    ".parquet": (of_parquet, of_parquet, of_parquet, of_parquet, of_parquet, of_parquet, bomb),
    ".npz": (of_npz,),
    ".safetensors": (of_safetensors,),
    ".hdf5": (of_hdf5,),
    ".db3": (of_sqlite,),
}
