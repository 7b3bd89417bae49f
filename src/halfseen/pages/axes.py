"""What several figures draw alike: titles, sizes of logs, curves with bands, bars, and names at the ends of lines."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from halfseen.pages.palette import BAND_OPACITY, FAINT, INK
from halfseen.shapes import Float

WIDTH_INCHES, NARROW_INCHES = 9.0, 7.4
TITLE_TOP, TITLE_POINTS, TITLE_CHARS = 0.98, 11.5, 92
PANEL_TITLE: dict[str, Any] = {"loc": "left", "fontsize": 9.0, "pad": 8.0}
LABEL_GAP_INCHES = 0.175


@dataclass(frozen=True)
class EndLabel:
    """A line's name, written to the right of the axes."""

    height: float
    text: str
    colour: Any
    is_bold: bool = False


def write_title(figure: Figure, title: str) -> float:
    """Write the title in lines of even length; return the height of its lower end as a share of the figure's."""
    if not title:
        return 1.0
    width = round(TITLE_CHARS * figure.get_size_inches()[0] / WIDTH_INCHES)
    num_lines = len(textwrap.wrap(title, width))
    balanced = next(narrow for narrow in range(1, width + 1) if len(textwrap.wrap(title, narrow)) <= num_lines)
    lines = textwrap.wrap(title, balanced)
    figure.text(0.012, TITLE_TOP, "\n".join(lines), fontsize=TITLE_POINTS, fontweight="bold", va="top", linespacing=1.3)
    return TITLE_TOP - len(lines) * 1.3 * TITLE_POINTS / 72 / figure.get_size_inches()[1]


def write_above(axes: Axes, text: str, points: float, weight: str = "bold") -> None:
    """Write so many points above the left end of a panel."""
    place: Any = {"xycoords": "axes fraction", "textcoords": "offset points", "xytext": (0.0, points)}
    axes.annotate(text, (0.0, 1.0), fontweight=weight, **place)


def write_legend(figure: Figure, named: Mapping[str, Any], top: float, **options: Any) -> None:
    """Explain curves, which are given by name, above the panels, in one line unless `ncols` says otherwise."""
    place: Any = {"loc": "upper left", "bbox_to_anchor": (0.05, top), "ncols": len(named), "frameon": False}
    figure.legend(list(named.values()), list(named), **(place | options))


def named_curves(*panels: Axes) -> dict[str, Any]:
    """What stands in a legend of these panels, by name."""
    found = {}
    for axes in panels:
        found |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    return found


def draw_grid(axes: Axes) -> None:
    """Draw faint lines at the heights of the ticks, behind all else."""
    axes.grid(axis="y", color=FAINT, linewidth=0.6, zorder=0)
    axes.set_axisbelow(True)


def mark_sizes(axes: Axes, sizes: Sequence[int]) -> None:
    """Mark these sizes, and no others, on a logarithmic axis."""
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator([float(size) for size in sizes]))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(lambda size, _: f"{size:g}")
    draw_grid(axes)


def draw_zero(axes: Axes, colour: str = INK, width: float = 1.0) -> None:
    """Draw a line at 0, with which differences are compared."""
    axes.axhline(0.0, color=colour, linewidth=width, zorder=1.5)


def dodged(across: Any, place: int, num: int, factor: float) -> Float[np.ndarray, " k"]:
    """Places of one of `num` curves along a logarithmic axis, where they stand side by side."""
    return np.asarray(across, dtype=float) * factor ** (place - (num - 1) / 2)


def draw_curve(axes: Axes, across: Any, estimates: Any, **options: Any) -> None:
    """Draw a line with markers and a band; `estimates` has the columns mean, low and high."""
    mean, low, high = np.asarray(estimates, dtype=float).T
    across = np.asarray(across, dtype=float)
    axes.fill_between(across, low, high, color=options["color"], alpha=BAND_OPACITY, linewidth=0, zorder=2)
    axes.plot(across, mean, **{"zorder": 2.5, **options})


def draw_bars(axes: Axes, across: Any, estimates: Any, **options: Any) -> None:
    """Draw markers with intervals as bars: bands that lie on one another would hide one another."""
    mean, low, high = np.asarray(estimates, dtype=float).T
    reach = np.stack([mean - low, high - mean])
    usual = {"elinewidth": 1.4, "linewidth": 0.8, "capsize": 2.5, "zorder": 2.5}
    axes.errorbar(np.asarray(across, dtype=float), mean, reach, **{**usual, **options})


def write_end_labels(axes: Axes, labels: Sequence[EndLabel]) -> None:
    """Name lines at the right edge, moved apart as little as needed and tied to their ends."""
    low, high = axes.get_ylim()
    figure: Any = axes.figure
    height_inches = figure.get_size_inches()[1] * axes.get_position().height
    heights = spread([label.height for label in labels], LABEL_GAP_INCHES / height_inches * (high - low), low, high)
    at = axes.get_yaxis_transform()
    for label, height in zip(labels, heights, strict=True):
        tie = [label.height, label.height, height, height]
        axes.plot([1.005, 1.015, 1.045, 1.055], tie, transform=at, color=label.colour, linewidth=1.3, clip_on=False)
        weight = "bold" if label.is_bold else "normal"
        axes.text(1.065, height, label.text, transform=at, va="center", fontsize=8.5, fontweight=weight)
    axes.set_ylim(low, high)


def spread(heights: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """Move heights at least `gap` apart, in their order, with the least squared moves, and within [low, high]."""
    order = np.argsort(heights, kind="stable")
    steps = gap * np.arange(len(heights))
    lowered = isotonic(np.asarray(heights, dtype=float)[order] - steps)
    placed: Float[np.ndarray, " k"] = np.empty(len(heights))
    placed[order] = np.clip(lowered, low, max(low, high - gap * (len(heights) - 1))) + steps
    return placed.tolist()


def isotonic(values: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """The nearest values, by least squares, that nowhere fall: pool adjacent violators [BarlowEtAl1972]_."""
    means: list[float] = []
    sizes: list[int] = []
    for value in values:
        mean, size = float(value), 1
        while means and means[-1] >= mean:
            size += sizes[-1]
            mean += (means.pop() - mean) * sizes.pop() / size
        means.append(mean)
        sizes.append(size)
    return np.repeat(means, sizes)
