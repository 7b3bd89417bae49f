"""Logs on disk: a folder of Parquet files that is there whole or not at all, or the journal of a recorder.

::

    FOLDER/
      logs.json          format, version, the number of rows of each table and, if somebody said, the unit of rewards
      stages.parquet
      trajectories.parquet
      objects.parquet    where the stages have objects
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from halfseen.errors import HalfseenError, LogError, within
from halfseen.logs.columns import checked_unit, converting
from halfseen.logs.journal import is_journal
from halfseen.logs.parquet.size import check_unpacked_table
from halfseen.logs.place import Place, asking
from halfseen.logs.recorded import journal_log
from halfseen.reading import TABLE, check_file, json_of, read_text, reason_of
from halfseen.writing import placed

MANIFEST = "logs.json"
FORMAT, VERSION = "halfseen-logs", 2
TABLES = ("stages", "trajectories", "objects")
ROWS_IN_GROUP = 65_536
"""Rows that are read at once by whoever wants one of them."""


class Manifest(NamedTuple):
    """What logs.json says."""

    rows: dict[str, int]
    """Of each table."""
    reward_unit: str | None
    """What rewards are counted in; None if nobody has said."""


def read_folder(folder: Place) -> dict[str, Any]:
    """Read what `Logs` is made of, by name, whether `Logs.write` or a `LogRecorder` wrote the folder.

    Raises
    ------
    LogError
        The folder or one of its files is missing, broken or of another version.
    """
    is_here = isinstance(folder, Path)
    if is_here and not (folder / MANIFEST).exists() and is_journal(folder):
        return journal_log(folder)
    manifest = read_manifest(folder)
    tables = {name: _read_table(folder, name, count) for name, count in manifest.rows.items()}
    return {**tables, "reward_unit": manifest.reward_unit}


def write_tables(
    folder: Path, tables: Mapping[str, pd.DataFrame], *, overwrite: bool, reward_unit: str | None = None
) -> None:
    """Write tables beside `folder`, then put them in its place by renaming.

    Parameters
    ----------
    folder
        Where to.
    tables
        The tables by name.
    overwrite
        Replace logs that are already there.
    reward_unit
        What rewards are counted in; None if nobody has said.

    Raises
    ------
    ArgumentError
        The folder exists, holds something other than logs, or cannot be written.
    """
    with placed(folder, overwrite=overwrite, marker=MANIFEST) as fresh:
        for name, table in tables.items():
            arrow = pa.Table.from_pandas(table, preserve_index=False)
            pq.write_table(arrow, fresh / f"{name}.parquet", ROWS_IN_GROUP, compression="zstd")
        write_manifest(fresh, Manifest({name: len(table) for name, table in tables.items()}, reward_unit))


def write_manifest(folder: Path, told: Manifest) -> None:
    """Write down how many rows each table of a folder has, and the unit of rewards if there is one."""
    manifest: dict[str, Any] = {"format": FORMAT, "version": VERSION, "rows": told.rows}
    if told.reward_unit is not None:
        manifest["reward_unit"] = told.reward_unit
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def read_manifest(folder: Place) -> Manifest:
    """Read how many rows each table of a folder has, and the unit of rewards.

    Raises
    ------
    LogError
        The folder holds no logs or those of another version, or the unit is no short text.
    """
    file = folder / MANIFEST
    with asking(folder):
        is_there = folder.is_dir()
    if not is_there:
        raise LogError(
            f"{folder}: there is no such folder; give the folder that Logs.write or `halfseen simulate` wrote"
        )
    try:
        with asking(folder):
            manifest = json_of(read_text(file) if isinstance(file, Path) else file.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise LogError(
            f"{file}: it is missing, so {folder} holds no logs; give a folder that Logs.write wrote"
        ) from error
    except (OSError, ValueError) as error:
        raise LogError(f"{file}: it cannot be read ({reason_of(error)}); write the logs again") from error
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise LogError(f"{file}: it does not describe logs; give a folder that Logs.write wrote")
    if manifest.get("version") != VERSION:
        raise LogError(
            f"{file}: version {repr(manifest.get('version'))[:40]} is not the {VERSION} that this halfseen reads; "
            + (converting(folder) if manifest.get("version") == 1 else "read it with the halfseen that wrote it")
        )
    with within(file):
        unit = checked_unit(manifest.get("reward_unit"))
    return Manifest(_checked_rows(file, manifest.get("rows")), unit)


def _checked_rows(file: Place, rows: Any) -> dict[str, int]:
    is_right = isinstance(rows, dict) and {"stages", "trajectories"} <= set(rows) <= set(TABLES)
    is_right = is_right and all(isinstance(num, int) and num >= 0 for num in rows.values())
    if not is_right:
        raise LogError(f"{file}: rows {repr(rows)[:80]} does not count stages and trajectories; write the logs again")
    return rows


def opened_table(folder: Place, name: str, num_rows: int) -> pq.ParquetFile:
    """Open a table of a folder, which the manifest says to have so many rows.

    Raises
    ------
    LogError
        The file is missing, broken, or has another number of rows.
    """
    file = folder / f"{name}.parquet"
    try:
        # Not read_table, which makes columns of a folder that is called a=b.
        with asking(folder):
            if isinstance(file, Path):
                num_bytes = check_file(file, TABLE)
                opened = pq.ParquetFile(file)
                check_unpacked_table(file, num_bytes, opened)
            else:
                opened = pq.ParquetFile(file.open("rb"))
    except FileNotFoundError as error:
        raise LogError(f"{file}: it is missing; copy the whole folder, or write the logs again") from error
    except MemoryError:
        raise
    except Exception as error:  # a broken file raises nearly anything
        raise broken_table(file, error) from error
    if opened.metadata.num_rows != num_rows:
        raise LogError(
            f"{file}: it has {opened.metadata.num_rows} rows where {MANIFEST} counts {num_rows}; files of two logs are "
            "mixed: write the logs again"
        )
    return opened


def _read_table(folder: Place, name: str, num_rows: int) -> pd.DataFrame:
    try:
        return opened_table(folder, name, num_rows).read().to_pandas()
    except (HalfseenError, MemoryError):
        raise
    except Exception as error:  # pandas' own words in a broken file raise nearly anything
        raise broken_table(folder / f"{name}.parquet", error) from error


def broken_table(file: Place, error: Exception) -> LogError:
    """Say that a table cannot be read, and why."""
    return LogError(f"{file}: it is no whole Parquet file ({reason_of(error)}); copy it again, or write the logs again")
