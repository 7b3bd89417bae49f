"""Many folders of logs as one: what a fleet has recorded, run by run, in one folder of Parquet files.

The folders are read twice, one after the other: for the types of their columns, which must agree, and to be written. No
more than some thousand trajectories are in memory.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import pyarrow as pa

from halfseen.errors import ArgumentError, LogError
from halfseen.logs.columns import common_unit
from halfseen.logs.joining import joined
from halfseen.logs.logs import Logs
from halfseen.logs.place import Place, place_of
from halfseen.logs.reading import read_logs
from halfseen.logs.stream import TRAJECTORIES_AT_ONCE, write_stream
from halfseen.writing import refuse_taken

STILL_RUNNING = "still-running"
RUN, RUN_TRAJECTORY = "run", "run_trajectory"
"""Columns of the trajectories that tell where each comes from: its folder, and its name there."""


class Compacted(NamedTuple):
    """What became of many folders."""

    num_folders: int
    num_trajectories: int
    num_stages: int
    num_running: int
    """Trajectories that are still being recorded, and were left out."""


def compact(
    folders: Sequence[str | Place],
    out: str | Path,
    *,
    overwrite: bool = False,
    on_progress: Callable[[], object] = lambda: None,
) -> Compacted:
    """Write the logs of many folders into one, all or nothing.

    Trajectories are numbered anew, in the order of the folders; the columns ``run`` and ``run_trajectory`` of
    `Logs.trajectories` say what they were called in which folder. Those that are still being recorded are left out.

    Parameters
    ----------
    folders
        Logs of any form that `read_logs` reads, or their addresses in an object store.
    out
        Folder to write.
    overwrite
        Replace logs that are already there.
    on_progress
        Called after each folder has been read, twice for each.

    Raises
    ------
    ArgumentError
        No folder is given, one is given twice, or `out` cannot be written.
    LogError
        A folder is none or broken; or two do not go together: a column is of two types, or only one has it; or rewards
        are in two units.
    """
    runs = [place_of(folder) for folder in folders]
    _refuse_repeated(runs)
    refuse_taken(Path(out), overwrite, "logs.json", "logs")
    schemas: dict[str, pa.Schema] = {}
    counts, units = Compacted(len(runs), 0, 0, 0), []
    for run in runs:
        found, num_running = _ended(read_logs(run))
        counts = counts._replace(num_running=counts.num_running + num_running)
        if found is not None:
            units.append(found.reward_unit)
            schemas = _agreed(schemas, run, runs[0], _named(found, run, counts.num_trajectories))
            counts = counts._replace(
                num_trajectories=counts.num_trajectories + found.num_trajectories,
                num_stages=counts.num_stages + found.num_stages,
            )
        on_progress()
    if not counts.num_trajectories:
        raise LogError(f"none of the {len(runs)} folders has a trajectory that ended; record some")
    common_unit(units)
    write_stream(_parts(runs, on_progress), out, overwrite=overwrite, schemas=schemas)
    return counts


def _refuse_repeated(runs: Sequence[Place]) -> None:
    if not runs:
        raise ArgumentError("no folder is given; give at least one")
    seen: dict[object, Place] = {}
    for run in runs:
        # A trajectory's own `resolve` raises where links go in a circle.
        place = os.path.realpath(run) if isinstance(run, Path) else run.resolve()
        if place in seen:
            raise ArgumentError(f"{run} and {seen[place]} are the same folder; give it once")
        seen[place] = run


def _ended(logs: Logs) -> tuple[Logs | None, int]:
    """Leave out trajectories that are still being recorded, and count them."""
    is_running = (logs.trajectories["cause"] == STILL_RUNNING).to_numpy(dtype=bool)
    if is_running.all():
        return None, len(is_running)
    ended = logs.select(logs.trajectory_ids[~is_running]) if is_running.any() else logs
    return ended, int(is_running.sum())


def _parts(runs: Sequence[Place], on_progress: Callable[[], object]) -> Iterator[Logs]:
    """Logs of some thousand trajectories, numbered anew."""
    held, num_held, first = [], 0, 0
    for run in runs:
        found, _ = _ended(read_logs(run))
        if found is not None:
            tables: dict[str, Any] = _named(found, run, first)
            held.append(Logs(**tables, reward_unit=found.reward_unit))
            first, num_held = first + found.num_trajectories, num_held + found.num_trajectories
        if num_held >= TRAJECTORIES_AT_ONCE:
            yield joined(held)
            held, num_held = [], 0
        on_progress()
    if held:
        yield joined(held)


def _named(logs: Logs, run: Place, first: int) -> dict[str, pd.DataFrame]:
    """Tables of a log whose trajectories are numbered from `first`, and which say where they come from."""
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
    """Types that serve what was read so far and one folder more."""
    here = {name: pa.Schema.from_pandas(table, preserve_index=False) for name, table in tables.items()}
    if not schemas:
        return here
    if set(here) != set(schemas):
        having, lacking = (run, first) if "objects" in here else (first, run)
        raise LogError(
            f"{having} has objects and {lacking} has none; write those that have and those that have none apart"
        )
    return {name: _unified(name, schemas[name], here[name], run, first) for name in here}


_MAY_LACK = {"stages": {"object"}, "objects": set()}
"""Columns that may be null; what else stages and objects have was seen of each, or of none. Of trajectories all may."""


def _unified(table: str, before: pa.Schema, here: pa.Schema, run: Place, first: Place) -> pa.Schema:
    only_one = sorted(set(before.names) ^ set(here.names))
    missing = [column for column in only_one if table in _MAY_LACK and column not in _MAY_LACK[table]]
    if missing:
        having, lacking = (run, first) if missing[0] in here.names else (first, run)
        raise LogError(
            f"{table}: {having} has column {missing[0]!r} and {lacking} has not; drop it, or add what was seen"
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
