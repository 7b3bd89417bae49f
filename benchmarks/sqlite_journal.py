"""Would SQLite in WAL mode keep a log that is being recorded as well as the journal does?

python benchmarks/sqlite_journal.py [--folder FOLDER] [--events 2000] [--out FILE]

Told are medians of the time of an event [µs], in turn, with and without waiting for the disk; and how many events are
read after a loss of power that left a page of 4,096 zeros, in the middle of the file or at its end.
"""

import argparse
import json
import os
import sqlite3
import tempfile
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np

from halfseen.logs.journal import HEADER, JournalEvents, journal_line
from halfseen.writing import write_file

PAGE = 4096
SEEN = {f"x{k}": 0.1 * k for k in range(6)}
EVENTS = ({"event": "stage", "at_s": 4.5, "covariates": SEEN, "action": "PICK"}, {"event": "done", "reward": 1.0})


def timed(write: Callable[[dict[str, object]], None], num_events: int) -> float:
    """Median time of an event [µs]."""
    times = []
    for number in range(num_events):
        begin = time.perf_counter_ns()
        write(EVENTS[number % 2])
        times.append((time.perf_counter_ns() - begin) / 1e3)
    return float(np.median(times))


def in_journal(file: Path, num_events: int, waits: bool) -> float:
    handle, checksum = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_APPEND), 0

    def write(event: dict[str, object]) -> None:
        nonlocal checksum
        line, checksum = journal_line(event, checksum)
        os.write(handle, line)
        if waits:
            os.fsync(handle)

    try:
        write(HEADER)
        return timed(write, num_events)
    finally:
        os.close(handle)


def in_sqlite(file: Path, num_events: int, waits: bool) -> float:
    connection = sqlite3.connect(file, isolation_level=None)
    for pragma in ("journal_mode = wal", f"synchronous = {'full' if waits else 'normal'}"):
        connection.execute(f"PRAGMA {pragma}")
    connection.execute("CREATE TABLE event (number INTEGER PRIMARY KEY, body TEXT)")

    def write(event: dict[str, object]) -> None:
        connection.execute("INSERT INTO event (body) VALUES (?)", (json.dumps(event),))

    try:
        return timed(write, num_events)
    finally:
        connection.close()


def read_journal(file: Path, num_events: int) -> int:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return min(num_events, sum(event["event"] in ("stage", "done") for event in JournalEvents(file)))


def read_sqlite(file: Path, num_events: int) -> int:
    """One by one, as a query for all is refused where a page is broken."""
    found = 0
    with sqlite3.connect(file) as connection:
        for number in range(1, num_events + 1):
            with suppress(sqlite3.DatabaseError):
                found += connection.execute("SELECT body FROM event WHERE number = ?", (number,)).fetchone() is not None
    return found


def after_lost_power(file: Path, share: float, read: Callable[[Path], int]) -> int:
    """Events that are read of a file of which the page at this share is zeros."""
    data = bytearray(file.read_bytes())
    at = min(int(len(data) * share) // PAGE * PAGE, len(data) - PAGE)
    data[at : at + PAGE] = bytes(PAGE)
    torn = file.with_name(f"torn-{share}-{file.name}")
    torn.write_bytes(data)
    return read(torn)


WAYS = {"journal": (in_journal, read_journal), "sqlite": (in_sqlite, read_sqlite)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("."))
    parser.add_argument("--events", type=int, default=2000)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/sqlite_journal.json"))
    given = parser.parse_args()
    rows = {}
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        for name, (write, read) in WAYS.items():
            files = {waits: Path(folder) / f"{name}-{waits}" for waits in (False, True)}
            count = partial(read, num_events=given.events)
            rows[name] = {
                "event_us": write(files[False], given.events, False),
                "event_with_fsync_us": write(files[True], given.events, True),
                "read_of_all": given.events,
                "zeros_in_the_middle": after_lost_power(files[False], 0.5, count),
                "zeros_at_the_end": after_lost_power(files[False], 1.0, count),
            }
    write_file(given.out, json.dumps(rows, indent=2).encode())
    for name, row in rows.items():
        print(name, ", ".join(f"{key} {value:.0f}" for key, value in row.items()))
    print(f"an event in SQLite, of one in the journal: {rows['sqlite']['event_us'] / rows['journal']['event_us']:.1f}")


if __name__ == "__main__":
    main()
