"""Shards of a folder of logs: whole trajectories that stand one after another, which can be read alone, by anyone."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute

from halfseen.errors import LogError, within
from halfseen.logs.folder import Folder, broken_table
from halfseen.logs.logs import Logs

MOST_PARTS = 64
"""Of a shard; a worker that is lost takes with it what it was to read."""
NUM_SHARDS = 64
"""Of a log with enough parts, at least."""
compute: Any = pyarrow.compute


Tables = dict[str, pa.Table]
"""By name."""


class Part(NamedTuple):
    """Trajectories that are held in memory at once."""

    number: int
    trajectories: tuple[int, int]
    """Rows of the table of trajectories: the first, and the one after the last."""
    rows: dict[str, tuple[int, int]]
    """Of the other tables."""


class Shard(NamedTuple):
    """Parts that are read one after the other."""

    number: int
    parts: tuple[Part, ...]

    @property
    def trajectories(self) -> slice:
        """Rows of the table of trajectories."""
        return slice(self.parts[0].trajectories[0], self.parts[-1].trajectories[1])


class ShardReader:
    """Reads parts of a folder, each from the groups of rows that hold it.

    Parameters
    ----------
    folder
        The folder.
    """

    def __init__(self, folder: Folder) -> None:
        self._folder = folder
        self._tables = {name: _Table(folder, name) for name in folder.num_rows}

    def read(self, part: Part) -> Logs:
        """Read a part.

        Raises
        ------
        LogError
            A file is broken, or the part is; the trajectory is named.
        """
        return logs_of(self._folder, [self.tables(part)])

    def tables(self, part: Part, kept: np.ndarray | None = None) -> Tables:
        """Read a part, or some of its trajectories, and check nothing.

        Parameters
        ----------
        part
            Which.
        kept
            Numbers of the trajectories to keep, counted from the beginning of the part; None for all.
        """
        tables = {
            name: self._tables[name].rows(*ends)
            for name, ends in {**part.rows, "trajectories": part.trajectories}.items()
        }
        if kept is None:
            return tables
        names = tables["trajectories"]["trajectory"].take(kept)
        return {name: table.filter(compute.is_in(table["trajectory"], names)) for name, table in tables.items()}


def logs_of(folder: Folder, parts: Sequence[Tables]) -> Logs:
    """Make a log of the tables of some parts.

    Raises
    ------
    LogError
        It is broken; the trajectory is named.
    """
    tables: dict[str, Any] = {name: pa.concat_tables([part[name] for part in parts]) for name in folder.num_rows}
    with within(folder.place):
        return Logs(**tables, reward_unit=folder.reward_unit)


class _Table:
    def __init__(self, folder: Folder, name: str) -> None:
        self._file_name = folder.place / f"{name}.parquet"
        self._file = folder.opened(name)
        sizes = [self._file.metadata.row_group(group).num_rows for group in range(self._file.num_row_groups)]
        self._begin = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])
        self._held: tuple[int, pa.Table] | None = None

    def rows(self, begin: int, end: int) -> pa.Table:
        first = int(np.searchsorted(self._begin, begin, side="right")) - 1
        last = int(np.searchsorted(self._begin, end, side="left"))
        groups = [self._group(group) for group in range(first, last)]
        return pa.concat_tables(groups).slice(begin - int(self._begin[first]), end - begin)

    def _group(self, group: int) -> pa.Table:
        if self._held is None or self._held[0] != group:
            try:
                self._held = group, self._file.read_row_group(group)
            except (OSError, pa.ArrowException) as error:
                raise broken_table(self._file_name, error) from error
        return self._held[1]


def shards_of(folder: Folder, trajectories_at_once: int) -> list[Shard]:
    """Deal the parts of a folder into shards, by its size alone.

    Parameters
    ----------
    folder
        The folder, whose tables are sorted by trajectory.
    trajectories_at_once
        Trajectories of a part.

    Raises
    ------
    LogError
        A table has not as many trajectories, one after another, as that of the trajectories.
    """
    num_trajectories = folder.num_rows["trajectories"]
    ends = {name: _ends(folder, name, trajectories_at_once) for name in folder.num_rows if name != "trajectories"}
    parts = []
    for number, first in enumerate(range(0, num_trajectories, trajectories_at_once)):
        rows = {name: (int(end[number]), int(end[number + 1])) for name, end in ends.items()}
        parts.append(Part(number, (first, min(first + trajectories_at_once, num_trajectories)), rows))
    size = min(max(len(parts) // NUM_SHARDS, 1), MOST_PARTS)
    groups = [parts[first : first + size] for first in range(0, len(parts), size)]
    return [Shard(number, tuple(group)) for number, group in enumerate(groups)]


def _ends(folder: Folder, name: str, trajectories_at_once: int) -> np.ndarray:
    """Rows of a table in which parts begin, and the number of its rows."""
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
            f"{folder.place / name}.parquet: the rows of its trajectories do not stand together, or a trajectory has "
            "none; write the logs by Logs.write or write_stream, which sort them"
        )
    return np.concatenate([*found, [num_rows]])


def tables_of_size(batches: Iterable[pa.RecordBatch], size: int) -> Iterator[pa.Table]:
    """Put batches together, and cut them into tables of as many rows each, but for the last one."""
    held: list[pa.RecordBatch] = []
    for batch in batches:
        held.append(batch)
        while sum(map(len, held)) >= size:
            table = pa.Table.from_batches(held)
            yield table.slice(0, size)
            held = table.slice(size).to_batches()
    if held:
        yield pa.Table.from_batches(held)
