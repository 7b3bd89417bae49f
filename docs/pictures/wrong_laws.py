"""What is learned of tables where laws are right, and where they are wrong, as `benchmarks/wrong_laws.py` has it."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from halfseen.figures import BLUE, INK, ORANGE, SOFT
from pictures.picture import ROOT, Numbers, Row, Table, plot
from pictures.style import LEGEND, panel

FOUND = ROOT / "runs" / "benchmarks" / "wrong_laws.json"
SHOWN = 800
CHECKED = "news", 25
LOOKS = {"default": ("o", BLUE), "linear eq. 3": ("s", ORANGE), "rule, fitted laws": ("v", SOFT)}


def table_of(found: list[dict[str, Any]]) -> Table:
    """What each policy earned over the best rule with the true laws, log by log."""
    return [
        {"case": row["case"], "size": row["size"], "log": row["log"], "policy": name, "gain": gain}
        for row in found
        for name, gain in row["gains"].items()
    ]


def take_in(file: Path = FOUND) -> Table:
    """Take what the benchmark stored."""
    return table_of(json.loads(file.read_text(encoding="utf-8")))


def _first() -> Mapping[int, Row]:
    """One log of one case again."""
    sys.path.insert(0, str(ROOT / "benchmarks"))
    try:
        from wrong_laws import measured
    finally:
        sys.path.pop(0)
    case, size = CHECKED
    # Logs of every size begin alike, but a log is cut from as many trajectories as the largest has.
    found = {(row["policy"]): row["gain"] for row in table_of([measured(case, 0, [size, 100, SHOWN])[0]])}
    return {
        index: row | {"gain": found[row["policy"]]}
        for index, row in enumerate(WRONG_LAWS_NUMBERS.read())
        if (row["case"], row["size"], row["log"]) == (case, size, 0)
    }


def draw_wrong_laws(rows: Table) -> Figure:
    """Draw the means over logs of 800 trajectories, with two standard errors, by case."""
    some = [row for row in rows if row["size"] == SHOWN]
    cases = list(dict.fromkeys(row["case"] for row in some))
    made, axes = panel(4.2, "points a table above the best rule")
    for place, (name, (marker, colour)) in enumerate(LOOKS.items()):
        for at, case in enumerate(cases):
            gains = np.array([row["gain"] for row in some if (row["case"], row["policy"]) == (case, name)])
            error = 2.0 * gains.std(ddof=1) / np.sqrt(len(gains))
            y = len(cases) - 1 - at + 0.22 * (1 - place)
            axes.plot([gains.mean() - error, gains.mean() + error], [y, y], color=colour, lw=1.6)
            axes.plot(gains.mean(), y, marker, color=colour, ms=5, label=None if at else name)
    axes.axvline(0.0, color=INK, lw=0.8)
    axes.set_yticks(range(len(cases)), cases[::-1])
    made.legend(loc="outside lower center", ncols=3, **LEGEND)
    return made


WRONG_LAWS_NUMBERS = Numbers("wrong-laws.csv", take_in, _first)
WRONG_LAWS = plot("wrong-laws", draw_wrong_laws, WRONG_LAWS_NUMBERS, 60.0)
