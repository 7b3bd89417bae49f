"""Figure 8: scores against the Beta mean, calibration by occlusion, and success by occlusion."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from halfseen.figures import (
    FAINT,
    MARKERS,
    ORANGE,
    PANEL_TITLE,
    SKY,
    SOFT,
    WIDTH_INCHES,
    dodged,
    draw_bars,
    draw_curve,
    draw_grid,
    draw_zero,
    mark_sizes,
    named_curves,
    write_legend,
    write_title,
)
from halfseen.study.experiment import Tables
from halfseen.study.experiments.attempts.design import (
    BETA,
    COMPLETED,
    LAW,
    MEASURES,
    MODEL_COLOURS,
    MODEL_NAMES,
    RATE,
    SVM,
    SVM_FACTS,
    SVM_SET,
    WIDTH_WANTED,
)
from halfseen.study.experiments.attempts.occlusion import ASSUMED
from halfseen.study.frames import where
from halfseen.wording import percent

SIZES_AXIS = "tables that the model was learned from (log scale)"
UNITS = {"log_loss": " [nats]", "brier": ""}
DODGE, STEP, APART = 1.08, 0.16, 0.006
INTERVAL = ["share_held", "low", "high"]
POSES = {False: ("standing", SKY, "o"), True: ("lying", ORANGE, "s")}


def draw(tables: Tables, title: str) -> Figure:
    """Draw scores above, calibration and success below."""
    figure = Figure(figsize=(WIDTH_INCHES, 7.6))
    top = write_title(figure, title)
    grid = figure.add_gridspec(2, 2, left=0.075, right=0.985, bottom=0.085, top=top - 0.11, hspace=0.38, wspace=0.17)
    panels: Any = grid.subplots(squeeze=False)
    for axes, (measure, words) in zip(panels[0], MEASURES.items(), strict=True):
        _draw_scores(axes, tables["attempts_scores"], measure)
        axes.set_title(f"{words} at unseen tables, above the Beta mean’s{UNITS[measure]}", **PANEL_TITLE)
    _draw_calibration(panels[1, 0], tables["attempts_calibration"], (BETA, SVM, LAW))
    _draw_success(panels[1, 1], tables)
    known = named_curves(*panels[0], panels[1, 0])
    shown = {name: known[name] for name in MODEL_NAMES.values() if name in known}
    write_legend(figure, shown, top - 0.012, columnspacing=1.2, handletextpad=0.4)
    return figure


def _draw_scores(axes: Axes, scores: pd.DataFrame, measure: str) -> None:
    draw_zero(axes, MODEL_COLOURS[BETA])
    models = (RATE, SVM, SVM_FACTS, SVM_SET, LAW)
    columns = [f"{measure}_over_beta{end}" for end in ("", "_low", "_high")]
    for k, model in enumerate(models):
        rows = where(scores, model=model)
        draw_bars(axes, dodged(rows["num_tables"], k, len(models), DODGE), rows[columns], **_look(model))
    mark_sizes(axes, sorted(set(scores["num_tables"])))
    axes.set_xlabel(SIZES_AXIS)


def _draw_calibration(axes: Axes, calibration: pd.DataFrame, models: Sequence[str]) -> None:
    """Share that held less the predicted one, by bin of occlusion."""
    axes.axhspan(-WIDTH_WANTED, WIDTH_WANTED, color=FAINT, alpha=0.5, linewidth=0, zorder=0.5)
    draw_zero(axes)
    places = sorted(set(calibration.loc[calibration["by"] == "occlusion", "bin_from"]))
    for k, model in enumerate(models):
        rows = where(calibration, model=model, by="occlusion")
        across = np.searchsorted(places, rows["bin_from"]) + STEP * (k - (len(models) - 1) / 2)
        draw_bars(axes, across, rows[["difference", "low", "high"]], linestyle="none", **_look(model))
    told = where(calibration, model=models[0], by="occlusion")
    ends = zip(told["bin_from"], told["bin_to"], told["share_of_attempts"], strict=True)
    axes.set_xticks(range(len(places)), [f"{low:g}–{high:g}\n{percent(share)}" for low, high, share in ends])
    draw_grid(axes)
    axes.set_xlabel("hidden share of the object, and how many of the attempts")
    axes.set_title(f"share that held − predicted, at unseen tables; grey: ±{WIDTH_WANTED:g}", **PANEL_TITLE)


def _draw_success(axes: Axes, tables: Tables) -> None:
    """Share that held by what is hidden, counted and by the law, and as the assumed laws have it."""
    slope, held = tables["attempts_slope"], tables["attempts_held"]
    for side, (lies, (name, colour, marker)) in zip((-1, 1), POSES.items(), strict=True):
        curve = where(slope, law=COMPLETED, is_lying=lies)
        draw_curve(axes, curve["occlusion"], curve[INTERVAL], color=colour, linewidth=1.2)
        rows = where(held, planner=COMPLETED, is_lying=lies)
        look: Any = {"color": colour, "marker": marker, "linestyle": "none", "label": name}
        draw_bars(axes, rows["occlusion"] + side * APART, rows[INTERVAL], **look)
    assumed = where(slope, law=ASSUMED)
    axes.plot(
        assumed["occlusion"],
        assumed["share_held"],
        color=SOFT,
        dashes=(4, 2),
        linewidth=1.4,
        label="assumed laws",
    )
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, 0))
    draw_grid(axes)
    axes.legend(loc="lower left", frameon=False, fontsize=8.5)
    axes.set_xlim(-0.02, 0.84)
    axes.set_xlabel("hidden share of the object")
    axes.set_title("share of attempts that held: counted, and by the law (lines)", **PANEL_TITLE)


def _look(model: str) -> dict[str, Any]:
    marker = MARKERS[list(MODEL_COLOURS).index(model)]
    return {"color": MODEL_COLOURS[model], "marker": marker, "label": MODEL_NAMES[model]}
