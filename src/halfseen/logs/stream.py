"""A log that need not fit in memory: read a few thousand whole trajectories at a time, in order or by shards.

A shard is whole trajectories that stand one after another, which any process can read alone.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute

from halfseen.arrays import RowMask, Rows
from halfseen.errors import ArgumentError, LogError, within
from halfseen.logs.checked_tables import checked_trajectories
from halfseen.logs.columns import (
    FINISHED,
    NEEDED,
    as_counts,
    as_frame,
    frame_of,
    is_stage_covariate,
    require_columns,
    shown,
)
from halfseen.logs.folder import Folder, Place, place_of, read_manifest, whole_table
from halfseen.logs.logs import Logs
from halfseen.logs.missing import Filling, Missing, learned_filling

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
        ends = {**part.rows, "trajectories": part.trajectories}
        tables = {name: self._tables[name].rows(*rows) for name, rows in ends.items()}
        names = tables["trajectories"]["trajectory"]
        for name, table in tables.items():
            _refuse_others(self._folder.place / f"{name}.parquet", table["trajectory"], names.to_pylist())
        if kept is None:
            return tables
        kept_names = names.take(kept)
        return {name: table.filter(compute.is_in(table["trajectory"], kept_names)) for name, table in tables.items()}


_REMEDY = "write the logs by Logs.write or write_stream, which sort them"


def _refuse_others(file: Place, trajectories: pa.ChunkedArray, names: list[Any]) -> None:
    """Refuse rows of other trajectories than those that stand there."""
    for found, name in zip(trajectories.unique().to_pylist(), names, strict=True):
        if found != name:
            raise LogError(
                f"{file}: rows of trajectory {shown(found)} stand where trajectories.parquet has trajectory "
                f"{shown(name)}; {_REMEDY}"
            )


def logs_of(folder: Folder, parts: Sequence[Tables]) -> Logs:
    """Make a log of the tables of some parts.

    Raises
    ------
    LogError
        It is broken; the trajectory is named.
    """
    tables: dict[str, Any] = {name: pa.concat_tables([part[name] for part in parts]) for name in folder.num_rows}
    with within(folder.place):
        return Logs(**tables, reward_unit=folder.reward_unit, missing=folder.filling)


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
            with whole_table(self._file_name):
                self._held = group, self._file.read_row_group(group)
        return self._held[1]


def shards_of(folder: Folder, trajectories_at_once: int) -> list[Shard]:
    """Deal the parts of a folder into shards, by its size alone.

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
            f"none; {_REMEDY}"
        )
    return np.concatenate([*found, [num_rows]])


TRAJECTORIES_AT_ONCE = 2_000
"""Trajectories that are held in memory at once."""


