"""Reading a log in any format, whole or, if it need not fit in memory, a few thousand trajectories at a time."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute

from halfseen.arrays import RowMask, Rows
from halfseen.errors import ArgumentError, LogError, within
from halfseen.estimator import is_count
from halfseen.logs.checked_tables import checked_trajectories
from halfseen.logs.columns import FINISHED, NEEDED, as_counts, is_stage_covariate, require_columns, shown
from halfseen.logs.folder import (
    UNSORTED,
    Folder,
    LogPart,
    Place,
    Shard,
    TableInGroups,
    place_of,
    read_folder,
    read_manifest,
    shards_of,
)
from halfseen.logs.frames import as_frame, frame_of
from halfseen.logs.logs import Logs
from halfseen.logs.missing import Filling, Missing, learned_filling
from halfseen.logs.parquet import MANIFEST

compute: Any = pyarrow.compute


Tables = dict[str, pa.Table]
"""Tables by name."""


class ShardReader:
    """Reads parts of a folder, each from the row groups that contain it."""

    def __init__(self, folder: Folder) -> None:
        self._folder = folder
        self._tables = {name: TableInGroups(folder, name) for name in folder.num_rows}

    def read(self, part: LogPart) -> Logs:
        """Read a part.

        Raises
        ------
        LogError
            A file or the part is broken; the message names the trajectory.
        """
        return logs_of(self._folder, [self.tables(part)])

    def tables(self, part: LogPart, kept: np.ndarray | None = None) -> Tables:
        """Read a part, or some of its trajectories, without checks.

        Parameters
        ----------
        part
            The part.
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


def _refuse_others(file: Place, trajectories: pa.ChunkedArray, names: list[Any]) -> None:
    """Refuse rows of trajectories other than those in `names`."""
    for found, name in zip(trajectories.unique().to_pylist(), names, strict=True):
        if found != name:
            raise LogError(
                f"{file}: rows of trajectory {shown(found)} are where trajectories.parquet has trajectory "
                f"{shown(name)}; {UNSORTED}"
            )


def logs_of(folder: Folder, parts: Sequence[Tables]) -> Logs:
    """Make a log from the tables of some parts.

    Raises
    ------
    LogError
        A part is broken; the message names the trajectory.
    """
    tables: dict[str, Any] = {name: pa.concat_tables([part[name] for part in parts]) for name in folder.num_rows}
    with within(folder.place):
        return Logs(**tables, reward_unit=folder.reward_unit, missing=folder.filling)


TRAJECTORIES_AT_ONCE = 2_000
"""Trajectories that are held in memory at once."""


