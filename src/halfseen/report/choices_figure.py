"""What was done in the states of each stage, and what the policy would do there; few states look like few."""

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from halfseen.pages.axes import NARROW_INCHES, draw_grid
from halfseen.pages.palette import OURS, THEIRS
from halfseen.shapes import Float

MOST_CHOICES = 9
NUM_COLUMNS = {1: 1, 2: 2, 3: 3, 4: 2, 5: 3, 6: 3, 7: 4, 8: 4, 9: 3}
"""By number of panels: so many that at most one cell is left, which the legend then has."""
FEW_STATES = 20
"""Below so many, markers are hollow and lines thin."""
LARGEST, SMALLEST = 90.0, 7.0
"""Areas of markers [pt²]."""
MOST_TICKS = 8

Rows = list[dict[str, Any]]


def drawn_actions(choices: Rows) -> list[str]:
    """Name the actions that have a panel: of those that the policy or the log takes at all, the most frequent."""
    total = {
        name: sum(row["num_states"] * max(row["policy"][name], row["logged"][name] or 0.0) for row in choices)
        for name in choices[0]["policy"]
    }
    kept = sorted((name for name in total if total[name] > 0), key=lambda name: -total[name])[:MOST_CHOICES]
    return [name for name in total if name in kept]


def draw_choices(choices: Rows) -> Figure:
    """Draw a panel for each action: the proportion of the states of each stage in which it is taken."""
    names = drawn_actions(choices)
    columns = NUM_COLUMNS[len(names)]
    rows = -(-len(names) // columns)
    is_full = rows * columns == len(names)
    head = 0.58 if is_full else 0.28
    height = 2.2 * rows + head + 0.35
    figure = Figure(figsize=(NARROW_INCHES, height))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    figure.subplots_adjust(
        left=0.105, right=0.985, top=1 - head / height, bottom=0.68 / height, hspace=0.36, wspace=0.12
    )
    for axes, name in zip(panels.flat, names, strict=False):
        _draw_action(axes, choices, name)
    _mark_stages(panels, choices, len(names))
    for axes in panels[:, 0]:
        axes.set_ylabel("proportion of the states")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    if is_full:
        figure.legend(handles, labels, loc="upper left", ncols=2, frameon=False)
    else:
        panels.flat[-1].set_axis_off()
        panels.flat[-1].legend(handles, labels, loc="center left", frameon=False)
    return figure


def _draw_action(axes: Axes, choices: Rows, name: str) -> None:
    stage, count = np.array([(row["stage"], row["num_states"]) for row in choices], dtype=float).T
    area = np.maximum(LARGEST * count / count.max(), SMALLEST)
    for who, colour, marker, label in (
        ("logged", THEIRS, "s", "what was done"),
        ("policy", OURS, "o", "the policy"),
    ):
        share = np.array([np.nan if row[who][name] is None else row[who][name] for row in choices], dtype=float)
        _draw_line(axes, stage, share, count, colour)
        face = [colour if many else "white" for many in count >= FEW_STATES]
        place: Any = {"marker": marker, "edgecolors": colour, "linewidths": 1.2, "clip_on": False, "zorder": 3}
        axes.scatter(stage, share, s=area.tolist(), c=face, **place)
        axes.plot([], [], f"{marker}-", color=colour, ms=6, lw=1.4, label=label)
    axes.set_title(name, loc="left", fontsize=9.5, fontweight="bold")
    draw_grid(axes)
    axes.set_ylim(0.0, 1.0)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))


def _draw_line(
    axes: Axes,
    stage: Float[np.ndarray, " T"],
    share: Float[np.ndarray, " T"],
    count: Float[np.ndarray, " T"],
    colour: str,
) -> None:
    for k, after in pairwise(range(len(stage))):
        is_firm = min(count[k], count[after]) >= FEW_STATES
        ends = [k, after]
        axes.plot(stage[ends], share[ends], "-", color=colour, lw=1.5 if is_firm else 0.6, clip_on=False, zorder=2.5)


def _mark_stages(panels: Any, choices: Rows, num_panels: int) -> None:
    """Write below each stage how many states it has, under the lowest panel of each column."""
    stages = [row["stage"] for row in choices]
    count = {row["stage"]: row["num_states"] for row in choices}
    shown = MaxNLocator(MOST_TICKS, integer=True, min_n_ticks=1).tick_values(stages[0], stages[-1])
    ticks = stages if len(stages) <= MOST_TICKS else [int(stage) for stage in shown if stage in count]
    panels[0, 0].set_xlim(stages[0] - 0.5, stages[-1] + 0.5)
    panels[0, 0].set_xticks(ticks, [f"{stage}\n({_short(count[stage])})" for stage in ticks])
    num_rows, num_columns = panels.shape
    for column in range(num_columns):
        last = max(k for k in range(num_rows) if k * num_columns + column < num_panels)
        panels[last, column].set_xlabel("stage (states)")
        panels[last, column].tick_params(labelbottom=True)


def _short(count: int) -> str:
    return f"{count}" if count < 10_000 else f"{count / 1000:.0f}k"
