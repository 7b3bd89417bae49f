"""Figures of points with intervals: panels, series side by side, policies as lines across, and their names."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfseen import figures as pages
from halfseen.figures import MARKERS, EndLabel, draw_bars, learned_shades, write_title
from halfseen.study.compare import where
from halfseen.study.policies import LEARNED, Contender, Kind
from halfseen.wording import amount, share

INTERVAL = ["mean_reward", "low", "high"]  # columns of a mean reward and its interval
TRAJECTORIES_AXIS = "logged trajectories that the policy was learned from (log scale)"
REWARD_AXIS = "mean reward of a trajectory, on fresh episodes"
Looks = Mapping[str, dict[str, Any]]  # colour, marker and name of each series


def looks(colours: Mapping[str, str], names: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Colour, marker and name of each series, by what it is."""
    return {
        each: {"color": colour, "marker": marker, "label": names[each]}
        for marker, (each, colour) in zip(MARKERS, colours.items(), strict=False)
    }


def panels(
    title: str, size: tuple[float, float], shape: tuple[int, int], below: float, share: tuple[Any, Any], **grid: float
) -> tuple[Figure, float, Any]:
    """Make a figure of panels that begin `below` its title, which ends at the height that is returned.

    `share` says which panels share their axes, as Matplotlib's `sharex` and `sharey`.
    """
    figure = Figure(figsize=size)
    top = write_title(figure, title)
    made = figure.add_gridspec(*shape, top=top - below, **grid)
    return figure, top, made.subplots(squeeze=False, sharex=share[0], sharey=share[1])


def two_panels(
    figure: Figure, top: float, left: float, width: float, foot: float, gap: float, lower_share: float
) -> tuple[Axes, Axes]:
    """Make a panel above another that takes a share of the height; what is at the right is left for names."""
    middle = foot + lower_share * (top - foot - gap)
    upper = figure.add_axes((left, middle + gap, width, top - middle - gap))
    return upper, figure.add_axes((left, foot, width, middle - foot), sharex=upper)


def name_panel(axes: Axes, title: str, across: str = "") -> None:
    """Write what a panel shows above it, and what its axis is below."""
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
    """Draw series, side by side along a logarithmic axis; `by` names the column of the series and of the axis."""
    name, across = by
    for k, (value, look) in enumerate(series.items()):
        rows = where(table, **{name: value})
        draw(axes, pages.dodged(rows[across], k, len(series), dodge), rows[list(columns)], **look)


def write_names(figure: Figure, top: float, names: Mapping[str, str], *of: Axes, **options: Any) -> None:
    """Explain the series of panels, in the order of their names."""
    known = pages.named_curves(*of)
    pages.write_legend(figure, {name: known[name] for name in names.values() if name in known}, top, **options)


def draw_level(axes: Axes, who: Contender, value: float, is_bold: bool, more: str = "") -> EndLabel:
    """Draw what a policy is worth as a line across; the optimum has a name alone, as it is an end of the axis."""
    if who.kind != Kind.OPTIMUM:
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
    """Draw what was learned by size of the log, a curve for each proportion of cut trajectories."""
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
    """Mark the sizes of logs, name a panel, and write the names of all lines at its right."""
    pages.mark_sizes(axes, sizes)
    axes.set_xlim(min(sizes) / margins[0], max(sizes) * margins[1])
    name_panel(axes, name)
    pages.write_end_labels(axes, labels)
