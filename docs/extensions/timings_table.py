"""The table of what benchmarks of speed have measured, from benchmarks/history.json: the newest of each, and before."""

import json
import sys
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
sys.path.append(str(BENCHMARKS))

from timings import HEADS, HISTORY, cells  # noqa: E402


class TimingsTable(SphinxDirective):
    """Write the tables."""

    def run(self) -> list[nodes.Node]:
        """Read the history, and tell that the page depends on it."""
        self.env.note_dependency(str(HISTORY))
        return self.parse_text_to_nodes(markdown(json.loads(HISTORY.read_text(encoding="utf-8"))))


def markdown(history: Sequence[Mapping[str, Any]]) -> str:
    """A table for each machine, of the newest of each; and what was measured before, if anything was."""
    what = [entry["what"] for entry in history]
    is_newest = [name not in what[k + 1 :] for k, name in enumerate(what)]
    newest = [entry for entry, is_last in zip(history, is_newest, strict=True) if is_last]
    before = [entry for entry, is_last in zip(history, is_newest, strict=True) if not is_last]
    parts = [
        f"On {machine}:\n\n{table(list(entries))}"
        for machine, entries in groupby(sorted(newest, key=_machine), key=_machine)
    ]
    if before:
        parts.append(f"Before:\n\n{table(before)}")
    return "\n\n".join(parts)


def table(entries: Sequence[Mapping[str, Any]]) -> str:
    """A line for each, without the machine."""
    lines = [HEADS[:-1], (":--",) + ("--:",) * (len(HEADS) - 2), *(cells(entry)[:-1] for entry in entries)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _machine(entry: Mapping[str, Any]) -> str:
    return entry["machine"]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("timings", TimingsTable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
