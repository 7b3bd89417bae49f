"""A policy in service in the bin cell, whose gripper wears from one trajectory on: evidence for a change, by family."""

from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from halfseen.figures import ALARM, GREEN, INK, ORANGE, OURS, PINK, draw_grid
from pictures.example_policy import BIN_CELL, example_policy
from pictures.examples import importable
from pictures.picture import Table, plot, whole
from pictures.style import figure

importable("bin_cell")

NUM, WORN_FROM, WEAR, EVERY = 600, 300, 0.3, 5
COLOURS = {"rewards": OURS, "promise": ORANGE, "inputs": GREEN, "parts": PINK}


def _monitored() -> Table:
    import bin_cell

    from halfseen.logs import Logs
    from halfseen.monitoring import monitored

    stored, usual = example_policy(BIN_CELL), bin_cell.reach

    class Served(bin_cell.Bin):
        def logging(self, frame, stage):
            return (np.array(self.actions) == stored.policy.decide(frame, stage)[:, None]).astype(float)

    before = Served().log(WORN_FROM, 1, 1 / 3)
    with patch.object(bin_cell, "reach", lambda state: np.clip(usual(state) - WEAR, 0.02, 0.95)):
        after = Served().log(NUM - WORN_FROM, 2, 1 / 3)
    later = {name: table.assign(trajectory=table["trajectory"] + WORN_FROM) for name, table in after.tables.items()}
    both: Any = {name: pd.concat([table, later[name]]) for name, table in before.tables.items()}
    found = monitored(stored, Logs(**both))
    p = found.p_values
    return [
        {"num": float(k + 1), "alarm_at": float(found.alarm_at or 0), **{name: float(p[name][k]) for name in COLOURS}}
        for k in range(EVERY - 1, NUM, EVERY)
    ]


def draw_monitor(rows: Table) -> Figure:
    """Draw the smallest p-value of each family, with the level at which it alarms."""
    from halfseen.monitoring.monitor import ALPHAS

    made = figure(3.2)
    axes = made.subplots()
    num = [row["num"] for row in rows]
    for name, colour in COLOURS.items():
        axes.plot(num, [max(row[name], 1e-8) for row in rows], color=colour, label=name)
        axes.axhline(ALPHAS[name], color=colour, linestyle=":", linewidth=1.0)
    axes.axvline(WORN_FROM, color=INK, linewidth=1.0)
    axes.text(WORN_FROM - 6, 3e-5, "the gripper wears", ha="right", fontsize=8.5)
    axes.axvline(rows[0]["alarm_at"], color=ALARM, linewidth=1.2)
    axes.text(num[-1], 0.1, f"alarm at {rows[0]['alarm_at']:.0f}", color=ALARM, ha="right", fontsize=8.5)
    axes.set_yscale("log")
    axes.set_ylim(1e-8, 2.0)
    axes.set_yticks([1.0, 1e-2, 1e-4, 1e-6, 1e-8], ["1", "0.01", "0.0001", "1e-6", "1e-8"])
    axes.minorticks_off()
    axes.set(xlabel="trajectories so far", ylabel="adjusted p-value")
    axes.legend(frameon=False, loc="lower left", fontsize=8.5)
    draw_grid(axes)
    return made


MONITOR = plot("monitor", draw_monitor, whole("monitor.csv", _monitored))
