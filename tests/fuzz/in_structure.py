"""Mutators that know a format: what they write is whole, and a value, a type or a name in it is another."""

import csv
import io
import json
import math
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from fuzz.hostile import LONG, NUMBERS, WORDS, any_value, pick
from fuzz.in_bytes import or_flipped
from fuzz.in_tables import bomb, of_csv, of_parquet, of_sqlite

Rng = np.random.Generator
IN_TOML = (
    *("nan", "inf", "-inf", "1e308", "-1", "0", "9223372036854775808", "1e-320", '""', '"\\u001b[31mred"', "true"),
    *(f'"{LONG}"', "[]", "{}", "[nan, 0.0]", "[1e308, -1e308]", "[[[1]]]", "[" * 100 + "]" * 100, "1979-05-27"),
    *('"/dev/zero"', '"../law"', '"> 1e308"', '"> nan"', '"> "', "{ stage = 1 }", "'''a\nb'''", "0x7fffffffffffffff"),
)
SHAPED = (
    *(lambda array: array[..., None], lambda array: array[:0], np.ravel, lambda array: array[:1], np.transpose),
    *(lambda array: array[()].sum(), lambda array: array[None], lambda array: array[..., :3]),
)


def of_json(rng: Rng, file: Path) -> str:
    """Another value, key or order somewhere in a JSON document, or in one line of several."""
    text = file.read_text(errors="replace")
    lines = (text.splitlines() or [""]) if file.suffix == ".jsonl" else [text]
    k = int(rng.integers(len(lines)))
    lines[k], mutation = _changed_json(rng, lines[k])
    file.write_text("\n".join(lines) + "\n", errors="surrogatepass")
    return f"line {k + 1}: {mutation}"


def _changed_json(rng: Rng, text: str) -> tuple[str, str]:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return text + "]", "bracket added"
    parents = list(_parents(value))
    if not rng.integers(12) or not parents:
        return json.dumps(any_value(rng)), "another document"
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
    return json.dumps(value), f"{str(key)[:40]}: {kind}"


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


def of_toml(rng: Rng, file: Path) -> str:
    """Another value, key or table."""
    lines = file.read_text(errors="replace").splitlines()
    places = [k for k, line in enumerate(lines) if "=" in line and not line.lstrip().startswith("#")]
    if not places:
        lines.append(f"a = {pick(rng, IN_TOML)}")
    elif rng.integers(4):
        k = pick(rng, places)
        lines[k] = f"{lines[k].partition('=')[0]}= {pick(rng, IN_TOML)}"
    else:
        added = ("[[robot]]", "[rule]", "x = 1", lines[pick(rng, places)])
        lines.insert(int(rng.integers(len(lines))), pick(rng, added))
    file.write_text("\n".join(lines) + "\n")
    return "another value"


