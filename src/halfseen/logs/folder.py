"""Logs on disk: a folder of Parquet files that is there whole or not at all, or the journal of a recorder.

::

    FOLDER/
      logs.json          format, version, the number of rows of each table and, if somebody said, the unit of rewards
      stages.parquet
      trajectories.parquet
      objects.parquet    where the stages have objects
"""

import json
import shlex
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from halfseen.errors import HalfseenError, LogError, within
from halfseen.logs.checks import checked_unit
from halfseen.logs.columns import converting, frame_of
from halfseen.logs.journal import is_journal
from halfseen.logs.missing import Filling
from halfseen.logs.parquet_footer import check_unpacked_table
from halfseen.logs.recorded import journal_log
from halfseen.reading import TABLE, check_file, json_of, read_text, refused
from halfseen.writing import placed

Place = Any
"""A `Path`, or what does the same in a store (``UPath``)."""


def place_of(address: str | Path | Place) -> Place:
    """Find a folder by its path or its address.

    Raises
    ------
    LogError
        There is no such kind of store, or what opens it is not installed.
    """
    if not isinstance(address, str) or not is_remote(address):
        return address if not isinstance(address, str) else Path(address)
    # A store needs a library that nothing else does.
    from upath import UPath

    try:
        place = UPath(address)
        place.fs  # noqa: B018 - what opens the store loads here
    except (ImportError, ValueError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise LogError(f"{address}: it cannot be opened ({reason}); install that, or copy the folder here") from error
    return place


def is_remote(address: str) -> bool:
    """Whether it is the address of a store."""
    return "://" in address


@contextmanager
def asking(place: Place) -> Iterator[None]:
    """Tell what a store answers, whatever its library raises, in one line with the place.

    Raises
    ------
    LogError
        The store refused, or was not reached.
    """
    try:
        yield
    except (HalfseenError, FileNotFoundError):
        raise
    except Exception as error:
        if isinstance(place, Path):
            raise
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise LogError(f"{place}: the store did not answer ({reason}); check the address and your access") from error


MANIFEST = "logs.json"
FORMAT, VERSION = "halfseen-logs", 2
TABLES = ("stages", "trajectories", "objects")
FOREIGN_TABLES = (".csv", ".tsv", ".txt", ".parquet")
"""Files of other programs, of which `halfseen convert` makes logs by a mapping."""
ROWS_IN_GROUP = 65_536
"""Rows that are read at once by anyone who wants one of them."""


class Folder(NamedTuple):
    """A folder of Parquet files, as its manifest describes it."""

    place: Place
    num_rows: dict[str, int]
    """Of each table."""
    reward_unit: str | None
    """What rewards are counted in; None if nobody has said."""
    filling: Filling | None = None
    """What stands for covariates of the stages that are null; None where null is refused."""

    def opened(self, name: str) -> pq.ParquetFile:
        """Open a table.

        Raises
        ------
        LogError
            The file is missing, broken, or has another number of rows.
        """
        file = self.place / f"{name}.parquet"
        # Not read_table, which makes columns of a folder that is called a=b.
        with whole_table(file), asking(self.place):
            if isinstance(file, Path):
                num_bytes = check_file(file, TABLE)
                opened = pq.ParquetFile(file)
                check_unpacked_table(file, num_bytes, opened)
            else:
                opened = pq.ParquetFile(file.open("rb"))
        if opened.metadata.num_rows != self.num_rows[name]:
            raise LogError(
                f"{file}: it has {opened.metadata.num_rows} rows where {MANIFEST} counts {self.num_rows[name]}; files "
                "of two logs are mixed: write the logs again"
            )
        return opened

    def batches(self, name: str, columns: list[str] | None = None) -> Iterator[pa.RecordBatch]:
        """Read some columns of a table, or all, batch by batch.

        Raises
        ------
        LogError
            The file is missing or broken.
        """
        file = self.opened(name)
        with whole_table(self.place / f"{name}.parquet"):
            yield from (batch for batch in file.iter_batches(ROWS_IN_GROUP, columns=columns) if len(batch))


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
    described = read_manifest(folder)
    tables: dict[str, Any] = {}
    for name in described.num_rows:
        with whole_table(folder / f"{name}.parquet"):
            tables[name] = frame_of(described.opened(name).read())
        # What was read is as large again as the table, and Arrow would keep the room.
        pa.default_memory_pool().release_unused()
    return {**tables, "reward_unit": described.reward_unit}


def write_tables(
    folder: Path, tables: Mapping[str, pd.DataFrame], *, overwrite: bool, reward_unit: str | None = None
) -> None:
    """Write tables beside `folder`, then put them in its place by renaming.

    Raises
    ------
    ArgumentError
        The folder exists, holds something other than logs, or cannot be written.
    """
    with placed(folder, overwrite=overwrite, marker=MANIFEST) as fresh:
        for name, table in tables.items():
            arrow = pa.Table.from_pandas(table, preserve_index=False)
            pq.write_table(arrow, fresh / f"{name}.parquet", ROWS_IN_GROUP, compression="zstd")
        write_manifest(Folder(fresh, {name: len(table) for name, table in tables.items()}, reward_unit))


def write_manifest(folder: Folder) -> None:
    """Write down how many rows each table of a folder has, and the unit of rewards if there is one."""
    manifest: dict[str, Any] = {"format": FORMAT, "version": VERSION, "rows": folder.num_rows}
    if folder.reward_unit is not None:
        manifest["reward_unit"] = folder.reward_unit
    (folder.place / MANIFEST).write_text(json.dumps(manifest, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def read_manifest(folder: Place) -> Folder:
    """Read how many rows each table of a folder has, and the unit of rewards.

    Raises
    ------
    LogError
        The folder holds no logs or those of another version, or the unit is no short text.
    """
    _refuse_no_folder(folder)
    file = folder / MANIFEST
    missing = f"it is missing, so {folder} holds no logs; give a folder that Logs.write wrote"
    with refused(file, "it cannot be read", "write the logs again", missing), asking(folder):
        manifest = json_of(read_text(file) if isinstance(file, Path) else file.read_text(encoding="utf-8"))
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise LogError(f"{file}: it does not describe logs; give a folder that Logs.write wrote")
    if manifest.get("version") != VERSION:
        raise LogError(
            f"{file}: version {repr(manifest.get('version'))[:40]} is not the {VERSION} that this halfseen reads; "
            + (converting(folder) if manifest.get("version") == 1 else "read it with the halfseen that wrote it")
        )
    with within(file):
        unit = checked_unit(manifest.get("reward_unit"))
    rows: Any = manifest.get("rows")
    is_right = isinstance(rows, dict) and {"stages", "trajectories"} <= set(rows) <= set(TABLES)
    if not is_right or not all(isinstance(num, int) and num >= 0 for num in rows.values()):
        raise LogError(f"{file}: rows {repr(rows)[:80]} does not count stages and trajectories; write the logs again")
    return Folder(folder, rows, unit)


def _refuse_no_folder(folder: Place) -> None:
    with asking(folder):
        is_there = folder.is_dir()
    if isinstance(folder, Path) and folder.is_file():
        line = f"halfseen convert {shlex.quote(str(folder))} --mapping-template --out cell.toml"
        is_table, others = folder.suffix in FOREIGN_TABLES, "`halfseen convert --help` says which files are read"
        remedy = f"make a mapping of it: {line}" if is_table else others
        raise LogError(f"{folder}: it is a file, and no folder of logs; {remedy}")
    if not is_there:
        wrote = "Logs.write or `halfseen simulate` wrote"
        raise LogError(f"{folder}: there is no such folder; give the folder that {wrote}")


def whole_table(file: Place) -> AbstractContextManager[None]:
    """Refuse a table that cannot be read, and say why (`LogError`)."""
    missing = "it is missing; copy the whole folder, or write the logs again"
    return refused(file, "it is no whole Parquet file", "copy it again, or write the logs again", missing)