class LogStream:
    """A folder of logs, read in parts of whole trajectories; every part is checked as `Logs` are.

    Of the trajectories only ends are held. All tables must be sorted by trajectory, as `Logs.write` and `write_stream`
    leave them.

    Parameters
    ----------
    folder
        A folder of Parquet files, or its address in an object store.
    trajectories_at_once
        Trajectories of each part.
    missing
        What stands for covariates of the stages that are null, as `Logs` takes it; it is learned in a pass of its own.

    Attributes
    ----------
    reward_unit
        What rewards are counted in; None if nobody has said.
    as_folder
        What a worker needs to know, to read a shard.

    Raises
    ------
    LogError
        The folder or one of its files is missing or broken, or the trajectories are.
    ArgumentError
        `trajectories_at_once` is below 1, or `missing` is no rule or names no covariate.
    """

    def __init__(
        self, folder: str | Place, trajectories_at_once: int = TRAJECTORIES_AT_ONCE, *, missing: Missing = None
    ) -> None:
        if trajectories_at_once < 1:
            raise ArgumentError(f"trajectories_at_once is {trajectories_at_once}; read at least 1")
        self.folder = place_of(folder)
        self.trajectories_at_once = trajectories_at_once
        self.as_folder = read_manifest(self.folder)
        self.reward_unit = self.as_folder.reward_unit
        for name in self.as_folder.num_rows:
            with within(self.folder):
                columns = as_frame(name, self.as_folder.opened(name).schema_arrow.remove_metadata().empty_table())
                require_columns(name, columns, NEEDED[name])
        with within(self.folder):
            filling = learned_filling(missing, self.stage_covariates, self._column, self.num_stages)
        self.as_folder = self.as_folder._replace(filling=filling)
        # A table of millions of trajectories is larger than all that is held beside it.
        ends = [
            (part["end_s"].to_numpy(), (part["ending"] == FINISHED).to_numpy(bool))
            for part in self._trajectory_tables()
        ]
        if not ends:
            checked_trajectories(as_frame("trajectories", self.as_folder.opened("trajectories").read()))
        self._end_s, self._is_finished = (np.concatenate(each) for each in zip(*ends, strict=True))

    @property
    def trajectories(self) -> pd.DataFrame:
        """One row a trajectory, sorted by trajectory; it is read when it is asked for."""
        return pd.concat(self._trajectory_tables(), ignore_index=True)

    @property
    def num_trajectories(self) -> int:
        """Number n of trajectories."""
        return len(self._end_s)

    @property
    def trajectory_ids(self) -> np.ndarray:
        """Names of the trajectories, shape (n,); they are read when they are asked for."""
        return self.trajectories["trajectory"].to_numpy()

    @property
    def end_s(self) -> Rows:
        """Observed end of each trajectory [s]."""
        return self._end_s

    @property
    def is_finished(self) -> RowMask:
        """True where the trajectory reached its own end, False where it was cut."""
        return self._is_finished

    def shards(self) -> list[Shard]:
        """Deal the parts into shards, by the size of the log alone.

        Raises
        ------
        LogError
            Stages or objects are not sorted by trajectory.
        """
        return shards_of(self.as_folder, self.trajectories_at_once)

    @property
    def horizon(self) -> int:
        """Number of stages T of the longest trajectory."""
        with within(self.folder):
            return max(
                int(as_counts("stages", frame, "stage").max()) for frame in self.stage_columns("trajectory", "stage")
            )

    @property
    def stage_covariates(self) -> list[str]:
        """Names of the stages' covariates, with the columns that tell which were missing."""
        there = [name for name in self.as_folder.opened("stages").schema_arrow.names if is_stage_covariate(name)]
        return there if self.filling is None else [*there, *(name for name in self.filling.flags if name not in there)]

    @property
    def filling(self) -> Filling | None:
        """What stands for covariates that were null; None if null is refused."""
        return self.as_folder.filling

    @property
    def num_stages(self) -> int:
        """Number of stages of all trajectories together."""
        return self.as_folder.num_rows["stages"]

    @property
    def has_objects(self) -> bool:
        """Whether the stages have objects."""
        return "objects" in self.as_folder.num_rows

    @property
    def has_all_actions(self) -> bool:
        """Whether the action of every stage is known, also where a trajectory was cut."""
        return all(bool(frame["action"].notna().all()) for frame in self.stage_columns("action"))

    def stage_columns(self, *names: str) -> Iterator[pd.DataFrame]:
        """Read some columns of the stages alone, row by row as they stand."""
        for batch in self.as_folder.batches("stages", list(names)):
            # What pandas once noted of the table may be broken, and nothing rests on it.
            yield frame_of(pa.Table.from_batches([batch.replace_schema_metadata()]))

    def _column(self, name: str) -> Iterator[Any]:
        return (as_frame("stages", frame)[name] for frame in self.stage_columns(name))

    def __iter__(self) -> Iterator[Logs]:
        """Read the parts, one after the other, from the beginning."""
        reader = ShardReader(self.as_folder)
        return (reader.read(part) for shard in self.shards() for part in shard.parts)

    def _trajectory_tables(self) -> Iterator[pd.DataFrame]:
        """Read the table of trajectories in parts, each checked, and sorted after the one before."""
        last: Any = None
        for batch in self.as_folder.batches("trajectories"):
            with within(self.folder):
                frame = as_frame("trajectories", pa.Table.from_batches([batch]))
                trajectories = checked_trajectories(frame)
                names = trajectories["trajectory"].to_numpy()
                if not (names == frame["trajectory"].to_numpy()).all() or (last is not None and not names[0] > last):
                    raise LogError(f"trajectories.parquet is not sorted by trajectory, or has one twice; {_REMEDY}")
            last = names[-1]
            yield trajectories
