"""How long trajectories were watched: Ĝ, when they ended, and how many were still watched."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfseen.pages.axes import NARROW_INCHES, draw_grid
from halfseen.pages.palette import INK, LINES, OURS
from halfseen.report.endings import FINISHED_ROW
from halfseen.report.log_findings import Watched


def draw_watched(watched: Watched) -> Figure:
    """Draw Ĝ, below it the ends of trajectories, and below these the numbers still watched."""
    num_rows = len(watched.ends_s)
    heights = [2.5, 0.24 * num_rows + 0.1]
    figure = Figure(figsize=(NARROW_INCHES, sum(heights) + 0.9))
    curve, ends = figure.subplots(2, 1, sharex=True, height_ratios=heights)
    figure.subplots_adjust(left=0.235, right=0.97, top=0.97, bottom=0.73 / (sum(heights) + 0.9), hspace=0.08)
    curve.step(watched.time_s, watched.survival, where="post", color=OURS)
    curve.set_ylim(0.0, 1.04)
    curve.set_ylabel("Ĝ: probability that a trajectory\nhas not been cut so far")
    draw_grid(curve)
    curve.tick_params(axis="x", length=0, labelbottom=False)
    for place, (name, ends_s) in enumerate(watched.ends_s.items()):
        colour = INK if name == FINISHED_ROW else LINES[1:][(place - 1) % (len(LINES) - 1)]
        ends.plot(ends_s, np.full(len(ends_s), place), "|", ms=9, mew=0.9, alpha=0.7, color=colour)
    names = [f"{name} ({len(ends_s):,})" for name, ends_s in watched.ends_s.items()]
    ends.set_yticks(range(num_rows), names)
    ends.tick_params(axis="y", length=0)
    ends.set_ylim(num_rows - 0.4, -0.6)
    ends.set_xlim(0.0, 1.01 * watched.time_s[-1])
    ends.set_xticks(watched.risk_time_s.tolist())
    ends.set_xlabel("time since the trajectory began [s]", labelpad=20)
    _write_numbers(ends, watched)
    return figure


def _write_numbers(axes: Axes, watched: Watched) -> None:
    place: Any = {"xytext": (0, -21), "textcoords": "offset points", "va": "top", "color": OURS}
    for time_s, count in zip(watched.risk_time_s, watched.num_watched, strict=True):
        axes.annotate(f"{count:,}", (float(time_s), 0), xycoords=("data", "axes fraction"), ha="center", **place)
    axes.annotate("still watched", (-0.05, 0), xycoords="axes fraction", ha="right", **place)
