"""What learners of the pick cell reach of the optimum, on the same logs."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from halfseen.figures import ALARM, BLUE, INK, SOFT
from pictures.examples import importable
from pictures.picture import Numbers, Row, Table, plot
from pictures.style import LEGEND, panel

importable("pick_cell")


def _methods(num_logs: int = 5) -> Table:
    from cell_comparison import compare
    from cell_optimum import optimum

    found = compare(1000, num_logs, 0).assign(share=lambda frame: frame["value"] / optimum()[0])
    return [{"log": row.log, "method": row.method, "share": float(row.share)} for row in found.itertuples()]


def draw_methods(rows: Table) -> Figure:
    """Draw the share of the optimum that each method reaches, a dot for each log."""
    from cell_optimum import optimum, policy_value
    from cell_trajectories import rule_of_thumb

    methods = list(dict.fromkeys(row["method"] for row in rows))
    made, axes = panel(2.7, "share of the optimum, learned from 1,000 parts", has_grid=False)
    for place, name in enumerate(methods):
        shares = [row["share"] for row in rows if row["method"] == name]
        axes.plot(shares, np.full(len(shares), place), "o", color=BLUE if name == "default" else SOFT, alpha=0.75)
        axes.plot(np.mean(shares), place, "|", color=INK, ms=16, mew=2.0)
    axes.axvline(policy_value(rule_of_thumb) / optimum()[0], color=ALARM, ls="--", lw=1.2, label="the rule of thumb")
    axes.set_yticks(range(len(methods)), methods)
    axes.tick_params(axis="y", length=0)
    axes.invert_yaxis()
    axes.legend(loc="upper left", **LEGEND)
    return made


def _first_log() -> Mapping[int, Row]:
    return dict(enumerate(_methods(1)))


PICK_CELL_LEARNERS = plot("pick-cell-learners", draw_methods, Numbers("pick-cell-learners.csv", _methods, _first_log))
