"""Figures 1 and 4, drawn from the tables alone: the same results give the same bytes."""

import io
import os
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator
from scipy.optimize import isotonic_regression

from halfseen.study.design import TREATMENTS
from halfseen.study.findings import LEARNED, WEIGHTED, Z_95, baseline, learned, learned_curve
from halfseen.study.results import BASELINE_NAMES, TREATMENT_NAMES, StudyResults
from halfseen.study.sentences import figure1_title, figure4_title
from halfseen.study.wording import CUT_KIND_NAMES, CUT_KIND_NOTES, amount, share

DOTS_PER_INCH = 200
FIGURE1_INCHES = (9.0, 5.6)
INK = "#222222"
FAINT = "#d9d9d9"
# Shares are ordered, so their colours go from dark to light; plasma's lightness orders them for colour-blind eyes too.
SHARE_COLOURS = "plasma"
LIGHTEST_SHARE = 0.80
PLANNER_COLOUR = "#00795c"
HEURISTIC_COLOUR = "#777777"
# Okabe and Ito (2008).
TREATMENT_COLOURS = {"weighted": "#0072B2", "unweighted": "#D55E00", "dropped": "#8a8a8a", "failures": "#CC79A7"}
MARKERS = "os^Dvp"
BAND_OPACITY = 0.16
# Curves stand side by side rather than on one another: factor between neighbours along the log axis.
DODGE = 1.02
BAR_DODGE = 1.10
LABEL_GAP_INCHES = 0.175

PATHS_AXIS = "logged paths that the policy was learned from (log scale)"
REWARD_AXIS = "mean reward of a path, on fresh episodes"
GAIN_AXIS = "reward that weighting adds, over each other treatment"
TITLE_TOP = 0.98
TITLE_POINTS = 11.5
PANEL_TITLE: dict[str, Any] = {"loc": "left", "fontsize": 9.0, "pad": 8.0}

STYLE: Any = {
    "svg.hashsalt": "halfseen",
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.unicode_minus": True,
    "lines.linewidth": 1.8,
    "lines.markersize": 4.5,
}


@dataclass(frozen=True)
class EndLabel:
    """A line's name, written to the right of the axes."""

    reward: float
    text: str
    colour: Any
    is_bold: bool = False


def svg(figure_of: Callable[[StudyResults], Figure], results: StudyResults) -> bytes:
    """Draw a figure as SVG.

    Parameters
    ----------
    figure_of
        `figure1_of` or `figure4_of`.
    results
        What the study found.
    """
    return _drawn(figure_of, results, "svg", {"Date": None, "Creator": None, "Format": None, "Type": None})


def png(figure_of: Callable[[StudyResults], Figure], results: StudyResults) -> bytes:
    """Draw a figure as PNG.

    Parameters
    ----------
    figure_of
        `figure1_of` or `figure4_of`.
    results
        What the study found.
    """
    return _drawn(figure_of, results, "png", {"Software": None})


def figure1_of(results: StudyResults, is_titled: bool = True) -> Figure:
    """Figure 1, to be made and drawn within `style`."""
    figure = Figure(figsize=FIGURE1_INCHES)
    rivals = (results.best_planner, results.best_heuristic)
    title = figure1_title(results.figure1, results.table1, results.design, rivals)
    top = write_title(figure, title if is_titled else "", 92) - 0.08
    axes = figure.add_axes((0.07, 0.10, 0.60, top - 0.10))
    labels = _draw_baselines(axes, results) + _draw_learned(axes, results)
    mark_sizes(axes, results.design.num_paths)
    axes.set_xlim(min(results.design.num_paths) / 1.08, max(results.design.num_paths) * 1.05)
    axes.set_xlabel(PATHS_AXIS)
    axes.set_title(REWARD_AXIS, **PANEL_TITLE)
    write_end_labels(axes, labels)
    return figure


