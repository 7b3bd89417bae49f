"""Mutations that must not matter: the answer is that for the unbroken input."""

import csv
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from fuzz.hostile import pick
from fuzz.in_structure import members_of, zip_members

Rng = np.random.Generator


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
