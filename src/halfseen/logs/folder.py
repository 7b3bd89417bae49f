"""Logs on disk: a folder of Parquet files, written all or nothing, or the journal of a recorder; and its shards.

::

    FOLDER/
      logs.json          format, version, number of rows of each table and, if known, the unit of rewards
      stages.parquet
      trajectories.parquet
      objects.parquet    if the stages have objects

A shard is a run of whole, consecutive trajectories that any process can read on its own.
"""

import shlex
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pyarrow.parquet as pq

from halfseen.errors import ArgumentError, HalfseenError, LogError, within
from halfseen.logs.checks import checked_unit
from halfseen.logs.columns import converting
from halfseen.logs.frames import frame_of
from halfseen.logs.journal import is_journal
from halfseen.logs.missing import Filling
from halfseen.logs.parquet import FORMAT, MANIFEST, ROWS_IN_GROUP, TABLES, VERSION, parquet_file
from halfseen.logs.recorded import journal_log
from halfseen.reading import json_of, read_text, refused

Place = Any
"""A `Path`, or its counterpart in an object store (``UPath``)."""


def place_of(address: str | Path | Place) -> Place:
    """The folder at a path or an address in a store.

    Raises
    ------
    ArgumentError
        It is no path.
    LogError
        The kind of store is unknown, or the library that opens it is not installed.
    """
    if not isinstance(address, str) and not hasattr(address, "is_dir"):
        raise ArgumentError(f"folder is a {type(address).__name__}; give the path of a folder")
    if not isinstance(address, str) or not is_remote(address):
        return address if not isinstance(address, str) else Path(address)
    # Only stores need this library.
    from upath import UPath

    try:
        place = UPath(address)
        place.fs  # noqa: B018 - loads the library that opens the store
    except (ImportError, ValueError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise LogError(
            f"{address}: it cannot be opened ({reason}); install what is missing, or copy the folder to this machine"
        ) from error
    return place


def is_remote(address: str) -> bool:
    """Whether this is an address in a store."""
    return "://" in address


@contextmanager
def asking(place: Place) -> Iterator[None]:
    """Report any error of a store's library in one line with the place.

    Raises
    ------
    LogError
        The store refused the request or could not be reached.
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


TEXT_FILES, JSON_LINES, WORKBOOKS = (".csv", ".tsv", ".txt"), (".jsonl", ".ndjson"), (".xlsx", ".xlsm")
FOREIGN_TABLES = (*TEXT_FILES, *JSON_LINES, *(f"{each}.gz" for each in TEXT_FILES + JSON_LINES), ".parquet", *WORKBOOKS)
"""Files of other programs that `halfseen convert` turns into logs by a mapping."""
PACKED = (".gz", ".zip", ".zst", ".bz2", ".xz", ".7z", ".tar", ".tgz")
"""Files that hold other files."""
DATABASES = {".db": "sqlite", ".sqlite": "sqlite", ".sqlite3": "sqlite", ".duckdb": "duckdb"}
"""Names of databases in SQLAlchemy, by file extension."""
MOST_PARTS = 64
"""Largest number of parts in a shard; losing a worker loses its shard."""
NUM_SHARDS = 64
"""Smallest number of shards of a log with enough parts."""
compute: Any = pyarrow.compute
UNSORTED = "write the logs with Logs.write or write_stream, which sort them"
"""Remedy for a folder with unsorted tables."""


class Folder(NamedTuple):
    """A folder of Parquet files, as its manifest describes it."""

    place: Place
    num_rows: dict[str, int]
    """Number of rows of each table."""
    reward_unit: str | None
    """Unit of the rewards; None if unknown."""
    filling: Filling | None = None
    """Values that replace null in covariates of the stages; None if null is refused."""

    def opened(self, name: str) -> pq.ParquetFile:
        """Open a table.

        Raises
        ------
        LogError
            The file is missing, broken, or has another number of rows.
        """
        file = self.place / f"{name}.parquet"
        # Not read_table: it turns a folder name such as a=b into a column.
        with whole_table(file), asking(self.place):
            opened = parquet_file(file) if isinstance(file, Path) else pq.ParquetFile(file.open("rb"))
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
    """Read the arguments of `Logs`, by name, whether `Logs.write` or a `LogRecorder` wrote the folder.

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
        # The buffers read are as large as the table, and Arrow would keep their memory.
        pa.default_memory_pool().release_unused()
    return {**tables, "reward_unit": described.reward_unit}


def read_manifest(folder: Place) -> Folder:
    """Read how many rows each table of a folder has, and the unit of rewards.

    Raises
    ------
    LogError
        The folder holds no logs or logs of another version, or the unit is not a short text.
    """
    refuse_no_folder(folder)
    file = folder / MANIFEST
    missing = f"it is missing, so {folder} holds no logs; {_way_to(folder)}"
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


def _way_to(folder: Place) -> str:
    """Hint at the command that reads a folder which holds no logs."""
    try:
        is_none = isinstance(folder, Path) and not (folder / MANIFEST).exists()
        has_tables = is_none and any(file.name.lower().endswith(FOREIGN_TABLES) for file in folder.iterdir())
    except OSError:  # the reader of the manifest tells of it
        has_tables = False
    line = f"halfseen convert {shlex.quote(str(folder))} --mapping-template --out cell.toml"
    return f"make a mapping of its tables: {line}" if has_tables else "give a folder that Logs.write wrote"


def _way_in(file: Path) -> str:
    """Hint at the command that reads a file of another program."""
    kind = file.suffix.lower()
    if file.name.lower().endswith(FOREIGN_TABLES):
        line = f"halfseen convert {shlex.quote(str(file))} --mapping-template --out cell.toml"
        return f"make a mapping of it: {line}"
    if kind in PACKED:
        return "unpack it, and read its contents"
    if kind in DATABASES:
        url = shlex.quote(f"sql:{DATABASES[kind]}:///{file}")
        return f"read the database by its SELECTs: halfseen convert {url} --mapping cell.toml --out LOGS"
    return "`halfseen convert --help` lists the files that are read, by extension"


def refuse_no_folder(folder: Place) -> None:
    """Refuse a path that is not a folder, and name the command that reads it if it is a file (`LogError`)."""
    with asking(folder):
        is_there = folder.is_dir()
    if isinstance(folder, Path) and folder.is_file():
        raise LogError(f"{folder}: it is a file, not a folder of logs; {_way_in(folder)}")
    if not is_there:
        wrote = "Logs.write or `halfseen simulate` wrote"
        raise LogError(f"{folder}: no such folder; give the folder that {wrote}")


def whole_table(file: Place) -> AbstractContextManager[None]:
    """Refuse a table that cannot be read, with the reason (`LogError`)."""
    missing = "it is missing; copy the whole folder, or write the logs again"
    return refused(file, "it is not a complete Parquet file", "copy it again, or write the logs again", missing)


class LogPart(NamedTuple):
    """Trajectories that are held in memory at once."""

    number: int
    trajectories: tuple[int, int]
    """Rows of the table of trajectories: the first, and the one after the last."""
    rows: dict[str, tuple[int, int]]
    """The same for the other tables."""


class Shard(NamedTuple):
    """Parts that are read one after the other."""

    number: int
    parts: tuple[LogPart, ...]

    @property
    def trajectories(self) -> slice:
        """Rows of the table of trajectories."""
        return slice(self.parts[0].trajectories[0], self.parts[-1].trajectories[1])


class TableInGroups:
    """A table of a folder, read by row group; the last row group is cached."""

    def __init__(self, folder: Folder, name: str) -> None:
        self._file_name = folder.place / f"{name}.parquet"
        self._file = folder.opened(name)
        sizes = [self._file.metadata.row_group(group).num_rows for group in range(self._file.num_row_groups)]
        self._begin = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])
        self._group = lru_cache(maxsize=1)(self._file.read_row_group)

    def rows(self, begin: int, end: int) -> pa.Table:
        """Read a range of rows (`LogError` if the file is broken)."""
        first = int(np.searchsorted(self._begin, begin, side="right")) - 1
        last = int(np.searchsorted(self._begin, end, side="left"))
        with whole_table(self._file_name):
            groups = [self._group(group) for group in range(first, last)]
        return pa.concat_tables(groups).slice(begin - int(self._begin[first]), end - begin)


