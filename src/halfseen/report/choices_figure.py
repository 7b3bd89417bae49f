"""What the policy would do in the states of the log, beside what was done."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from halfseen.pages.axes import NARROW_INCHES
from halfseen.pages.palette import FAINT, OURS, THEIRS

MOST_ACTIONS, COLUMNS = 9, 3


def drawn_actions(choices: list[dict[str, Any]]) -> list[str]:
    """Name the actions that have a panel: those that the policy or the log takes most."""
    total = {
        name: sum(row["num_states"] * max(row["policy"][name], row["logged"][name] or 0.0) for row in choices)
        for name in choices[0]["policy"]
    }
    kept = sorted(total, key=lambda name: -total[name])[:MOST_ACTIONS]
    return [name for name in total if name in kept]


def draw_choices(choices: list[dict[str, Any]]) -> Figure:
    """Draw a panel for each action: the proportion of the states of each stage in which it is taken."""
    names = drawn_actions(choices)
    columns = min(COLUMNS, len(names))
    rows = -(-len(names) // columns)
    height = 2.0 * rows + 0.75
    figure = Figure(figsize=(NARROW_INCHES, height))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    figure.subplots_adjust(
        left=0.105, right=0.985, top=1 - 0.58 / height, bottom=0.5 / height, hspace=0.32, wspace=0.12
    )
    stage = np.array([row["stage"] for row in choices])
    for axes, name in zip(panels.flat, names, strict=False):
        for who, colour, marker, label in (
            ("logged", THEIRS, "s", "what was done"),
            ("policy", OURS, "o", "what the policy would do"),
        ):
            share = np.array([np.nan if row[who][name] is None else row[who][name] for row in choices], dtype=float)
            axes.plot(stage, share, f"{marker}-", color=colour, ms=5, lw=1.4, label=label, clip_on=False, zorder=3)
        axes.set_title(name, loc="left", fontsize=9.5, fontweight="bold")
        axes.grid(axis="y", color=FAINT, lw=0.7)
        axes.set_ylim(0.0, 1.0)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    panels[0, 0].set_xlim(stage[0] - 0.5, stage[-1] + 0.5)
    for axes in panels.flat[len(names) :]:
        axes.set_axis_off()
    for column in range(columns):
        last = max(k for k in range(rows) if k * columns + column < len(names))
        panels[last, column].set_xlabel("stage")
        panels[last, column].tick_params(labelbottom=True)
    for axes in panels[:, 0]:
        axes.set_ylabel("proportion of the states")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", ncols=2, frameon=False, fontsize=9.5)
    return figure
