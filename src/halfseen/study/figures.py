"""Figures of points with intervals: panels, series side by side, policies as level lines, and their names."""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfseen import figures as pages
from halfseen.figures import MARKERS, EndLabel, draw_bars, learned_shades, write_title
from halfseen.study.compare import where
from halfseen.study.policies import LEARNED, Entrant, StudyKind
from halfseen.wording import amount, share

INTERVAL = ["mean_reward", "low", "high"]  # columns of a mean reward and its interval
TRAJECTORIES_AXIS = "logged trajectories that the policy was learned from (log scale)"
REWARD_AXIS = "mean reward of a trajectory, on fresh episodes"
Looks = Mapping[str, dict[str, Any]]  # colour, marker and name of each series


def looks(colours: Mapping[str, str], names: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Colour, marker and name of each series, by its key."""
    return {
        each: {"color": colour, "marker": marker, "label": names[each]}
        for marker, (each, colour) in zip(MARKERS, colours.items(), strict=False)
    }


def panels(
    title: str, size: tuple[float, float], shape: tuple[int, int], below: float, share: tuple[Any, Any], **grid: float
) -> tuple[Figure, float, Any]:
    """Make a figure of panels that begin `below` its title, and return the height at which the title ends.

    `share` is Matplotlib's `sharex` and `sharey`.
    """
    figure = Figure(figsize=size)
    top = write_title(figure, title)
    made = figure.add_gridspec(*shape, top=top - below, **grid)
    return figure, top, made.subplots(squeeze=False, sharex=share[0], sharey=share[1])


def two_panels(
    figure: Figure, top: float, left: float, width: float, foot: float, gap: float, lower_share: float
) -> tuple[Axes, Axes]:
    """Make two panels, the lower with a share of the height; the space at the right is left for names."""
    middle = foot + lower_share * (top - foot - gap)
    upper = figure.add_axes((left, middle + gap, width, top - middle - gap))
    return upper, figure.add_axes((left, foot, width, middle - foot), sharex=upper)


def name_panel(axes: Axes, title: str, across: str = "") -> None:
    """Write the title of a panel above it, and the label of its horizontal axis."""
    axes.set_title(title, **pages.PANEL_TITLE)
    if across:
        axes.set_xlabel(across)


def draw_series(
    axes: Axes,
    table: pd.DataFrame,
    by: tuple[str, str],
    series: Looks,
    columns: Sequence[str],
    dodge: float,
    draw: Callable[..., None] = draw_bars,
) -> None:
    """Draw series side by side along a logarithmic axis; `by` names the columns of the series and of the axis."""
    name, across = by
    for k, (value, look) in enumerate(series.items()):
        rows = where(table, **{name: value})
        draw(axes, pages.dodged(rows[across], k, len(series), dodge), rows[list(columns)], **look)


def write_names(figure: Figure, top: float, names: Mapping[str, str], *of: Axes, **options: Any) -> None:
    """Write a legend of the series of panels, in the order of their names."""
    known = pages.named_curves(*of)
    pages.write_legend(figure, {name: known[name] for name in names.values() if name in known}, top, **options)


def draw_level(axes: Axes, who: Entrant, value: float, is_bold: bool, more: str = "") -> EndLabel:
    """Draw the value of a policy as a level line; the optimum has a name only, as it is an end of the axis."""
    if who.kind != StudyKind.OPTIMUM:
        dashes, width = (0, who.dashes), 1.5 if is_bold else 0.9
        axes.axhline(value, color=who.colour, linestyle=dashes, linewidth=width, zorder=1.2)
    return EndLabel(value, f"{who.label}  {amount(value)}{more}", who.colour, is_bold)


def draw_by_cut_share(
    axes: Axes,
    table: pd.DataFrame,
    cut_shares: Sequence[float],
    columns: Sequence[str],
    draw: Callable[..., None],
    dodge: float,
    more: str = "",
) -> list[EndLabel]:
    """Draw learned policies by size of the log, with a curve for each proportion of cut trajectories."""
    labels, num = [], len(cut_shares)
    for k, (cut_share, colour) in enumerate(zip(cut_shares, learned_shades(num), strict=True)):
        rows = where(table, policy=LEARNED.name, cut_share=cut_share)
        across = pages.dodged(rows["num_trajectories"], k, num, dodge)
        draw(axes, across, rows[list(columns)], color=colour, marker=MARKERS[k % len(MARKERS)])
        end = float(rows[columns[0]].iloc[-1])
        cut = "no trajectory cut" if cut_share == 0 else f"{share(cut_share)} of the trajectories cut"
        labels.append(EndLabel(end, f"learned, {cut}  {amount(end)}{more}", colour))
    return labels


def finish_by_size(
    axes: Axes, name: str, sizes: Sequence[int], margins: tuple[float, float], labels: Sequence[EndLabel]
) -> None:
    """Mark the sizes of logs, title a panel, and write the names of all lines at its right."""
    pages.mark_sizes(axes, sizes)
    axes.set_xlim(min(sizes) / margins[0], max(sizes) * margins[1])
    name_panel(axes, name)
    pages.write_end_labels(axes, labels)


def draw_named_bars(points: pd.DataFrame, colours: Sequence[str], across: str, title: str) -> Figure:
    """Draw values with their intervals, the columns of `INTERVAL`, as bars from 0, by name."""
    lines = textwrap.wrap(title, 62)
    figure = Figure(figsize=(7.2, 0.75 + 0.55 * len(points) + 0.26 * len(lines)), layout="constrained")
    axes = figure.add_subplot()
    beside: Any = {"xytext": (6, 0), "textcoords": "offset points", "va": "center", "fontsize": 13}
    for place, (mean, low, high) in enumerate(points.to_numpy().tolist()):
        axes.barh(place, mean, height=0.62, color=colours[place])
        for colour, width in (("white", 3.4), ("black", 1.2)):
            axes.plot([low, high], [place, place], color=colour, linewidth=width, solid_capstyle="butt")
        axes.annotate(amount(mean, 1), (max(high, mean), place), fontweight="bold", **beside)
    axes.set_yticks(range(len(points)), list(points.index), fontsize=12)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.22 * float(points[["mean_reward", "high"]].max(axis=None)))
    axes.set_xlabel(across, fontsize=11, x=0.9, ha="right")
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    if title:
        figure.suptitle("\n".join(lines), x=0.012, ha="left", fontsize=13, fontweight="bold", linespacing=1.3)
    return figure