def of_npz(rng: Rng, file: Path) -> str:
    """Arrays of other values, kinds and shapes, pictures that no camera takes, and headers that lie."""
    with np.load(io.BytesIO(file.read_bytes()), allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    name, kind = pick(rng, list(arrays)), pick(rng, (*OF_ARRAY, "dropped", "header", "picture", "picture"))
    if kind in OF_ARRAY:
        arrays[name] = OF_ARRAY[kind](rng, np.atleast_1d(arrays[name]))
    elif kind == "dropped":
        del arrays[name]
    elif kind == "picture" and np.ndim(arrays.get("depth_m")) == 2:
        arrays["depth_m"] = strange_depth(rng, arrays["depth_m"])
    np.savez_compressed(file, allow_pickle=True, **arrays)
    if kind == "header":
        _lie_in_header(rng, file, name)
    return f"{name}: {kind}"


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


def _of_another_type(rng: Rng, array: np.ndarray) -> np.ndarray:
    types = (np.float16, np.float32, np.int64, np.uint8, np.complex128, bool, "S8", "U8", "M8[s]", object)
    with np.errstate(all="ignore"), suppress(ValueError, TypeError):  # text that is no time stays text
        array = np.nan_to_num(array).astype(pick(rng, types))
    return array


OF_ARRAY = {
    "cell": _hostile_cells,
    "type": _of_another_type,
    "shape": lambda rng, array: np.asarray(pick(rng, SHAPED)(array)),
}


def _lie_in_header(rng: Rng, file: Path, name: str) -> None:
    shapes = ((10**9,), (10**6, 10**6), (-1,), (2**62, 2**62), (0,), (), (1,) * 70)
    descr = pick(rng, ("<f8", "|O", "<f4", "|S1000000000", "|V8", [("a", "<f8")], "<U1000000", "nonsense"))
    members = members_of(file)
    head = repr({"descr": descr, "fortran_order": False, "shape": pick(rng, shapes)}).encode() + b"\n"
    members[f"{name}.npy"] = (
        b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + members[f"{name}.npy"][128:]
    )
    zip_members(file, members)


def members_of(file: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(file) as archive:
        return {info.filename: archive.read(info) for info in archive.infolist()}


def zip_members(file: Path, members: dict[str, bytes], packed: int = zipfile.ZIP_STORED) -> None:
    with zipfile.ZipFile(file, "w", packed) as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def of_safetensors(rng: Rng, file: Path) -> str:
    """Another header, or other numbers below it."""
    data = file.read_bytes()
    size = int.from_bytes(data[:8], "little")
    head, body = data[8 : 8 + size], bytearray(data[8 + size :])
    if rng.integers(2) and len(body) >= 8:
        place = 8 * int(rng.integers(len(body) // 8))
        body[place : place + 8] = np.float64(pick(rng, NUMBERS[:15])).tobytes()
        mutation = "another number"
    else:
        text, mutation = _changed_json(rng, head.decode(errors="replace"))
        head = text.encode("utf-8", "surrogatepass")
    file.write_bytes(len(head).to_bytes(8, "little") + head + bytes(body))
    return mutation


def of_hdf5(rng: Rng, file: Path) -> str:
    """Another dataset or attribute, or one less."""
    import h5py

    with h5py.File(file, "r+") as opened:
        places: list[str] = []
        opened.visit(places.append)
        place = pick(rng, places) if places else "/"
        node, kind = opened[place], pick(rng, ("attribute", "dataset", "dataset", "dropped", "link"))
        if kind == "attribute":
            key = pick(rng, list(node.attrs) or ["new"])
            node.attrs[key] = pick(rng, (*NUMBERS[:16], "word", LONG, np.zeros(3), np.zeros(0)))
            return f"{place}: {kind}"
        num_rows = node.shape[0] if isinstance(node, h5py.Dataset) and node.shape else 1
        del opened[place]
        if kind == "link":
            links = (h5py.SoftLink("/none"), h5py.SoftLink(f"/{place}"), h5py.ExternalLink("/dev/zero", "/"))
            opened[place] = pick(rng, links)
        elif kind == "dataset":
            opened[place] = _dataset(rng, max(0, num_rows + int(rng.integers(-1, 2))))
    return f"{place}: {kind}"


def _dataset(rng: Rng, size: int) -> np.ndarray:
    of_size = (np.full(size, pick(rng, NUMBERS[:15]), float), np.arange(size), np.array([b"a"] * size), np.array(3.0))
    others = (np.zeros((size, 0)), np.zeros((size, 2, 2)), np.zeros(size, bool), np.zeros(size, complex))
    return pick(rng, (*of_size, *others))


OF_FORMAT = {
    suffix: tuple(map(or_flipped, changes))
    for suffix, changes in {
        ".json": [of_json],
        ".jsonl": [of_json],
        ".csv": [of_csv],
        ".toml": [of_toml],
        ".parquet": [*[of_parquet] * 6, bomb],
        ".npz": [of_npz],
        ".safetensors": [of_safetensors],
        ".hdf5": [of_hdf5],
        ".db3": [of_sqlite],
        ".db": [of_sqlite],
    }.items()
}


# Mutations that must not matter: the answer is that for the unbroken input.


def parquet_packed_otherwise(rng: Rng, file: Path) -> None:
    table = pq.ParquetFile(io.BytesIO(file.read_bytes())).read()
    table = table.replace_schema_metadata({**(table.schema.metadata or {}), b"note": b"of no matter"})
    options = {"row_group_size": int(rng.integers(1, 100)), "data_page_version": pick(rng, ("1.0", "2.0"))}
    options |= {name: bool(rng.integers(2)) for name in ("use_dictionary", "write_statistics")}
    pq.write_table(table, file, compression=pick(rng, ("snappy", "zstd", "gzip", "none", "lz4")), **options)


def json_in_other_order(rng: Rng, file: Path) -> None:
    read = json.loads(file.read_text())
    turned = dict(reversed(read.items())) if isinstance(read, dict) else read
    file.write_text(json.dumps(turned, indent=int(rng.integers(5))) + "\n")


def csv_quoted(rng: Rng, file: Path) -> None:
    rows = list(csv.reader(io.StringIO(file.read_text(), newline="")))
    text = io.StringIO(newline="")
    # Quotes tell an empty text from a null in the folders of halfseen; what needs none has none there.
    csv.writer(text, lineterminator="\r\n").writerows(rows)
    file.write_bytes(pick(rng, (b"", b"\xef\xbb\xbf")) + text.getvalue().encode())


def toml_commented(rng: Rng, file: Path) -> None:
    lines = file.read_text().splitlines()
    at = int(rng.integers(len(lines) + 1))
    file.write_text("\n".join([*lines[:at], "# of no matter", "", *(f"{line}  " for line in lines[at:])]) + "\n")


def npz_packed_otherwise(rng: Rng, file: Path) -> None:
    extra = io.BytesIO()
    np.save(extra, np.arange(3))
    members = dict(reversed(members_of(file).items())) | {"of_no_matter.npy": extra.getvalue()}
    zip_members(file, members, pick(rng, (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA)))


def cloud_commented(rng: Rng, file: Path) -> None:
    first, second, rest = file.read_bytes().split(b"\n", 2)
    head = [first, second, b"comment of no matter"] if file.suffix == ".ply" else [first, b"# of no matter", second]
    file.write_bytes(b"\n".join([*head, rest]))


def torn_tail(rng: Rng, file: Path) -> None:
    """What a kill leaves of a line of a journal."""
    if file.name == "journal.jsonl":
        file.write_bytes(file.read_bytes() + b'["9f3c2a11",{"event":"do'[: int(rng.integers(1, 24))])


NEUTRAL: dict[str, tuple[Any, ...]] = {
    ".parquet": (parquet_packed_otherwise,),
    ".json": (json_in_other_order,),
    ".csv": (csv_quoted,),
    ".toml": (toml_commented,),
    ".npz": (npz_packed_otherwise,),
    ".pcd": (cloud_commented,),
    ".ply": (cloud_commented,),
    ".jsonl": (torn_tail,),
}
