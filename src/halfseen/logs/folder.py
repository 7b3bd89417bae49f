"""Logs on disk: a folder of Parquet files that is there whole or not at all, or the journal of a recorder.

::

    FOLDER/
      logs.json          format, version and the number of rows of each table
      stages.parquet
      paths.parquet
      objects.parquet    where the stages have objects
"""

import json
import shutil
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from halfseen.errors import ArgumentError, LogError
from halfseen.logs.journal import JOURNAL
from halfseen.logs.journal_tables import journal_tables

MANIFEST = "logs.json"
FORMAT, VERSION = "halfseen-logs", 1
TABLES = ("stages", "paths", "objects")


def read_tables(folder: Path) -> Mapping[str, pd.DataFrame | pa.Table]:
    """Read the tables of a folder, by name, whether `Logs.write` or a `LogRecorder` wrote it.

    Raises
    ------
    LogError
        The folder or one of its files is missing, broken or of another version.
    """
    if (folder / JOURNAL).is_file() and not (folder / MANIFEST).exists():
        return journal_tables(folder / JOURNAL)
    return {name: _read_table(folder / f"{name}.parquet", count) for name, count in _read_manifest(folder).items()}


def write_tables(folder: Path, tables: Mapping[str, pd.DataFrame | None], *, overwrite: bool) -> None:
    """Write tables beside `folder`, then put them in its place by renaming.

    Parameters
    ----------
    folder
        Where to.
    tables
        The tables by name; None is left out.
    overwrite
        Replace logs that are already there.

    Raises
    ------
    ArgumentError
        The folder exists, holds something other than logs, or cannot be written.
    """
    _check_target(folder, overwrite)
    target = folder.resolve()
    tag = uuid.uuid4().hex
    fresh, old = target.with_name(f".{target.name}.{tag}.new"), target.with_name(f".{target.name}.{tag}.old")
    try:
        fresh.mkdir(parents=True)
        _write_files(fresh, {name: table for name, table in tables.items() if table is not None})
        _swap(fresh, target, old)
    except OSError as error:
        raise ArgumentError(
            f"{folder}: cannot be written ({error.strerror or error}); choose another folder"
        ) from error
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def _check_target(folder: Path, overwrite: bool) -> None:
    try:
        is_there, is_logs = folder.exists(), (folder / MANIFEST).exists()
    except OSError as error:
        raise ArgumentError(f"{folder}: cannot be written ({error.strerror}); choose another folder") from error
    if is_there and not overwrite:
        raise ArgumentError(
            f"{folder}: it is there already; choose another folder, or pass overwrite=True to replace it"
        )
    if is_there and not is_logs:
        raise ArgumentError(
            f"{folder}: it holds no logs ({MANIFEST} is missing), so it is not replaced; choose another folder"
        )


def _write_files(folder: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    for name, table in tables.items():
        arrow = pa.Table.from_pandas(table, preserve_index=False)
        pq.write_table(arrow, folder / f"{name}.parquet", compression="zstd")
    manifest = {"format": FORMAT, "version": VERSION, "rows": {name: len(table) for name, table in tables.items()}}
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")


def _swap(fresh: Path, target: Path, old: Path) -> None:
    """Put `fresh` in the place of `target`; what was there comes back if that fails."""
    if not target.exists():
        fresh.rename(target)
        return
    target.rename(old)
    try:
        fresh.rename(target)
    except OSError:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _read_manifest(folder: Path) -> dict[str, int]:
    file = folder / MANIFEST
    if not folder.is_dir():
        raise LogError(
            f"{folder}: there is no such folder; give the folder that Logs.write or `halfseen simulate` wrote"
        )
    try:
        manifest: Any = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise LogError(
            f"{file}: it is missing, so {folder} holds no logs; give a folder that Logs.write wrote"
        ) from error
    except (OSError, ValueError) as error:
        raise LogError(f"{file}: it cannot be read ({error}); write the logs again") from error
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise LogError(f"{file}: it does not describe logs; give a folder that Logs.write wrote")
    if manifest.get("version") != VERSION:
        raise LogError(
            f"{file}: version {manifest.get('version')!r} is not the {VERSION} that this halfseen reads; read it with "
            "the halfseen that wrote it, or write the logs again"
        )
    return _checked_rows(file, manifest.get("rows"))


def _checked_rows(file: Path, rows: Any) -> dict[str, int]:
    is_right = isinstance(rows, dict) and {"stages", "paths"} <= set(rows) <= set(TABLES)
    if not is_right:
        raise LogError(f"{file}: rows {rows!r} does not count stages and paths; write the logs again")
    return rows


def _read_table(file: Path, num_rows: int) -> pd.DataFrame:
    try:
        # Not read_table, which makes columns of a folder that is called a=b.
        table = pq.ParquetFile(file).read()
    except FileNotFoundError as error:
        raise LogError(f"{file}: it is missing; copy the whole folder, or write the logs again") from error
    except (OSError, pa.ArrowException) as error:
        reason = str(error).splitlines()[0]
        raise LogError(
            f"{file}: it is no whole Parquet file ({reason}); copy it again, or write the logs again"
        ) from error
    if table.num_rows != num_rows:
        raise LogError(
            f"{file}: it has {table.num_rows} rows where {MANIFEST} counts {num_rows}; files of two logs are mixed: "
            "write the logs again"
        )
    return table.to_pandas()
