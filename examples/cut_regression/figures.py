"""Figures: fitted curves over the data with cut rows marked, and the error in each repetition."""

import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from cut_regression.comparison import GRID, Comparison
from cut_regression.methods import CONSTANT, METHODS
from cut_regression.settings import TAU, Setting

DOTS_PER_INCH = 140
NUM_PALETTE_COLOURS = 200
INK = "#222222"
FAINT = "#d9d9d9"
# Okabe and Ito (2008).
COLOURS = {
    "kaplan-meier": "#0072B2",
    "cox": "#56B4E9",
    "kernel": "#009E73",
    "true": "#555555",
    "uncut": "#D55E00",
    "cox-times": "#CC79A7",
}
LABELS = {
    "kaplan-meier": "SVM, Ĝ: Kaplan–Meier",
    "cox": "SVM, Ĝ: Cox",
    "kernel": "SVM, Ĝ: kernel Kaplan–Meier",
    "true": "SVM, Ĝ: the truth",
    "uncut": "SVM, uncut rows only",
    "cox-times": "Cox's model of the times",
}
MARKERS = dict(zip(METHODS, "os^vDP", strict=True))
SEEN_COLOUR = "#9a9a9a"
NOTE_COLOUR = "#666666"
NUM_DOTS = 120
TITLE_POINTS = 11.5
PANEL_TITLE: dict[str, Any] = {"loc": "left", "fontsize": 9.0, "pad": 8.0}
STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.8,
    "lines.markersize": 4.5,
}
ERROR_AXIS = "|estimate − true median| [s]"
COVARIATE_AXIS = "covariate z1"


def write_png(draw: Callable[[Comparison], Figure], comparison: Comparison, path: Path) -> None:
    """Draw and write a figure; the same numbers give the same bytes.

    Parameters
    ----------
    draw
        Makes the figure.
    comparison
        What was found.
    path
        Where to; its folder is made if it is not there.
    """
    with matplotlib.rc_context():
        # Whatever the user's own style is.
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        figure = draw(comparison)
        figure.set_dpi(DOTS_PER_INCH)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
    path.parent.mkdir(parents=True, exist_ok=True)
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    # The colours are flat: a palette holds them in a fraction of the bytes.
    picture.quantize(NUM_PALETTE_COLOURS).save(path, format="png", optimize=True)


def panels(title: str, note: str, num_rows: int, num_columns: int, is_with_curves: bool) -> tuple[Figure, Any]:
    """Set up a figure with its title, legend and note.

    Parameters
    ----------
    title
        What is seen, in a sentence.
    note
        How to read it, below the panels.
    num_rows, num_columns
        Of panels.
    is_with_curves
        Whether the legend explains data and truth.
    """
    # Lines of about one length, so that none is left with a word.
    lines = textwrap.wrap(title, len(title) // (len(title) // 104 + 1) + 8)
    head = 0.35 + 0.21 * len(lines) + 0.19 * 2
    height = head + 2.75 * num_rows + 0.2
    figure = Figure(figsize=(9.0, height))
    figure.text(0.012, 1 - 0.12 / height, "\n".join(lines), va="top", fontsize=TITLE_POINTS, linespacing=1.25)
    figure.text(0.012, 0.08 / height, note, va="bottom", fontsize=7.5, color=NOTE_COLOUR)
    figure.legend(
        handles=_legend(is_with_curves),
        loc="upper left",
        bbox_to_anchor=(0.004, 1 - (0.14 + 0.21 * len(lines)) / height),
        ncols=5 if is_with_curves else 3,
        frameon=False,
        fontsize=8.5,
        columnspacing=1.4,
    )
    grid = figure.add_gridspec(
        num_rows,
        num_columns,
        left=0.06,
        right=0.985,
        bottom=0.68 / height,
        top=1 - (head + 0.25) / height,
        wspace=0.16,
        hspace=0.40,
    )
    return figure, grid.subplots(squeeze=False)


def draw_curves(axes: Axes, comparison: Comparison, setting: Setting, methods: Sequence[str]) -> None:
    """Draw one sample, the true median and the mean curves of some methods.

    Parameters
    ----------
    axes
        Where.
    comparison
        What was found.
    setting
        Of one covariate.
    methods
        Whose curves.
    """
    sample = comparison.samples[setting]
    z, time, seen = (part[:NUM_DOTS] for part in (sample.covariates[:, 0], sample.time, sample.is_finished))
    axes.scatter(z[seen], time[seen], s=9, color=SEEN_COLOUR, linewidth=0, zorder=1)
    axes.scatter(z[~seen], time[~seen], s=14, color=SEEN_COLOUR, marker="x", linewidth=0.8, zorder=1)
    axes.plot(GRID, setting.medians(GRID[:, None]), color=INK, linewidth=2.4, zorder=2)
    for method in methods:
        axes.plot(GRID, comparison.curves[setting, method], color=COLOURS[method], zorder=3)
    axes.axhline(TAU, color=FAINT, linewidth=1.0, zorder=0.5)
    axes.text(0.99, TAU, f"τ = {TAU:g} s", ha="right", va="bottom", fontsize=7.5, color=SEEN_COLOUR)
    axes.set(xlim=(0, 1), ylim=(0, 1.35 * TAU), xlabel=COVARIATE_AXIS, ylabel="time [s]")


def draw_errors(axes: Axes, comparison: Comparison, groups: Sequence[tuple[str, Setting, int]]) -> None:
    """Draw a dot for each sample and method and a bar at their mean, side by side within each group.

    Parameters
    ----------
    axes
        Where.
    comparison
        What was found.
    groups
        Label, setting and number of rows of each group.
    """
    offsets = np.linspace(-0.36, 0.36, len(METHODS))
    for x, (_, setting, size) in enumerate(groups):
        constant = comparison.errors_of(setting, size, CONSTANT).mean()
        axes.plot([x - 0.45, x + 0.45], [constant] * 2, color=SEEN_COLOUR, linewidth=1.0, linestyle=(0, (4, 2)))
        for middle, method in zip(x + offsets, METHODS, strict=True):
            errors = comparison.errors_of(setting, size, method)
            where = middle + (np.linspace(-0.035, 0.035, len(errors)) if len(errors) > 1 else np.zeros(1))
            look: Any = {"color": COLOURS[method], "marker": MARKERS[method], "alpha": 0.45, "linewidth": 0}
            axes.scatter(where, errors, s=9, zorder=2, **look)
            axes.plot(
                [middle - 0.06, middle + 0.06], [errors.mean()] * 2, color=COLOURS[method], linewidth=2.6, zorder=3
            )
    axes.set_xticks(range(len(groups)), [label for label, _, _ in groups])
    axes.tick_params(axis="x", length=0)
    axes.set(xlim=(-0.5, len(groups) - 0.5), ylim=(0, 1.05 * comparison.errors["error_s"].max()))
    axes.set_ylabel(ERROR_AXIS)


def _legend(is_with_curves: bool) -> list[Line2D]:
    names = [
        Line2D([], [], color=COLOURS[method], marker=MARKERS[method], linewidth=1.8, label=name)
        for method, name in LABELS.items()
    ]
    if not is_with_curves:
        return names
    return [
        *names,
        Line2D([], [], color=INK, linewidth=2.4, label="true median"),
        Line2D([], [], color=SEEN_COLOUR, marker="o", linestyle="", markersize=3.5, label="row seen to its end"),
        Line2D([], [], color=SEEN_COLOUR, marker="x", linestyle="", markersize=4, label="row cut"),
    ]
