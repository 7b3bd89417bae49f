"""The positivity report as a figure: weights over time, and what bounding them would change."""

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from halfseen.censoring.positivity_facts import PositivityFacts, verdict
from halfseen.censoring.weights import FEWEST_EFFECTIVE

INK, FAINT, TAIL_COLOUR = "#222222", "#8a8a8a", "#f3e3d3"
# Okabe and Ito (2008).
WEIGHT_COLOUR, CUT_COLOUR = "#0072B2", "#D55E00"
CUT_INK = "#a84a00"
"""The same for letters, which need more contrast."""
SIZE_INCHES = (12.0, 4.2)
PANEL_INCHES, TALL_INCHES = (4.1, 3.25), (4.1, 6.75)
"""Of one panel alone; the weights over time have more to show."""
PANEL_TITLE_CHARS = 46


def draw(facts: PositivityFacts) -> Figure:
    """Draw three panels: weights over time, and against the bound the mean and the effective sample size."""
    figure = Figure(figsize=SIZE_INCHES, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(verdict(facts), x=0.01, ha="left", fontsize=11.5, fontweight="bold", color=INK)
    weights, mean, sizes = figure.subplots(1, 3, width_ratios=[1.5, 1.0, 1.0])
    _draw_weights(weights, facts)
    figure.legend(loc="outside lower left", ncols=4, fontsize=8.5, frameon=False)
    _draw_means(mean, facts)
    _draw_size(sizes, facts)
    _trim((weights, mean, sizes), 8.5)
    return figure


def draw_panel(facts: PositivityFacts, panel: str) -> Figure:
    """Draw one of the panels as a figure of its own, whose letters stay legible where it is narrow."""
    figure = Figure(figsize=TALL_INCHES if panel == "weights" else PANEL_INCHES, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    {"weights": _draw_weights, "means": _draw_means, "sizes": _draw_size}[panel](axes, facts, PANEL_TITLE_CHARS)
    if axes.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower left", ncols=1, fontsize=9.0, frameon=False)
    _trim((axes,), 9.0)
    return figure


def _trim(panels: Sequence[Axes], size: float) -> None:
    for axes in panels:
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=size)


def _draw_weights(axes: Axes, facts: PositivityFacts, title_chars: int = 66) -> None:
    """Draw each finish at its weight, and each cut below."""
    is_finite = np.isfinite(facts.weights)
    time_s, weight = facts.finish_s[is_finite], facts.weights[is_finite]
    if facts.num_finished:
        end_s = max(facts.identified_until_s, float(facts.finish_s.max()))
        if end_s > facts.tail_from_s:
            axes.axvspan(facts.tail_from_s, end_s, color=TAIL_COLOUR, lw=0, label="last quarter of the finishes")
        axes.plot(time_s, weight, "o", ms=4, mew=0, alpha=0.6, color=WEIGHT_COLOUR, label="finished, at its weight")
    if len(weight) and weight.max() > 10:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    # Below the smallest weight, which is 1, there is room for the cuts.
    low = 0.75
    if len(facts.cut_s):
        axes.plot(facts.cut_s, np.full(len(facts.cut_s), low), "|", ms=7, mew=0.8, color=CUT_COLOUR, label="cut")
    gone = facts.finish_s[~is_finite]
    if len(gone):
        top = axes.get_ylim()[1]
        axes.plot(gone, np.full(len(gone), top), "x", ms=6, color=INK, clip_on=False, label="finished, no weight")
    axes.axvline(facts.identified_until_s, color=INK, lw=1.0, ls=(0, (4, 3)))
    axes.margins(x=0.04, y=0.08)
    if len(weight) == 0 or weight.max() == 1:
        axes.set_ylim(0.7, 1.5)
    if facts.heaviest and facts.heaviest[0].weight > 1:
        heavy = facts.heaviest[0]
        is_late = heavy.time_s > np.mean(axes.get_xlim())
        axes.annotate(
            f"trajectory {heavy.trajectory}: {heavy.weight:.3g}",
            (heavy.time_s, heavy.weight),
            xytext=(-7 if is_late else 7, 0),
            textcoords="offset points",
            ha="right" if is_late else "left",
            va="center",
            fontsize=8.5,
        )
    axes.set_xlabel("time [s]; dashed: last time that anything is known of")
    axes.set_ylabel("weight, 1/Ĝ")
    _title(axes, _weights_title(facts), title_chars)


def _draw_means(axes: Axes, facts: PositivityFacts, title_chars: int = 40) -> None:
    rows = facts.truncations
    if not rows:
        _leave_empty(axes, "no trajectory finished")
        return
    bounds, means = _bounds(facts), [row.mean for row in rows]
    axes.axhline(means[0], color=FAINT, lw=0.9)
    axes.plot(bounds, means, "o-", ms=5, color=WEIGHT_COLOUR)
    _bound_axis(axes, bounds)
    axes.set_ylabel(f"weighted mean {facts.quantity}")
    first, last = rows[0].mean, rows[-1].mean
    if len(rows) == 1:
        _title(axes, f"All weigh the same, and put the mean at {first:.4g}", title_chars)
        return
    begin = "Unbounded weights" if rows[0].truncate_at is None else f"Weights up to {rows[0].truncate_at:g}"
    _title(axes, f"{begin} put the mean at {first:.4g}, equal weights at {last:.4g}", title_chars)


def _draw_size(axes: Axes, facts: PositivityFacts, title_chars: int = 42) -> None:
    rows = facts.truncations
    if not rows:
        _leave_empty(axes, "no trajectory finished")
        return
    bounds, sizes = _bounds(facts), [row.effective_sample_size for row in rows]
    axes.axhline(FEWEST_EFFECTIVE, color=CUT_COLOUR, lw=0.9)
    axes.plot(bounds, sizes, "o-", ms=5, color=WEIGHT_COLOUR)
    for bound, size, row in zip(bounds, sizes, rows, strict=True):
        if row.share_removed is None:
            continue
        removed = f"{row.share_removed:.0%}"
        axes.annotate(removed, (bound, size), xytext=(4, 4), textcoords="offset points", ha="left", fontsize=8.5)
    axes.set_ylim(0, 1.15 * max(*sizes, FEWEST_EFFECTIVE, facts.num_finished))
    axes.text(bounds[-1], FEWEST_EFFECTIVE, "below 10: too few", ha="left", va="bottom", fontsize=8.5, color=CUT_INK)
    _bound_axis(axes, bounds)
    axes.set_ylabel("effective sample size [trajectories]")
    shown = "Effective sample size of the finishes; in per cent, the weight that the bound takes away"
    _title(axes, shown, title_chars)


def _bounds(facts: PositivityFacts) -> list[float]:
    """Where on the axis each truncation stands: no bound stands at the largest weight, where it begins to bite."""
    largest = facts.heaviest[0].weight if facts.heaviest else 1.0
    return [largest if row.truncate_at is None else row.truncate_at for row in facts.truncations]


def _bound_axis(axes: Axes, bounds: list[float]) -> None:
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator(bounds))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.2g}" if value < 100 else f"{value:.0f}"))
    if len(bounds) > 1:
        axes.set_xlim(bounds[0] ** -0.07, bounds[0] ** 1.07)
    axes.set_xlabel("largest weight allowed (log scale)")


def _weights_title(facts: PositivityFacts) -> str:
    if not facts.heaviest:
        return f"{facts.num_trajectories} trajectories, of which none has a weight"
    shown = f"{facts.num_finished} of {facts.num_trajectories} trajectories finished"
    if facts.heaviest[0].weight == 1:
        return f"{shown}, and all weigh 1"
    mass = facts.weights[np.isfinite(facts.weights)]
    share = sum(heavy.weight for heavy in facts.heaviest) / mass.sum()
    few = "the heaviest" if len(facts.heaviest) == 1 else f"the heaviest {len(facts.heaviest)}"
    return f"{shown}; {few} carry {share:.0%} of the weight"


def _leave_empty(axes: Axes, why: str) -> None:
    axes.set_axis_off()
    axes.text(0.5, 0.5, why, ha="center", va="center", color=FAINT, transform=axes.transAxes)


def _title(axes: Axes, sentence: str, width: int) -> None:
    axes.set_title("\n".join(textwrap.wrap(sentence, width)), loc="left", fontsize=9.5, color=INK)
