"""Joining logs in memory, part by part on disk, and across many folders of a fleet.

Folders are read twice, one after the other: first for the types of their columns, which must agree, then for writing.
No more than a few thousand trajectories are in memory.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from halfseen.errors import ArgumentError, LogError
from halfseen.logs.checks import common_unit
from halfseen.logs.columns import STEPPED_BACK, shown
from halfseen.logs.folder import Place, place_of
from halfseen.logs.logs import Logs
from halfseen.logs.missing import KEEP
from halfseen.logs.parquet import MANIFEST, write_manifest
from halfseen.logs.recorded import STILL_RUNNING
from halfseen.logs.stream import TRAJECTORIES_AT_ONCE, read_logs
from halfseen.reading import reason_of
from halfseen.writing import path_of, placed, refuse_taken


def joined(parts: Sequence[Logs]) -> Logs:
    """Join logs of different trajectories.

    Parameters
    ----------
    parts
        At least one log; no trajectory is in two of them, and all have objects or none has.

    Raises
    ------
    LogError
        There is no log, only some have objects, a trajectory is in two, or rewards are in two units.
    """
    if not parts:
        raise LogError("there is no log to join; give at least one")
    if len({part.objects is None for part in parts}) > 1:
        raise LogError("only some of the logs have objects; join those with and those without separately")
    # Through Arrow: a column that is all null in one log has no type there, and takes that of the others.
    frames = {name: [part.tables[name] for part in parts] for name in parts[0].tables}
    arrow = {name: [pa.Table.from_pandas(each, preserve_index=False) for each in of] for name, of in frames.items()}
    try:
        tables: Any = {name: pa.concat_tables(of, promote_options="permissive") for name, of in arrow.items()}
    except pa.ArrowException as error:
        raise LogError(
            f"the logs have columns of incompatible types ({reason_of(error)}); give them one type"
        ) from error
    missing = parts[0].missing if all(part.missing == parts[0].missing for part in parts) else None
    return Logs(**tables, reward_unit=common_unit(part.reward_unit for part in parts), missing=missing)


def write_stream(
    parts: Iterable[Logs],
    folder: str | Path,
    *,
    overwrite: bool = False,
    schemas: Mapping[str, pa.Schema] | None = None,
) -> None:
    """Write a log that arrives in parts, all or nothing; no more than one part is in memory.

    Parameters
    ----------
    parts
        Logs of different trajectories, sorted by name across parts as within a log.
    folder
        Target folder.
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
    if not isinstance(parts, Iterable):
        raise ArgumentError(f"parts is a {type(parts).__name__}; give a list of Logs")
    with placed(path_of(folder), overwrite=overwrite, marker=MANIFEST) as fresh, ExitStack() as stack:
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
                raise LogError("only some of the parts have objects; write those with and those without separately")
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
                writers[name].write_table(_of_schema(name, part, schema))
                rows[name] += len(table)
        if not writers:
            raise ArgumentError("there are no parts; give at least one log")
        stack.close()
        write_manifest(fresh, rows, unit)


def _of_schema(name: str, part: Logs, schema: pa.Schema) -> pa.Table:
    """A table of a part with the columns and types of a schema."""
    try:
        return pa.Table.from_pandas(part.tables[name].reindex(columns=schema.names), schema, preserve_index=False)
    except pa.ArrowException as error:
        trouble = f"does not have the types of those before ({reason_of(error)}); give every part the same types"
        raise LogError(f"{name}, from trajectory {shown(part.trajectory_ids[0])} on: it {trouble}") from error


def _without_nulls(schema: pa.Schema) -> pa.Schema:
    """Make columns that are all null in the first part text, such as causes of cuts: a later part may hold text."""
    for i, field in enumerate(schema):
        if pa.types.is_null(field.type):
            schema = schema.set(i, field.with_type(pa.string()))
    return schema


RUN, RUN_TRAJECTORY = "run", "run_trajectory"
"""Columns with the origin of each trajectory: its folder, and its name there."""


class Compacted(NamedTuple):
    """Counts of the folders joined by `compact`."""

    num_folders: int
    num_trajectories: int
    num_stages: int
    num_running: int
    """Trajectories left out because they are still being recorded."""


