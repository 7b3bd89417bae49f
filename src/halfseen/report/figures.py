"""The figures of the page: values, how long paths were watched, what the policy would do, and Q along covariates."""

from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from halfseen.evaluation import Estimate, Evaluation
from halfseen.pages.axes import NARROW_INCHES, draw_grid
from halfseen.pages.numbers import with_interval
from halfseen.pages.palette import ALARM, FAINT, INK, LINES, OURS, SOFT, THEIRS
from halfseen.report.log_findings import FINISHED_ROW, Watched
from halfseen.report.opponents import gains_of, values_of
from halfseen.report.policy_findings import QCurve

BOUND_SPANS = 1.0
"""How far beyond the other intervals that of importance sampling is drawn, in their span."""
VERDICT_COLOURS = {"better": OURS, "not better": ALARM, "cannot be said": SOFT}
MOST_CHOICES, COLUMNS = 9, 3
MOST_CURVES, LEGEND_COLUMNS = len(LINES), 5


def draw_values(evaluation: Evaluation) -> Figure:
    """Draw the values above, and below them the differences with a line at 0."""
    theirs, gains = values_of(evaluation), gains_of(evaluation)
    figure = Figure(figsize=(NARROW_INCHES, 2.45 + 0.625 * (len(theirs) + len(gains))))
    values, gap = figure.subplots(2, 1, height_ratios=[3.0 + len(theirs), float(len(gains))])
    figure.subplots_adjust(left=0.235, right=0.70, top=0.98, bottom=0.14, hspace=0.62)
    rows = {
        **{fill(name, 18): (value, THEIRS, False) for name, value in theirs.items()},
        "learned, doubly robust": (evaluation.doubly_robust, OURS, True),
        "learned, importance\nsampling": (evaluation.importance_sampling, OURS, False),
        "learned, fitted Q": (evaluation.fitted_q, OURS, False),
    }
    core = [*theirs.values(), evaluation.doubly_robust, evaluation.fitted_q]
    _forest(values, rows, _limits(core, [evaluation.importance_sampling]))
    values.axvline(evaluation.logging.value, color=FAINT, lw=1.0, zorder=0)
    values.set_xlabel("mean reward of a path")
    told = {
        fill(name, 20): (gain, VERDICT_COLOURS[verdict], gain is evaluation.difference)
        for name, (gain, verdict) in gains.items()
    }
    _forest(gap, told, _limits([gain for gain, _ in gains.values()], []))
    gap.axvline(0.0, color=INK, lw=1.0, ls=(0, (4, 3)), zorder=0)
    gap.set_xlabel("gain: reward of the learned policy over the other's; dashed: no gain")
    return figure


def _limits(core: list[Estimate], others: list[Estimate]) -> tuple[float, float]:
    """Show all of `core`; of `others`, what lies near."""
    low, high = min(one.low for one in core), max(one.high for one in core)
    if not others:
        low, high = min(low, 0.0), max(high, 0.0)
    span = max(high - low, 1e-9 * max(1.0, abs(low), abs(high)))
    for one in others:
        low = max(min(low, one.low), low - BOUND_SPANS * span)
        high = min(max(high, one.high), high + BOUND_SPANS * span)
    pad = 0.06 * (high - low) or 0.5
    return low - pad, high + pad


def _forest(axes: Axes, rows: dict[str, tuple[Estimate, str, bool]], limits: tuple[float, float]) -> None:
    for place, (estimate, colour, is_bold) in enumerate(rows.values()):
        low, high = np.clip([estimate.low, estimate.high], *limits)
        axes.plot([low, high], [place, place], "-", color=colour, lw=3.2 if is_bold else 1.6, solid_capstyle="butt")
        for end, inside, marker in ((low, estimate.low < limits[0], "<"), (high, estimate.high > limits[1], ">")):
            if inside:
                axes.plot([end], [place], marker, color=colour, ms=6, clip_on=False)
        if limits[0] <= estimate.value <= limits[1]:
            axes.plot([estimate.value], [place], "o", color=colour, ms=8 if is_bold else 6)
        value, interval = with_interval(estimate.value, estimate.low, estimate.high)
        axes.annotate(
            f"{value}  ({interval})",
            (1.03, place),
            xycoords=("axes fraction", "data"),
            va="center",
            fontweight="bold" if is_bold else "normal",
            annotation_clip=False,
        )
    axes.set_yticks(range(len(rows)), list(rows))
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xlim(*limits)
    axes.xaxis.set_major_locator(MaxNLocator(5))


def draw_watched(watched: Watched) -> Figure:
    """Draw Ĝ, below it the ends of paths, and below these the numbers still watched."""
    num_rows = len(watched.ends_s)
    heights = [2.5, 0.24 * num_rows + 0.1]
    figure = Figure(figsize=(NARROW_INCHES, sum(heights) + 0.9))
    curve, ends = figure.subplots(2, 1, sharex=True, height_ratios=heights)
    figure.subplots_adjust(left=0.235, right=0.97, top=0.97, bottom=0.73 / (sum(heights) + 0.9), hspace=0.08)
    curve.step(watched.time_s, watched.survival, where="post", color=OURS)
    curve.set_ylim(0.0, 1.04)
    curve.set_ylabel("Ĝ: probability that a path\nhas not been cut so far")
    draw_grid(curve)
    curve.tick_params(axis="x", length=0, labelbottom=False)
    for place, (name, ends_s) in enumerate(watched.ends_s.items()):
        colour = INK if name == FINISHED_ROW else LINES[1:][(place - 1) % (len(LINES) - 1)]
        ends.plot(ends_s, np.full(len(ends_s), place), "|", ms=9, mew=0.9, alpha=0.7, color=colour)
    names = [f"{name} ({len(ends_s)})" for name, ends_s in watched.ends_s.items()]
    ends.set_yticks(range(num_rows), names)
    ends.tick_params(axis="y", length=0)
    ends.set_ylim(num_rows - 0.4, -0.6)
    ends.set_xlim(0.0, 1.01 * watched.time_s[-1])
    ends.set_xticks(watched.risk_time_s.tolist())
    ends.set_xlabel("time since the path began [s]", labelpad=20)
    _write_numbers(ends, watched)
    return figure


