"""A log that need not fit in memory: read and written a few thousand whole trajectories at a time."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from halfseen.arrays import RowMask, Rows
from halfseen.errors import ArgumentError, LogError, within
from halfseen.logs.checks import checked_trajectories
from halfseen.logs.columns import FINISHED, NEEDED, as_counts, common_unit, is_stage_covariate, require_columns, shown
from halfseen.logs.folder import (
    MANIFEST,
    ROWS_IN_GROUP,
    Manifest,
    broken_table,
    opened_table,
    read_manifest,
    write_manifest,
)
from halfseen.logs.frames import as_frame
from halfseen.logs.logs import Logs
from halfseen.logs.place import Place, place_of
from halfseen.logs.reading import read_logs
from halfseen.logs.shards import Folder, Shard, columns_of, shards_of, tables_of_size
from halfseen.writing import placed

TRAJECTORIES_AT_ONCE = 2_000
"""Trajectories that are held in memory at once."""

MOST_STAGES_IN_MEMORY = 500_000
"""A log of more is read in passes where nothing else is said (`opened`)."""


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

    Attributes
    ----------
    reward_unit
        What rewards are counted in; None if nobody has said.

    Raises
    ------
    LogError
        The folder or one of its files is missing or broken, or the trajectories are.
    ArgumentError
        `trajectories_at_once` is below 1.
    """

    def __init__(self, folder: str | Place, trajectories_at_once: int = TRAJECTORIES_AT_ONCE) -> None:
        if trajectories_at_once < 1:
            raise ArgumentError(f"trajectories_at_once is {trajectories_at_once}; read at least 1")
        self.folder = place_of(folder)
        self.trajectories_at_once = trajectories_at_once
        self._rows, self.reward_unit = read_manifest(self.folder)
        for name in self._rows:
            with within(self.folder):
                columns = as_frame(name, self._opened(name).schema_arrow.empty_table())
                require_columns(name, columns, NEEDED[name])
        # A table of millions of trajectories is larger than all that is held beside it.
        ends = [
            (part["end_s"].to_numpy(), (part["ending"] == FINISHED).to_numpy(bool))
            for part in self._trajectory_tables()
        ]
        if not ends:
            checked_trajectories(as_frame("trajectories", opened_table(self.folder, "trajectories", 0).read()))
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

    @property
    def as_folder(self) -> Folder:
        """What a worker needs to know, to read a shard."""
        return Folder(self.folder, self._rows, self.reward_unit)

    def shards(self) -> list[Shard]:
        """Deal the parts into shards, by the size of the log alone.

        Raises
        ------
        LogError
            Stages or objects are not sorted by trajectory.
        """
        try:
            return shards_of(self.as_folder, self.trajectories_at_once)
        except LogError:
            # Whoever reads them one after the other can tell which trajectory is out of place.
            for _ in self:
                pass
            raise

    @property
    def horizon(self) -> int:
        """Number of stages T of the longest trajectory."""
        with within(self.folder):
            return max(
                int(as_counts("stages", frame, "stage").max()) for frame in self.stage_columns("trajectory", "stage")
            )

    @property
    def stage_covariates(self) -> list[str]:
        """Names of the stages' covariates."""
        return [name for name in self._opened("stages").schema_arrow.names if is_stage_covariate(name)]

    @property
    def num_stages(self) -> int:
        """Number of stages of all trajectories together."""
        return self._rows["stages"]

    @property
    def has_objects(self) -> bool:
        """Whether the stages have objects."""
        return "objects" in self._rows

    @property
    def has_all_actions(self) -> bool:
        """Whether the action of every stage is known, also where a trajectory was cut."""
        return all(bool(frame["action"].notna().all()) for frame in self.stage_columns("action"))

    def stage_columns(self, *names: str) -> Iterator[pd.DataFrame]:
        """Read some columns of the stages alone, row by row as they stand."""
        for batch in columns_of(self.as_folder, "stages", list(names)):
            yield batch.to_pandas()

    def __iter__(self) -> Iterator[Logs]:
        """Read the parts, one after the other, from the beginning."""
        others = ["stages", *(["objects"] if self.has_objects else [])]
        readers = {name: _TrajectoryReader(self.folder, name, self._rows[name]) for name in others}
        for part in self._trajectory_tables(self.trajectories_at_once):
            names: Any = part["trajectory"]
            tables: dict[str, Any] = {name: reader.upto(names) for name, reader in readers.items()}
            with within(self.folder):
                logs = Logs(trajectories=part, **tables, reward_unit=self.reward_unit)
            yield logs
        for reader in readers.values():
            reader.refuse_leftover()

    def _trajectory_tables(self, size: int = ROWS_IN_GROUP) -> Iterator[pd.DataFrame]:
        """Read the table of trajectories in parts of a size, each checked, and sorted after the one before."""
        last: Any = None
        for table in tables_of_size(columns_of(self.as_folder, "trajectories"), size):
            with within(self.folder):
                frame = as_frame("trajectories", table)
                trajectories = checked_trajectories(frame)
                names = trajectories["trajectory"].to_numpy()
                if not (names == frame["trajectory"].to_numpy()).all() or (last is not None and not names[0] > last):
                    raise LogError(
                        "trajectories.parquet is not sorted by trajectory, or has one twice; write the logs by "
                        "Logs.write or write_stream, which sort them"
                    )
            last = names[-1]
            yield trajectories

    def _opened(self, name: str) -> pq.ParquetFile:
        return opened_table(self.folder, name, self._rows[name])


