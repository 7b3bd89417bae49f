"""The figure of regrets: how far below the exact optimum policies stay, against the size of the log."""

from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfseen.study.figures import (
    BAR_DODGE,
    FIGURE1_INCHES,
    HEURISTIC_COLOUR,
    INK,
    LIGHTEST_SHARE,
    MARKERS,
    PANEL_TITLE,
    PATHS_AXIS,
    PLANNER_COLOUR,
    SHARE_COLOURS,
    EndLabel,
    mark_sizes,
    write_end_labels,
    write_title,
)
from halfseen.study.findings import LEARNED, Z_95, learned_curve
from halfseen.study.policies import HEURISTICS
from halfseen.study.regret_table import OPTIMUM
from halfseen.study.regret_words import best, regret_title
from halfseen.study.results import BASELINE_NAMES, StudyResults
from halfseen.study.wording import amount, share

REGRET_AXIS = "reward of a path below that of the best of all policies, mean over the small tables"


def regret_figure_for(results: StudyResults, is_titled: bool = True) -> Figure:
    """`regret_figure_of` for the results of a study."""
    return regret_figure_of(results.regret, results.design.table_cut_share, is_titled)


def regret_figure_of(table: pd.DataFrame, cut_share: float, is_titled: bool = True) -> Figure:
    """Draw the figure of regrets, within `halfseen.study.figures.style`.

    Parameters
    ----------
    table
        Of `halfseen.study.regret_table.regret_table`.
    cut_share
        Of the learned policy that the title tells of.
    is_titled
        Whether the title is written above.
    """
    figure = Figure(figsize=FIGURE1_INCHES)
    top = write_title(figure, regret_title(table, cut_share) if is_titled else "", 92) - 0.08
    axes = figure.add_axes((0.07, 0.10, 0.60, top - 0.10))
    labels = _draw_baselines(axes, table) + _draw_learned(axes, table)
    sizes = sorted({int(size) for size in table["num_paths"].dropna()})
    mark_sizes(axes, sizes)
    axes.set_xlim(min(sizes) / 1.2, max(sizes) * 1.2)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel(PATHS_AXIS)
    axes.set_title(REGRET_AXIS, **PANEL_TITLE)
    write_end_labels(axes, labels)
    return figure


def _draw_learned(axes: Axes, table: pd.DataFrame) -> list[EndLabel]:
    shares = table["cut_share"].dropna().unique().astype(float)
    colours: Any = matplotlib.colormaps[SHARE_COLOURS](np.linspace(0.0, LIGHTEST_SHARE, len(shares)))
    labels = []
    for k, (cut_share, colour) in enumerate(zip(shares, colours, strict=True)):
        curve = learned_curve(table, float(cut_share))
        regret = curve["regret"].to_numpy(dtype=float)
        axes.errorbar(
            curve["num_paths"].to_numpy(dtype=float) * BAR_DODGE ** (0.5 * (k - (len(shares) - 1) / 2)),
            regret,
            Z_95 * curve["se"].to_numpy(dtype=float),
            color=colour,
            marker=MARKERS[k % len(MARKERS)],
            elinewidth=1.4,
            capsize=2.5,
            zorder=2.5,
        )
        cut = "no path cut" if cut_share == 0 else f"{share(float(cut_share))} of the paths cut"
        labels.append(EndLabel(float(regret[-1]), f"learned, {cut}  {amount(float(regret[-1]))}", colour))
    return labels


def _draw_baselines(axes: Axes, table: pd.DataFrame) -> list[EndLabel]:
    labels = []
    winners = best(table, is_planner=True), best(table, is_planner=False)
    for _, row in table[~table["policy"].isin([LEARNED, OPTIMUM])].iterrows():
        name, regret, is_best = str(row["policy"]), float(row["regret"]), row["policy"] in winners
        is_rule = name in HEURISTICS
        colour, dashes = (HEURISTIC_COLOUR, (4, 2)) if is_rule else (PLANNER_COLOUR, (5, 1.5, 1, 1.5))
        axes.axhline(regret, color=colour, linestyle=(0, dashes), linewidth=1.5 if is_best else 0.9, zorder=1.2)
        labels.append(EndLabel(regret, f"{BASELINE_NAMES.get(name, name)}  {amount(regret)}", colour, is_best))
    labels.append(EndLabel(0.0, f"the best of all policies  {amount(0.0)}", INK))
    return labels