def figure4_of(results: StudyResults, is_titled: bool = True) -> Figure:
    """Figure 4, to be made and drawn within `style`."""
    kinds = results.design.treatment_cut_kinds
    figure = Figure(figsize=(0.9 + 4.0 * len(kinds), 7.2))
    title = figure4_title(results.figure4, results.design)
    top = write_title(figure, title if is_titled else "", 42 * len(kinds) + 6)
    grid = figure.add_gridspec(
        2, len(kinds), left=0.065, right=0.985, bottom=0.07, top=top - 0.18, hspace=0.36, wspace=0.10
    )
    panels: Any = grid.subplots(sharex=True, sharey="row", squeeze=False)
    for column, kind in enumerate(kinds):
        rows = pd.DataFrame(results.figure4[results.figure4["cut_kind"] == kind])
        upper, lower = panels[0, column], panels[1, column]
        _draw_treatments(upper, rows)
        _draw_gains(lower, rows)
        _head_panel(upper, CUT_KIND_NAMES[kind], CUT_KIND_NOTES[kind])
        upper.set_title(REWARD_AXIS, **PANEL_TITLE)
        lower.set_title(GAIN_AXIS, **PANEL_TITLE)
        lower.set_xlabel(PATHS_AXIS)
        upper.tick_params(labelbottom=True)
        mark_sizes(upper, results.design.num_paths)
        mark_sizes(lower, results.design.num_paths)
    handles, names = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="upper left", bbox_to_anchor=(0.05, top - 0.012), ncols=len(names), frameon=False)
    return figure


def _draw_learned(axes: Axes, results: StudyResults) -> list[EndLabel]:
    shares = results.design.cut_shares
    colours = matplotlib.colormaps[SHARE_COLOURS](np.linspace(0.0, LIGHTEST_SHARE, len(shares)))
    labels = []
    for k, (cut_share, colour) in enumerate(zip(shares, colours, strict=True)):
        curve = learned_curve(results.figure1, cut_share)
        _draw_curve(axes, curve, "mean_reward", "se", colour, k, k - (len(shares) - 1) / 2)
        end = learned(results.figure1, int(curve["num_paths"].max()), cut_share).mean
        cut = "no path cut" if cut_share == 0 else f"{share(cut_share)} of the paths cut"
        labels.append(EndLabel(end, f"learned, {cut}  {amount(end)}", colour))
    return labels


def _draw_baselines(axes: Axes, results: StudyResults) -> list[EndLabel]:
    labels = []
    for name in (name for name in results.figure1["policy"] if not name.startswith(LEARNED)):
        estimate, is_planner = baseline(results.figure1, name), name.startswith("pomdp")
        is_best = name in (results.best_planner, results.best_heuristic)
        colour = PLANNER_COLOUR if is_planner else HEURISTIC_COLOUR
        dashes = (0, (5, 1.5, 1, 1.5)) if is_planner else (0, (4, 2))
        axes.axhline(estimate.mean, color=colour, linestyle=dashes, linewidth=1.5 if is_best else 0.9, zorder=1.2)
        if is_best:
            axes.axhspan(estimate.low, estimate.high, color=colour, alpha=BAND_OPACITY, linewidth=0, zorder=1)
        labels.append(
            EndLabel(estimate.mean, f"{BASELINE_NAMES.get(name, name)}  {amount(estimate.mean)}", colour, is_best)
        )
    return labels


def _draw_treatments(axes: Axes, rows: pd.DataFrame) -> None:
    for k, treatment in enumerate(TREATMENTS):
        curve = _treatment_curve(rows, treatment)
        dodge = k - (len(TREATMENTS) - 1) / 2
        drawn = _draw_curve(axes, curve, "mean_reward", "se", TREATMENT_COLOURS[treatment], k, dodge)
        drawn.set(label=TREATMENT_NAMES[treatment], zorder=3 if treatment == WEIGHTED else 2.5)


def _draw_gains(axes: Axes, rows: pd.DataFrame) -> None:
    """Draw what weights add, with its 95 % intervals as bars: bands about 0 would hide one another."""
    axes.axhline(0.0, color=INK, linewidth=1.0, zorder=1.5)
    for k, treatment in enumerate(TREATMENTS[1:], start=1):
        curve = _treatment_curve(rows, treatment)
        axes.errorbar(
            curve["num_paths"].to_numpy(dtype=float) * BAR_DODGE ** (k - len(TREATMENTS) / 2),
            curve["behind_weighted"].to_numpy(dtype=float),
            Z_95 * curve["se_behind"].to_numpy(dtype=float),
            color=TREATMENT_COLOURS[treatment],
            marker=MARKERS[k],
            linewidth=0.8,
            elinewidth=1.6,
            capsize=2.5,
        )


def _treatment_curve(rows: pd.DataFrame, treatment: str) -> pd.DataFrame:
    return pd.DataFrame(rows[rows["treatment"] == treatment]).sort_values(by="num_paths")


