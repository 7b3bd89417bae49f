"""A log of any form, in memory or as a stream."""

from collections.abc import Iterable
from pathlib import Path

from halfseen.errors import LogError, within
from halfseen.logs.folder import MANIFEST, Place, place_of, read_folder, read_manifest
from halfseen.logs.logs import Logs
from halfseen.logs.missing import Missing
from halfseen.logs.stream import LogStream

MOST_STAGES_IN_MEMORY = 500_000
"""A log of more is read in passes where nothing else is said (`opened`)."""


def read_logs(folder: str | Place, *, missing: Missing = None) -> Logs:
    """Read a folder that `Logs.write` or a `LogRecorder` wrote, or one of CSV files, and check it again.

    A recorder's folder can be read at any time. A trajectory that a crash tore has the cause "crash"; one that is being
    recorded has the cause "still-running".

    Parameters
    ----------
    folder
        The folder; its address, where it lies in an object store, as Parquet files.
    missing
        What stands for covariates of the stages that are null, as `Logs` takes it.

    Raises
    ------
    LogError
        The folder or one of its files is missing, broken or of another version, or the tables break an invariant.
    """
    folder = place_of(folder)
    is_here = isinstance(folder, Path)
    if is_here and (folder / "stages.csv").is_file() and not (folder / MANIFEST).exists():
        # Formats know logs, not the other way round.
        from halfseen.logs.formats.csv_folder import read_csv

        return read_csv(folder, missing=missing)
    tables = read_folder(folder)
    with within(folder):
        return Logs(**tables, missing=missing)


def opened(folder: str | Place, streaming: bool | None = None, *, missing: Missing = None) -> Logs | LogStream:
    """Read a log, or, if it is one of many stages, open it to be read in passes.

    Parameters
    ----------
    folder
        A log of any form, or the address of one of Parquet files in an object store.
    streaming
        Whether it is to be read in passes; None for what suits its size.
    missing
        What stands for covariates of the stages that are null, as `Logs` takes it.

    Raises
    ------
    LogError
        The folder or one of its files is missing or broken, or it is to be read in passes and its form cannot.
    """
    folder = place_of(folder)
    # In a store there is no other form.
    is_parquet = not isinstance(folder, Path) or (folder / MANIFEST).is_file()
    if streaming and not is_parquet:
        raise LogError(
            f"{folder}: only folders of Parquet files are read in passes; make one of it: halfseen convert {folder} "
            "--out FOLDER"
        )
    if streaming is None:
        streaming = is_parquet and read_manifest(folder).num_rows["stages"] > MOST_STAGES_IN_MEMORY
    return LogStream(folder, missing=missing) if streaming else read_logs(folder, missing=missing)


def parts_of(log: Logs | LogStream) -> Iterable[Logs]:
    """Parts of a log, which is one in memory."""
    return [log] if isinstance(log, Logs) else log