def opened(folder: str | Place, in_passes: bool | None = None) -> Logs | LogStream:
    """Read a log, or, if it is one of many stages, open it to be read in passes.

    Parameters
    ----------
    folder
        A log of any form, or the address of one of Parquet files in an object store.
    in_passes
        Whether it is to be read in passes; None for what suits its size.

    Raises
    ------
    LogError
        The folder or one of its files is missing or broken, or it is to be read in passes and its form cannot.
    """
    folder = place_of(folder)
    # In a store there is no other form.
    is_parquet = not isinstance(folder, Path) or (folder / MANIFEST).is_file()
    if in_passes and not is_parquet:
        raise LogError(
            f"{folder}: only folders of Parquet files are read in passes; make one of it: halfseen convert {folder} "
            "--out FOLDER"
        )
    if in_passes is None:
        in_passes = is_parquet and read_manifest(folder).rows["stages"] > MOST_STAGES_IN_MEMORY
    return LogStream(folder) if in_passes else read_logs(folder)


def parts_of(log: Logs | LogStream) -> Iterable[Logs]:
    """Parts of a log, which is one in memory."""
    return [log] if isinstance(log, Logs) else log


class _TrajectoryReader:
    """Hands out a table's rows by trajectory; those of one stand together, in the order of trajectories."""

    def __init__(self, folder: Place, name: str, num_rows: int) -> None:
        self._file = folder / f"{name}.parquet"
        self._batches = opened_table(folder, name, num_rows).iter_batches(batch_size=ROWS_IN_GROUP)
        self._held: list[pa.Table] = []

    def upto(self, trajectories: pd.Series) -> pa.Table:
        """Take the rows of these trajectories, which are the next ones."""
        taken = []
        while True:
            if not self._held and not self._read():
                break
            table = self._held.pop()
            others = np.flatnonzero(~table["trajectory"].to_pandas().isin(trajectories).to_numpy())
            end = int(others[0]) if len(others) else len(table)
            if end:
                taken.append(table.slice(0, end))
            if end < len(table):
                self._held.append(table.slice(end))
                break
        if not taken:
            raise LogError(
                f"{self._file}: no row of trajectory {shown(trajectories.iloc[0])} comes next, as trajectories.parquet "
                "has it; write the logs by Logs.write or write_stream, which sort them"
            )
        return pa.concat_tables(taken)

    def refuse_leftover(self) -> None:
        """Refuse rows that belong to no trajectory, or stand out of order."""
        if self._held or self._read():
            trajectory = self._held[0]["trajectory"][0].as_py()
            raise LogError(
                f"{self._file}: rows of trajectory {shown(trajectory)} stand where trajectories.parquet has none; "
                "write the logs by Logs.write or write_stream, which sort them"
            )

    def _read(self) -> bool:
        try:
            batch = next(self._batches, None)
        except (OSError, pa.ArrowException) as error:
            raise broken_table(self._file, error) from error
        if batch is None:
            return False
        self._held.append(pa.Table.from_batches([batch]))
        return True


def write_stream(
    parts: Iterable[Logs],
    folder: str | Path,
    *,
    overwrite: bool = False,
    schemas: Mapping[str, pa.Schema] | None = None,
) -> None:
    """Write a log that comes in parts, all or nothing; no more than one part is in memory.

    Parameters
    ----------
    parts
        Logs of different trajectories; the names increase from part to part, as they do within one.
    folder
        Where to.
    overwrite
        Replace logs that are already there.
    schemas
        Columns and types of each table; None for those of the first part.

    Raises
    ------
    ArgumentError
        The folder exists or cannot be written, or there is no part.
    LogError
        A trajectory comes before one of an earlier part, a part has objects or columns that earlier ones lack, or
        rewards are in two units.
    """
    with placed(Path(folder), overwrite=overwrite, marker=MANIFEST) as fresh, ExitStack() as stack:
        writers: dict[str, pq.ParquetWriter] = {}
        rows: dict[str, int] = {}
        unit: str | None = None
        last: Any = None
        for part in parts:
            if last is not None and not part.trajectory_ids[0] > last:
                raise LogError(
                    f"trajectory {shown(part.trajectory_ids[0])}: it comes after trajectory {shown(last)}; sort the "
                    "parts"
                )
            if writers and part.tables.keys() != writers.keys():
                raise LogError("only some of the parts have objects; write those with and those without apart")
            last, unit = part.trajectory_ids[-1], common_unit([unit, part.reward_unit])
            for name, table in part.tables.items():
                if name not in writers:
                    schema = pa.Schema.from_pandas(table, preserve_index=False) if schemas is None else schemas[name]
                    writers[name] = stack.enter_context(
                        pq.ParquetWriter(fresh / f"{name}.parquet", _without_nulls(schema), compression="zstd")
                    )
                    rows[name] = 0
                schema = writers[name].schema
                if more := [column for column in table if column not in schema.names]:
                    raise LogError(
                        f"{name}: column {shown(more[0])} comes with trajectory {shown(part.trajectory_ids[0])}, and "
                        "parts before it have none; give every part the same columns"
                    )
                full = table.reindex(columns=schema.names)
                writers[name].write_table(pa.Table.from_pandas(full, schema=schema, preserve_index=False))
                rows[name] += len(table)
        if not writers:
            raise ArgumentError("there is no part; give at least one log")
        stack.close()
        write_manifest(fresh, Manifest(rows, unit))


def _without_nulls(schema: pa.Schema) -> pa.Schema:
    """A column that is empty in the first part, such as the causes of cuts, may be text in a later one."""
    for i, field in enumerate(schema):
        if pa.types.is_null(field.type):
            schema = schema.set(i, field.with_type(pa.string()))
    return schema
