"""Logs of version 1, in which a trajectory was a *path*: the table, its column, and the key in a journal."""

import json
import re
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from halfseen.errors import HalfseenError, LogError
from halfseen.logs import parquet
from halfseen.logs.folder import Place, asking, read_folder
from halfseen.logs.formats import csv_folder
from halfseen.logs.journal import OLDER, VERSION, journal_line, journal_parts
from halfseen.logs.logs import Logs
from halfseen.reading import TABLE, json_of, opened, refused

TABLES = {"paths": "trajectories"}
COLUMNS = {"path": "trajectory", "run_path": "run_trajectory"}
"""Current names of tables and columns, by their former names."""


def is_older(folder: Place) -> bool:
    """Whether a folder holds logs of version 1."""
    with asking(folder):
        is_table = any((folder / f"paths.{kind}").exists() for kind in ("parquet", "csv"))
    return is_table or (isinstance(folder, Path) and _is_older_journal(folder))


def read_older(folder: Place) -> Logs:
    """Read logs of version 1.

    Raises
    ------
    LogError
        A file is missing or broken, or the tables violate an invariant.
    """
    with _as_of_today(folder) as translated:
        try:
            is_csv = (translated / "stages.csv").exists()
            return csv_folder.read_csv(translated) if is_csv else Logs(**read_folder(translated))
        except HalfseenError as error:
            # An error in the translation is an error in the folder: name that.
            raise LogError(f"{folder}: {str(error).replace(f'{translated}/', '')}") from error


@contextmanager
def _as_of_today(folder: Place) -> Iterator[Path]:
    with TemporaryDirectory() as made:
        translated = Path(made)
        with asking(folder):
            files = [file for file in folder.iterdir() if file.suffix in _TRANSLATIONS]
        for file in files:
            with refused(file, "it cannot be read", "copy it again"), asking(folder):
                _TRANSLATIONS[file.suffix](file, translated / (TABLES.get(file.stem, file.stem) + file.suffix))
        yield translated


def _table(file: Place, to: Path) -> None:
    with file.open("rb") as source:
        opened = pq.ParquetFile(source)
        schema = pa.schema([field.with_name(COLUMNS.get(field.name, field.name)) for field in opened.schema_arrow])
        with pq.ParquetWriter(to, schema) as writer:
            for number in range(opened.num_row_groups):
                writer.write_table(opened.read_row_group(number).rename_columns(schema.names))


def _manifest(file: Place, to: Path) -> None:
    manifest = json_of(file.read_text(encoding="utf-8"))
    counted = {"rows": manifest.get("rows"), "tables": manifest.get("tables")}
    renamed: dict[str, Any] = {key: _renamed(value) for key, value in counted.items() if value is not None}
    version = {parquet.FORMAT: parquet.VERSION, csv_folder.FORMAT: csv_folder.VERSION}.get(str(manifest.get("format")))
    to.write_text(json.dumps(manifest | renamed | {"version": version}), encoding="utf-8")


def _cells(file: Place, to: Path) -> None:
    heading, *rows = file.read_bytes().split(b"\n", 1)
    names = re.sub(
        r'(?<![^,"])(path|run_path)(?![^,"\r])', lambda found: COLUMNS[found[1]], heading.decode("utf-8-sig")
    )
    to.write_bytes(b"\n".join([names.encode(), *rows]))


def _journal(file: Place, to: Path) -> None:
    """Rechain the lines; those that failed the check before fail it again."""
    above: int | None = 0
    checksum: int | None = 0
    with file.open("rb") as source, to.open("wb") as target:
        for line in source:
            body, stated = line[12:-2], line[2:10]
            begins = next((begin for begin in (above, 0) if _follows(body, begin, stated)), None)
            if begins is None:
                above = checksum = int(stated, 16) if re.fullmatch(rb"[0-9a-f]{8}", stated) else None
                target.write(line)
                continue
            event: dict[str, Any] = {str(COLUMNS.get(key, key)): value for key, value in json.loads(body).items()}
            event |= {"version": VERSION} if event["event"] == "journal" else {}
            written, checksum = journal_line(event, checksum if begins == above and checksum is not None else 0)
            above = int(stated, 16)
            target.write(written)


def _follows(body: bytes, begin: int | None, stated: bytes) -> bool:
    return begin is not None and b"%08x" % zlib.crc32(body, begin) == stated


def _renamed(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return {(TABLES | COLUMNS).get(key, key): _renamed(inner) for key, inner in value.items()}


_TRANSLATIONS = {".parquet": _table, ".json": _manifest, ".csv": _cells, ".jsonl": _journal}


def _is_older_journal(folder: Path) -> bool:
    first = next(iter(journal_parts(folder)), None)
    if first is None:
        return False
    header, _ = journal_line(OLDER, 0)
    with refused(first, "it cannot be read", "copy it again"), opened(first, TABLE) as file:
        return file.readline(len(header)) == header