class LogStream:
    """A folder of logs, read in parts of whole trajectories; every part is checked as `Logs` are.

    Only the ends of the trajectories stay in memory. All tables must be sorted by trajectory, as `Logs.write` and
    `write_stream` write them.

    Parameters
    ----------
    folder
        A folder of Parquet files, or its address in an object store.
    trajectories_at_once
        Number of trajectories in each part.
    missing
        What replaces null in covariates of the stages, as in `Logs`; it is learned in a separate pass.

    Raises
    ------
    LogError
        The folder or one of its files is missing or broken, or the trajectories are invalid.
    ArgumentError
        `trajectories_at_once` is below 1, or `missing` is not a known rule or names a column that is not a covariate.
    """

    as_folder: Folder
    """Description of the folder, with which a worker reads a shard."""
    reward_unit: str | None
    """Unit of the rewards; None if unknown."""
    num_stages: int
    """Number of stages in all trajectories."""
    has_objects: bool
    """Whether the stages have objects."""
    end_s: Rows
    """Observed end of each trajectory [s]."""
    is_finished: RowMask
    """True where the trajectory reached its own end, False where it was cut."""

    def __init__(
        self, folder: str | Place, trajectories_at_once: int = TRAJECTORIES_AT_ONCE, *, missing: Missing = None
    ) -> None:
        if not is_count(trajectories_at_once):
            raise ArgumentError(f"trajectories_at_once is {trajectories_at_once!r}; read at least 1")
        self.folder = place_of(folder)
        self.trajectories_at_once = trajectories_at_once
        self.as_folder = read_manifest(self.folder)
        self.reward_unit = self.as_folder.reward_unit
        self.num_stages, self.has_objects = self.as_folder.num_rows["stages"], "objects" in self.as_folder.num_rows
        for name in self.as_folder.num_rows:
            with within(self.folder):
                columns = as_frame(name, self.as_folder.opened(name).schema_arrow.remove_metadata().empty_table())
                require_columns(name, columns, NEEDED[name])
        with within(self.folder):
            filling = learned_filling(missing, self.stage_covariates, self._column, self.num_stages)
        self.as_folder = self.as_folder._replace(filling=filling)
        # A table of millions of trajectories would be larger than everything else in memory.
        ends = [
            (part["end_s"].to_numpy(), (part["ending"] == FINISHED).to_numpy(bool))
            for part in self._trajectory_tables()
        ]
        if not ends:
            checked_trajectories(as_frame("trajectories", self.as_folder.opened("trajectories").read()))
        self.end_s, self.is_finished = (np.concatenate(each) for each in zip(*ends, strict=True))

    @property
    def trajectories(self) -> pd.DataFrame:
        """One row per trajectory, sorted by trajectory; read on each access."""
        return pd.concat(self._trajectory_tables(), ignore_index=True)

    @property
    def num_trajectories(self) -> int:
        """Number of trajectories n."""
        return len(self.end_s)

    @property
    def trajectory_ids(self) -> np.ndarray:
        """Names of the trajectories, shape (n,); read on each access."""
        return self.trajectories["trajectory"].to_numpy()

    def shards(self) -> list[Shard]:
        """Divide the parts into shards, depending on the size of the log alone.

        Raises
        ------
        LogError
            Stages or objects are not sorted by trajectory.
        """
        return shards_of(self.as_folder, self.trajectories_at_once)

    @property
    def horizon(self) -> int:
        """Number of stages T in the longest trajectory."""
        with within(self.folder):
            return max(
                int(as_counts("stages", frame, "stage").max()) for frame in self.stage_columns("trajectory", "stage")
            )

    @property
    def stage_covariates(self) -> list[str]:
        """Names of the stages' covariates, including filled-in columns and flags of missing values."""
        there = [name for name in self.as_folder.opened("stages").schema_arrow.names if is_stage_covariate(name)]
        if self.filling is None:
            return there
        added = (*self.filling.absent_from(there), *self.filling.flags)
        return [*there, *(name for name in added if name not in there)]

    @property
    def filling(self) -> Filling | None:
        """Values that replace null in covariates; None if null is refused."""
        return self.as_folder.filling

    @property
    def has_all_actions(self) -> bool:
        """Whether the action of every stage is known, including stages in which a trajectory was cut."""
        return all(bool(frame["action"].notna().all()) for frame in self.stage_columns("action"))

    def stage_columns(self, *names: str) -> Iterator[pd.DataFrame]:
        """Read some columns of the stages, in the order of the rows."""
        for batch in self.as_folder.batches("stages", list(names)):
            # The pandas metadata of the table may be broken and is not needed.
            yield frame_of(pa.Table.from_batches([batch.replace_schema_metadata()]))

    def _column(self, name: str) -> Iterator[Any]:
        return (as_frame("stages", frame)[name] for frame in self.stage_columns(name))

    def __iter__(self) -> Iterator[Logs]:
        """Read the parts one after the other, from the beginning."""
        reader = ShardReader(self.as_folder)
        return (reader.read(part) for shard in self.shards() for part in shard.parts)

    def _trajectory_tables(self) -> Iterator[pd.DataFrame]:
        """Read the table of trajectories in parts; each is checked and must sort after the one before."""
        last: Any = None
        for batch in self.as_folder.batches("trajectories"):
            with within(self.folder):
                frame = as_frame("trajectories", pa.Table.from_batches([batch]))
                trajectories = checked_trajectories(frame)
                names = trajectories["trajectory"].to_numpy()
                if not (names == frame["trajectory"].to_numpy()).all() or (last is not None and not names[0] > last):
                    raise LogError(f"trajectories.parquet is not sorted by trajectory, or has one twice; {UNSORTED}")
            last = names[-1]
            yield trajectories


MOST_STAGES_IN_MEMORY = 500_000
"""Larger logs are read in passes by default (`opened`)."""


def read_logs(folder: str | Place, *, missing: Missing = None) -> Logs:
    """Read a folder written by `Logs.write` or a `LogRecorder`, or one of CSV files, and check it again.

    A recorder's folder can be read at any time. A trajectory interrupted by a crash has the cause "crash"; one that is
    being recorded has the cause "still-running".

    Parameters
    ----------
    folder
        The folder; or, for Parquet files in an object store, its address.
    missing
        What replaces null in covariates of the stages, as in `Logs`.

    Raises
    ------
    LogError
        The folder or one of its files is missing, broken or of another version, or the tables violate an invariant.
    """
    folder = place_of(folder)
    is_here = isinstance(folder, Path)
    if is_here and (folder / "stages.csv").is_file() and not (folder / MANIFEST).exists():
        # Imported here: formats depend on logs, not the other way round.
        from halfseen.logs.formats.csv_folder import read_csv

        return read_csv(folder, missing=missing)
    tables = read_folder(folder)
    with within(folder):
        return Logs(**tables, missing=missing)


def opened(folder: str | Place, streaming: bool | None = None, *, missing: Missing = None) -> Logs | LogStream:
    """Read a log or, if it has many stages, open it for reading in passes.

    Parameters
    ----------
    folder
        A log in any format, or the address of one in Parquet files in an object store.
    streaming
        Whether to read it in passes; None to decide by its size.
    missing
        What replaces null in covariates of the stages, as in `Logs`.

    Raises
    ------
    LogError
        The folder or one of its files is missing or broken, or its format cannot be read in passes.
    """
    folder = place_of(folder)
    # Stores hold no other format.
    is_parquet = not isinstance(folder, Path) or (folder / MANIFEST).is_file()
    if streaming and not is_parquet:
        raise LogError(
            f"{folder}: only folders of Parquet files are read in passes; convert it: halfseen convert {folder} "
            "--out FOLDER"
        )
    if streaming is None:
        streaming = is_parquet and read_manifest(folder).num_rows["stages"] > MOST_STAGES_IN_MEMORY
    return LogStream(folder, missing=missing) if streaming else read_logs(folder, missing=missing)


def parts_of(log: Logs | LogStream) -> Iterable[Logs]:
    """Parts of a log; a log in memory is one part."""
    return [log] if isinstance(log, Logs) else log
