"""What figures of several experiments draw alike: policies as lines across, and curves by share of cut trajectories."""

from collections.abc import Callable, Sequence

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfseen.figures import (
    MARKERS,
    PANEL_TITLE,
    WIDTH_INCHES,
    EndLabel,
    dodged,
    learned_shades,
    mark_sizes,
    write_end_labels,
    write_title,
)
from halfseen.study.frames import where
from halfseen.study.policies import LEARNED, Contender, Kind
from halfseen.study.wording import TRAJECTORIES_AXIS
from halfseen.wording import amount, share

MEAN = ["mean_reward", "low", "high"]
"""Columns of a mean and its interval."""


def draw_level(axes: Axes, who: Contender, value: float, is_bold: bool) -> EndLabel:
    """Draw what a policy is worth as a line across; the optimum has a name alone, as it is an end of the axis."""
    if who.kind != Kind.OPTIMUM:
        dashes, width = (0, who.dashes), 1.5 if is_bold else 0.9
        axes.axhline(value, color=who.colour, linestyle=dashes, linewidth=width, zorder=1.2)
    return EndLabel(value, f"{who.label}  {amount(value)}", who.colour, is_bold)


def draw_by_cut_share(
    axes: Axes,
    table: pd.DataFrame,
    cut_shares: Sequence[float],
    columns: list[str],
    draw: Callable[..., None],
    dodge: float,
) -> list[EndLabel]:
    """Draw what was learned by size of the log, a curve for each proportion of cut trajectories."""
    labels, num = [], len(cut_shares)
    for k, (cut_share, colour) in enumerate(zip(cut_shares, learned_shades(num), strict=True)):
        rows = where(table, policy=LEARNED.name, cut_share=cut_share)
        across = dodged(rows["num_trajectories"], k, num, dodge)
        draw(axes, across, rows[columns], color=colour, marker=MARKERS[k % len(MARKERS)])
        end = float(rows[columns[0]].iloc[-1])
        cut = "no trajectory cut" if cut_share == 0 else f"{share(cut_share)} of the trajectories cut"
        labels.append(EndLabel(end, f"learned, {cut}  {amount(end)}", colour))
    return labels


def draw_by_size(
    title: str, name: str, sizes: Sequence[int], margins: tuple[float, float], draw: Callable[[Axes], list[EndLabel]]
) -> Figure:
    """Draw one panel over the size of the log, with the names of all lines at its right."""
    figure = Figure(figsize=(WIDTH_INCHES, 5.6))
    top = write_title(figure, title) - 0.08
    axes = figure.add_axes((0.07, 0.10, 0.58, top - 0.10))
    labels = draw(axes)
    mark_sizes(axes, sizes)
    axes.set_xlim(min(sizes) / margins[0], max(sizes) * margins[1])
    axes.set_xlabel(TRAJECTORIES_AXIS)
    axes.set_title(name, **PANEL_TITLE)
    write_end_labels(axes, labels)
    return figure