def shards_of(folder: Folder, trajectories_at_once: int) -> list[Shard]:
    """Divide the parts of a folder into shards, depending on its size alone.

    Raises
    ------
    LogError
        A table is not grouped by trajectory, or lacks rows of a trajectory.
    """
    num_trajectories = folder.num_rows["trajectories"]
    ends = {name: _ends(folder, name, trajectories_at_once) for name in folder.num_rows if name != "trajectories"}
    parts = []
    for number, first in enumerate(range(0, num_trajectories, trajectories_at_once)):
        rows = {name: (int(end[number]), int(end[number + 1])) for name, end in ends.items()}
        parts.append(LogPart(number, (first, min(first + trajectories_at_once, num_trajectories)), rows))
    size = min(max(len(parts) // NUM_SHARDS, 1), MOST_PARTS)
    groups = [parts[first : first + size] for first in range(0, len(parts), size)]
    return [Shard(number, tuple(group)) for number, group in enumerate(groups)]


def _ends(folder: Folder, name: str, trajectories_at_once: int) -> np.ndarray:
    """First row of each part in a table, followed by the number of its rows."""
    found, num_trajectories, num_rows, last = [], 0, 0, None
    for column in folder.batches(name, ["trajectory"]):
        is_new = np.ones(len(column), dtype=bool)
        values = column["trajectory"]
        differs = compute.fill_null(compute.not_equal(values.slice(1), values.slice(0, len(values) - 1)), True)
        is_new[1:] = differs.to_numpy(zero_copy_only=False)
        is_new[0] = last is None or values[0].as_py() != last
        at = np.flatnonzero(is_new)
        numbers = num_trajectories + np.arange(len(at))
        found.append(num_rows + at[numbers % trajectories_at_once == 0])
        num_trajectories, num_rows, last = num_trajectories + len(at), num_rows + len(column), values[-1].as_py()
    if num_trajectories != folder.num_rows["trajectories"]:
        raise LogError(
            f"{folder.place / name}.parquet: the rows of a trajectory are not adjacent, or a trajectory has none; "
            f"{UNSORTED}"
        )
    return np.concatenate([*found, [num_rows]])
