"""What benchmarks of speed have measured, as one table: what, ours, a peer, their ratio, when, and on which machine.

python benchmarks/timings.py [--keep]

A benchmark writes its results and its rows to runs/benchmarks. This prints the rows of all of them; with --keep they
are added to benchmarks/history.json, from which the page in the docs is made. Keep what an idle machine measured.
"""

import argparse
import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from halfseen.writing import write_file

RUNS = Path("runs/benchmarks")
HISTORY = Path(__file__).with_name("history.json")
HEADS = ("what", "ours", "bar", "peer", "theirs", "ratio", "on", "machine")


@dataclass(frozen=True)
class Row:
    """One thing that was measured.

    Parameters
    ----------
    what
        What was done, and to how much.
    ours
        Median of ours.
    unit
        s, ms, or what is done in a second, such as ``"steps/s"``, of which more is better.
    peer, theirs
        Who did the same in the same run, and their median; None where nobody does the same.
    bar
        What is wanted of ours, if anything is.
    """

    what: str
    ours: float
    unit: str
    peer: str | None = None
    theirs: float | None = None
    bar: float | None = None

    @property
    def is_rate(self) -> bool:
        """Whether more is better."""
        return self.unit.endswith("/s")

    @property
    def ratio(self) -> float | None:
        """How many times as fast as the peer ours is."""
        if self.theirs is None:
            return None
        return self.ours / self.theirs if self.is_rate else self.theirs / self.ours

    @property
    def holds(self) -> bool | None:
        """Whether the bar is met; None where there is none."""
        if self.bar is None:
            return None
        return self.ours >= self.bar if self.is_rate else self.ours <= self.bar


def write(out: Path, results: Any, rows: Sequence[Row]) -> None:
    """Write what a benchmark found, and its rows of the table."""
    result = {"results": results, "rows": [asdict(row) for row in rows], "date": today(), "machine": machine()}
    out.parent.mkdir(parents=True, exist_ok=True)
    write_file(out, json.dumps(result, indent=1, ensure_ascii=False) + "\n")


def today() -> str:
    """Date in UTC."""
    return datetime.now(UTC).date().isoformat()


def machine() -> str:
    """Cores, kind of processor and Python, as far as times depend on them."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    kind = models[0] if models else platform.machine()
    return f"{os.cpu_count()} cores, {kind}, Python {platform.python_version()}"


def newest(history: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Keep the last entry of each thing that was measured, in the order in which they were first."""
    return list({entry["what"]: entry for entry in history}.values())


def cells(entry: Mapping[str, Any]) -> tuple[str, ...]:
    """One line of the table."""
    row = Row(**{name: entry[name] for name in Row.__dataclass_fields__})
    bar = "" if row.bar is None else f"{_short(row.bar, row.unit)} {'holds' if row.holds else 'missed'}"
    theirs = "" if row.theirs is None else _short(row.theirs, row.unit)
    ratio = "" if row.ratio is None else f"{row.ratio:.3g}"
    return row.what, _short(row.ours, row.unit), bar, row.peer or "", theirs, ratio, entry["date"], entry["machine"]


def _short(value: float, unit: str) -> str:
    return f"{value:,.0f} {unit}" if value >= 1000 else f"{value:.3g} {unit}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", action="store_true", help="add the rows to the history")
    is_kept = parser.parse_args().keep
    found = [json.loads(path.read_text()) for path in sorted(RUNS.glob("*.json"))]
    measured = [
        row | {"date": each["date"], "machine": each["machine"]}
        for each in found
        if isinstance(each, dict)
        for row in each.get("rows", ())
    ]
    history = json.loads(HISTORY.read_text()) if HISTORY.exists() else []
    if is_kept:
        history += [entry for entry in measured if entry not in history]
        write_file(HISTORY, json.dumps(history, indent=1, ensure_ascii=False) + "\n")
    table = [HEADS, *(cells(entry) for entry in newest([*history, *measured]))]
    widths = [max(len(line[k]) for line in table) for k in range(len(HEADS))]
    for line in table:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


if __name__ == "__main__":
    main()
