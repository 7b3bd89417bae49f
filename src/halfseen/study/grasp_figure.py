"""Figure 5: what a grasp estimate is worth, as differences from the true model."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfseen.study.figures import (
    BAND_OPACITY,
    BAR_DODGE,
    FAINT,
    INK,
    MARKERS,
    PANEL_TITLE,
    mark_sizes,
    write_title,
)
from halfseen.study.findings import Z_95
from halfseen.study.grasp_words import figure5_title
from halfseen.study.results import GRASP_NAMES, StudyResults
from halfseen.study.wording import amount

FIGURE5_INCHES = (9.0, 7.6)
# Okabe and Ito (2008).
GRASP_COLOURS = {
    "laplace": "#8a8a8a",
    "beta": "#0072B2",
    "beta-dropped": "#56B4E9",
    "svm": "#D55E00",
    "oracle": INK,
}
FEWEST_SHOWN = 100
"""Attempts below which a bin of predicted chances is not drawn."""
SIZES_AXIS = "logged paths that the estimate was learned from (log scale)"
CHANCE_AXIS = "predicted chance of a grasp"
_LEARNED = ("beta", "beta-dropped", "svm")


def figure5_of(results: StudyResults, is_titled: bool = True) -> Figure:
    """Figure 5, to be made and drawn within `halfseen.study.figures.style`."""
    figure = Figure(figsize=FIGURE5_INCHES)
    top = write_title(figure, figure5_title(results.grasp_tests) if is_titled else "", 92)
    grid = figure.add_gridspec(2, 2, left=0.07, right=0.985, bottom=0.07, top=top - 0.11, hspace=0.36, wspace=0.18)
    panels: Any = grid.subplots(squeeze=False)
    _draw_scores(panels[0, 0], results)
    _draw_calibration(panels[0, 1], results)
    _draw_rewards(panels[1, 0], results, "learned_reward", "reward of the learned policy, over the true model's")
    _draw_rewards(panels[1, 1], results, "heuristic_reward", "reward of the heuristic, over the true model's")
    handles, names = panels[0, 1].get_legend_handles_labels()
    more = panels[1, 0].get_legend_handles_labels()
    known = dict(zip(more[1] + names, more[0] + handles, strict=True))
    shown = [name for name in GRASP_NAMES.values() if name in known]
    figure.legend(
        [known[name] for name in shown],
        shown,
        loc="upper left",
        bbox_to_anchor=(0.05, top - 0.012),
        ncols=len(shown),
        frameon=False,
        columnspacing=1.4,
    )
    return figure


def _draw_scores(axes: Axes, results: StudyResults) -> None:
    _draw_differences(axes, results, "log_loss", _LEARNED)
    axes.set_title("log-loss on held-out attempts, above the true model's", **PANEL_TITLE)
    laplace = np.asarray(results.grasp.loc[results.grasp["model"] == "laplace", "log_loss_over_oracle"])
    note = f"Laplace's rule, which looks at no occlusion, lies {amount(float(laplace[0]))} above"
    axes.annotate(
        note, (0.98, 0.96), xycoords="axes fraction", ha="right", va="top", color=GRASP_COLOURS["laplace"], fontsize=8.0
    )
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.12 * (high - low))


def _draw_rewards(axes: Axes, results: StudyResults, measure: str, title: str) -> None:
    _draw_differences(axes, results, measure, ("laplace", *_LEARNED))
    axes.set_title(title, **PANEL_TITLE)


def _draw_differences(axes: Axes, results: StudyResults, measure: str, models: tuple[str, ...]) -> None:
    """Draw paired differences from the true model with 95 % intervals."""
    axes.axhline(0.0, color=GRASP_COLOURS["oracle"], linewidth=1.0, zorder=1.5)
    for k, model in enumerate(models):
        rows = pd.DataFrame(results.grasp[results.grasp["model"] == model]).sort_values(by="num_paths")
        axes.errorbar(
            rows["num_paths"].to_numpy(dtype=float) * BAR_DODGE ** (k - (len(models) - 1) / 2),
            rows[f"{measure}_over_oracle"].to_numpy(dtype=float),
            Z_95 * rows[f"{measure}_over_oracle_se"].to_numpy(dtype=float),
            color=GRASP_COLOURS[model],
            marker=_marker(model),
            linewidth=0.8,
            elinewidth=1.6,
            capsize=2.5,
            label=GRASP_NAMES[model],
        )
    mark_sizes(axes, results.design.grasp_num_paths)
    axes.set_xlabel(SIZES_AXIS)


def _draw_calibration(axes: Axes, results: StudyResults) -> None:
    """Draw how much oftener attempts succeeded than predicted, with 95 % bands, for the largest log."""
    largest = max(results.design.grasp_num_paths)
    rows = results.figure5
    axes.axhline(0.0, color=INK, linewidth=1.0, zorder=1.5)
    for model in (*_LEARNED, "oracle"):
        is_shown = (rows["model"] == model) & (rows["num_paths"] == largest) & (rows["attempts"] >= FEWEST_SHOWN)
        drawn = pd.DataFrame(rows[is_shown]).sort_values(by="mean_chance")
        chance = drawn["mean_chance"].to_numpy(dtype=float)
        surplus = drawn["share_succeeded"].to_numpy(dtype=float) - chance
        half = Z_95 * drawn["se"].to_numpy(dtype=float)
        colour = GRASP_COLOURS[model]
        axes.fill_between(chance, surplus - half, surplus + half, color=colour, alpha=BAND_OPACITY, linewidth=0)
        axes.plot(chance, surplus, color=colour, marker=_marker(model), linewidth=1.2, label=GRASP_NAMES[model])
    axes.set_xlim(0.0, 1.0)
    axes.set_xticks(np.linspace(0.0, 1.0, 6))
    axes.grid(axis="y", color=FAINT, linewidth=0.6, zorder=0)
    axes.set_axisbelow(True)
    axes.set_xlabel(CHANCE_AXIS)
    axes.set_title(f"share that succeeded, less that chance ({largest} paths)", **PANEL_TITLE)


def _marker(model: str) -> str:
    return MARKERS[list(GRASP_COLOURS).index(model)]