def compact(
    folders: Sequence[str | Place],
    out: str | Path,
    *,
    overwrite: bool = False,
    on_progress: Callable[[], object] = lambda: None,
) -> Compacted:
    """Write the logs of many folders into one, all or nothing.

    Trajectories are renumbered in the order of the folders; the columns ``run`` and ``run_trajectory`` of
    `Logs.trajectories` hold their folder and their name there. Those that are still being recorded are left out.

    Parameters
    ----------
    folders
        Logs in any format that `read_logs` reads, or their addresses in an object store.
    out
        Folder to write.
    overwrite
        Replace logs that are already there.
    on_progress
        Called each time a folder has been read, which is twice per folder.

    Raises
    ------
    ArgumentError
        No folder is given, one is given twice, or `out` cannot be written.
    LogError
        A folder is missing or broken; or two are incompatible: a column has two types or is in only one of them, or
        rewards are in two units.
    """
    runs = [place_of(folder) for folder in folders]
    _refuse_repeated(runs)
    refuse_taken(Path(out), overwrite, "logs.json", "logs")
    schemas: dict[str, pa.Schema] = {}
    units, num_trajectories, num_stages, num_running = [], 0, 0, 0
    for run in runs:
        found, num_here = _ended(read_logs(run, missing=KEEP))
        num_running += num_here
        if found is not None:
            units.append(found.reward_unit)
            schemas = _agreed(schemas, run, runs[0], _named(found, run, num_trajectories))
            num_trajectories, num_stages = num_trajectories + found.num_trajectories, num_stages + found.num_stages
        on_progress()
    if not num_trajectories:
        raise LogError(f"none of the {len(runs)} folders has a trajectory that ended; record some")
    common_unit(units)
    write_stream(_parts(runs, on_progress), out, overwrite=overwrite, schemas=schemas)
    return Compacted(len(runs), num_trajectories, num_stages, num_running)


def _refuse_repeated(runs: Sequence[Place]) -> None:
    if not runs:
        raise ArgumentError("no folder is given; give at least one")
    seen: dict[object, Place] = {}
    for run in runs:
        # `Path.resolve` raises on circular links.
        place = os.path.realpath(run) if isinstance(run, Path) else run.resolve()
        if place in seen:
            raise ArgumentError(f"{run} and {seen[place]} are the same folder; give it once")
        seen[place] = run


def _ended(logs: Logs) -> tuple[Logs | None, int]:
    """The log without trajectories that are still being recorded, and their number."""
    is_running = (logs.trajectories["cause"] == STILL_RUNNING).to_numpy(dtype=bool)
    if is_running.all():
        return None, len(is_running)
    ended = logs.select(logs.trajectory_ids[~is_running]) if is_running.any() else logs
    return ended, int(is_running.sum())


def _parts(runs: Sequence[Place], on_progress: Callable[[], object]) -> Iterator[Logs]:
    """Renumbered logs of a few thousand trajectories each."""
    held, num_held, first = [], 0, 0
    for run in runs:
        found, _ = _ended(read_logs(run, missing=KEEP))
        if found is not None:
            tables: dict[str, Any] = _named(found, run, first)
            held.append(Logs(**tables, reward_unit=found.reward_unit, missing=KEEP))
            first, num_held = first + found.num_trajectories, num_held + found.num_trajectories
        if num_held >= TRAJECTORIES_AT_ONCE:
            yield joined(held)
            held, num_held = [], 0
        on_progress()
    if held:
        yield joined(held)


def _named(logs: Logs, run: Place, first: int) -> dict[str, pd.DataFrame]:
    """Tables of a log with trajectories numbered from `first` and columns for their origin."""
    number = pd.Series(range(first, first + logs.num_trajectories), index=pd.Index(logs.trajectory_ids))
    tables = {
        name: table.assign(trajectory=number.loc[table["trajectory"]].to_numpy()) for name, table in logs.tables.items()
    }
    if RUN not in logs.trajectories.columns:
        names = {RUN: str(run), RUN_TRAJECTORY: [str(name) for name in logs.trajectory_ids]}
        tables["trajectories"] = tables["trajectories"].assign(**names)
    return tables


def _agreed(
    schemas: dict[str, pa.Schema], run: Place, first: Place, tables: dict[str, pd.DataFrame]
) -> dict[str, pa.Schema]:
    """Types that fit the folders read so far and one more folder."""
    here = {name: pa.Schema.from_pandas(table, preserve_index=False) for name, table in tables.items()}
    if not schemas:
        return here
    if set(here) != set(schemas):
        having, lacking = (run, first) if "objects" in here else (first, run)
        raise LogError(f"{having} has objects and {lacking} has none; write those with and those without separately")
    return {name: _unified(name, schemas[name], here[name], run, first) for name in here}


_MAY_LACK = {"stages": {"object", STEPPED_BACK}, "objects": set()}
"""Columns that a folder may lack. All other columns of stages and objects must be in every folder or in none; those of
trajectories may all be lacking."""


def _unified(table: str, before: pa.Schema, here: pa.Schema, run: Place, first: Place) -> pa.Schema:
    only_one = sorted(set(before.names) ^ set(here.names))
    missing = [column for column in only_one if table in _MAY_LACK and column not in _MAY_LACK[table]]
    if missing:
        having, lacking = (run, first) if missing[0] in here.names else (first, run)
        raise LogError(
            f"{table}: {having} has column {missing[0]!r}, but {lacking} does not; drop it, or add its values"
        )
    for column in set(before.names) & set(here.names):
        try:
            pa.unify_schemas([pa.schema([s.field(column)]) for s in (before, here)], promote_options="permissive")
        except pa.ArrowException as error:
            raise LogError(
                f"{table}: column {column!r} is {here.field(column).type} in {run}, and "
                f"{before.field(column).type} in those before it; give it one type"
            ) from error
    return pa.unify_schemas([before.remove_metadata(), here.remove_metadata()], promote_options="permissive")