def _draw_curve(axes: Axes, rows: pd.DataFrame, value: str, se: str, colour: Any, k: int, dodge: float) -> Any:
    """Draw a line with markers and its 95 % band; return the line."""
    num_paths = rows["num_paths"].to_numpy(dtype=float) * DODGE**dodge
    mean = rows[value].to_numpy(dtype=float)
    half = Z_95 * rows[se].to_numpy(dtype=float)
    axes.fill_between(num_paths, mean - half, mean + half, color=colour, alpha=BAND_OPACITY, linewidth=0, zorder=2)
    return axes.plot(num_paths, mean, color=colour, marker=MARKERS[k % len(MARKERS)], zorder=2.5)[0]


def mark_sizes(axes: Axes, num_paths: Sequence[int]) -> None:
    """Mark sizes of logs on a logarithmic axis."""
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator([float(size) for size in num_paths]))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(lambda size, _: f"{size:g}")
    axes.grid(axis="y", color=FAINT, linewidth=0.6, zorder=0)
    axes.set_axisbelow(True)


def _head_panel(axes: Axes, name: str, note: str) -> None:
    lines = ((f"{name[0].upper()}{name[1:]}", "bold", 45), (note, "normal", 31))
    for text, weight, height_points in lines:
        axes.annotate(
            text,
            (0.0, 1.0),
            xytext=(0.0, height_points),
            xycoords="axes fraction",
            textcoords="offset points",
            fontweight=weight,
        )


def write_title(figure: Figure, title: str, width: int) -> float:
    """Write the title in lines of even length; return the height of its lower end as a share of the figure's."""
    if not title:
        return 1.0
    num_lines = len(textwrap.wrap(title, width))
    balanced = next(narrow for narrow in range(1, width + 1) if len(textwrap.wrap(title, narrow)) <= num_lines)
    lines = textwrap.wrap(title, balanced)
    figure.text(0.012, TITLE_TOP, "\n".join(lines), fontsize=TITLE_POINTS, fontweight="bold", va="top", linespacing=1.3)
    return TITLE_TOP - len(lines) * 1.3 * TITLE_POINTS / 72 / figure.get_size_inches()[1]


def write_end_labels(axes: Axes, labels: Sequence[EndLabel]) -> None:
    """Name lines at the right edge, moved apart as little as needed and tied to their ends."""
    low, high = axes.get_ylim()
    height_inches = FIGURE1_INCHES[1] * axes.get_position().height
    heights = spread([label.reward for label in labels], LABEL_GAP_INCHES / height_inches * (high - low), low, high)
    for label, height in zip(labels, heights, strict=True):
        axes.plot(
            [1.005, 1.015, 1.045, 1.055],
            [label.reward, label.reward, height, height],
            transform=axes.get_yaxis_transform(),
            color=label.colour,
            linewidth=1.3,
            clip_on=False,
            solid_capstyle="butt",
        )
        axes.text(
            1.065,
            height,
            label.text,
            transform=axes.get_yaxis_transform(),
            va="center",
            fontsize=8.5,
            fontweight="bold" if label.is_bold else "normal",
        )
    axes.set_ylim(low, high)


def spread(heights: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """Move heights apart to at least `gap`, in their order and with the least sum of squared moves.

    Parameters
    ----------
    heights
        Where each would like to be.
    gap
        Smallest distance of neighbours.
    low, high
        Where all must lie, if there is room.
    """
    order = np.argsort(heights, kind="stable")
    steps = gap * np.arange(len(heights))
    lowered = isotonic_regression(np.asarray(heights, dtype=float)[order] - steps).x
    placed = np.empty(len(heights))
    placed[order] = np.clip(lowered, low, max(low, high - gap * (len(heights) - 1))) + steps
    return placed.tolist()


@contextmanager
def style() -> Iterator[None]:
    """Draw alike whatever the user's own style is, and leave that as it was."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        yield


def _drawn(figure_of: Callable[..., Figure], results: StudyResults, kind: str, metadata: dict[str, Any]) -> bytes:
    buffer = io.BytesIO()
    with style():
        figure = figure_of(results)
        FigureCanvasAgg(figure)
        figure.savefig(buffer, format=kind, dpi=DOTS_PER_INCH, metadata=metadata)
    return buffer.getvalue()


def write_figure(figure_of: Callable[..., Figure], results: StudyResults, folder: Path, name: str) -> None:
    """Write a figure as SVG and PNG.

    Parameters
    ----------
    figure_of
        Makes it from the results.
    results
        What the study found.
    folder
        Where to; made if it is not there.
    name
        Of the files, without a suffix.
    """
    write_whole(folder / f"{name}.svg", svg(figure_of, results))
    write_whole(folder / f"{name}.png", png(figure_of, results))


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that it appears whole or not at all.

    Parameters
    ----------
    path
        Where to; its folder is made if it is not there.
    content
        All of it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