def _write_numbers(axes: Axes, watched: Watched) -> None:
    place: Any = {"xytext": (0, -21), "textcoords": "offset points", "va": "top", "color": OURS, "fontsize": 9}
    for time_s, count in zip(watched.risk_time_s, watched.num_watched, strict=True):
        axes.annotate(f"{count:,}", (float(time_s), 0), xycoords=("data", "axes fraction"), ha="center", **place)
    axes.annotate("still watched", (-0.05, 0), xycoords="axes fraction", ha="right", **place)


def drawn_actions(choices: list[dict[str, Any]]) -> list[str]:
    """Name the actions that have a panel: those that the policy or the log takes most."""
    total = {
        name: sum(row["num_states"] * max(row["policy"][name], row["logged"][name] or 0.0) for row in choices)
        for name in choices[0]["policy"]
    }
    kept = sorted(total, key=lambda name: -total[name])[:MOST_CHOICES]
    return [name for name in total if name in kept]


def draw_choices(choices: list[dict[str, Any]]) -> Figure:
    """Draw a panel for each action: the proportion of the states of each stage in which it is taken."""
    names = drawn_actions(choices)
    columns = min(COLUMNS, len(names))
    rows = -(-len(names) // columns)
    height = 2.0 * rows + 0.75
    figure = Figure(figsize=(NARROW_INCHES, height))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    figure.subplots_adjust(
        left=0.105, right=0.985, top=1 - 0.58 / height, bottom=0.5 / height, hspace=0.32, wspace=0.12
    )
    stage = np.array([row["stage"] for row in choices])
    for axes, name in zip(panels.flat, names, strict=False):
        for who, colour, marker, label in (
            ("logged", THEIRS, "s", "what was done"),
            ("policy", OURS, "o", "what the policy would do"),
        ):
            share = np.array([np.nan if row[who][name] is None else row[who][name] for row in choices], dtype=float)
            axes.plot(stage, share, f"{marker}-", color=colour, ms=5, lw=1.4, label=label, clip_on=False, zorder=3)
        axes.set_title(name, loc="left", fontsize=9.5, fontweight="bold")
        draw_grid(axes)
        axes.set_ylim(0.0, 1.0)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    panels[0, 0].set_xlim(stage[0] - 0.5, stage[-1] + 0.5)
    for axes in panels.flat[len(names) :]:
        axes.set_axis_off()
    for column in range(columns):
        last = max(k for k in range(rows) if k * columns + column < len(names))
        panels[last, column].set_xlabel("stage")
        panels[last, column].tick_params(labelbottom=True)
    for axes in panels[:, 0]:
        axes.set_ylabel("proportion of the states")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", ncols=2, frameon=False, fontsize=9.5)
    return figure


def draw_curves(curves: list[QCurve]) -> Figure:
    """Draw Q along each covariate, others at their medians, with a band where there is one."""
    stages = sorted({curve.stage for curve in curves})
    names = list(dict.fromkeys(curve.covariate for curve in curves))
    actions = list(dict.fromkeys(name for curve in curves for name in curve.q))[:MOST_CURVES]
    colour = dict(zip(actions, LINES, strict=False))
    legend = 0.24 * -(-len(actions) // LEGEND_COLUMNS)
    height = 2.1 * len(stages) + 0.61 + legend
    figure = Figure(figsize=(NARROW_INCHES, height))
    panels = figure.subplots(len(stages), len(names), sharex="col", sharey="row", squeeze=False)
    figure.subplots_adjust(
        left=0.1, right=0.985, top=1 - (legend + 0.18) / height, bottom=0.52 / height, hspace=0.18, wspace=0.1
    )
    for curve in curves:
        axes = panels[stages.index(curve.stage), names.index(curve.covariate)]
        for action, q in curve.q.items():
            if action not in colour:
                continue
            axes.plot(curve.values, q, color=colour[action], lw=1.6)
            if curve.low is not None and curve.high is not None:
                low, high = curve.low[action], curve.high[action]
                axes.fill_between(curve.values, low, high, color=colour[action], alpha=0.14, lw=0)
        axes.xaxis.set_major_locator(MaxNLocator(4))
    for row, stage in zip(panels, stages, strict=True):
        row[0].set_ylabel(f"stage {stage}: Q [reward]")
    for axes, name in zip(panels[-1], names, strict=True):
        axes.set_xlabel(name)
    handles = [panels[0, 0].plot([], [], color=colour[action], label=action)[0] for action in actions]
    figure.legend(handles, actions, loc="upper left", ncols=LEGEND_COLUMNS, frameon=False, fontsize=9.5)
    return figure
