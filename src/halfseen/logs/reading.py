"""Logs from a folder, whatever wrote it."""

from pathlib import Path

from halfseen.errors import within
from halfseen.logs.folder import MANIFEST, read_folder
from halfseen.logs.logs import Logs
from halfseen.logs.place import Place, place_of


def read_logs(folder: str | Place) -> Logs:
    """Read a folder that `Logs.write` or a `LogRecorder` wrote, or one of CSV files, and check it again.

    A recorder's folder can be read at any time. A trajectory that a crash tore has the cause "crash"; one that is being
    recorded has the cause "still-running".

    Parameters
    ----------
    folder
        The folder; its address, where it lies in an object store, as Parquet files.

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

        return read_csv(folder)
    told = read_folder(folder)
    with within(folder):
        return Logs(**told)
