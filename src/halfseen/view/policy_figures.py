"""Figures of a policy: its value, its actions in the states of a log, the values of actions, and maps."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import LinearSegmentedColormap, ListedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter, ScalarFormatter

from halfseen import figures
from halfseen.evaluation import Estimate, Evaluation
from halfseen.figures import INK, NARROW_INCHES, OURS, draw_grid, fitted, legend_columns
from halfseen.view.log_figures import LEGEND_INCHES, OTHERS_COLOUR
from halfseen.view.policy_findings import PolicyMap, QCurve, TableMap
from halfseen.view.words import gains_of, values_of
from halfseen.wording import SUPERSCRIPTS, labelled, with_interval

BOUND_SPANS = 1.0  # how far beyond the other intervals that of importance sampling is drawn, in their spans
VERDICT_COLOURS = {"better": OURS, "not better": figures.ALARM, "inconclusive": figures.SOFT}

MOST_CHOICES = 9
NUM_COLUMNS = {1: 1, 2: 2, 3: 3, 4: 2, 5: 3, 6: 3, 7: 4, 8: 4, 9: 3}
"""Number of columns by number of panels: at most one cell is left over, which the legend takes."""
FEW_STATES = 20  # with fewer states, markers are hollow and lines thin
LARGEST, SMALLEST = 90.0, 7.0  # areas of markers [pt²]
MOST_TICKS = 8
NUMBERS_INCHES = 2.1  # width beside the intervals, for what they say
PLAIN_POWERS = (-3, 5)  # of ten: ticks of these need no power beside them
LEGEND_COLUMNS = 5

MAP_WIDTH_INCHES, MAP_INCHES = 3.1, 3.2
STRIP_WIDTH_INCHES, STRIP_INCHES, ROW_INCHES = 4.6, 1.15, 0.26
TINT = 0.42  # of a colour in an area; the rest is white, so that dots of the same colour stand out
PANEL_NAME: Any = {"loc": "left", "fontsize": 10, "fontweight": "bold", "color": INK}
DEEPENING = LinearSegmentedColormap.from_list("deepening", ["#f2f6fa", OURS, "#002c46"])

Rows = list[dict[str, Any]]


def draw_values(evaluation: Evaluation) -> Figure:
    """Draw the values of the policies, and below them the differences with a line at 0."""
    theirs, gains = values_of(evaluation), gains_of(evaluation)
    # Names of differences take up to three lines.
    figure = Figure(figsize=(NARROW_INCHES, 2.45 + 0.625 * len(theirs) + 0.85 * len(gains)))
    values, gap = figure.subplots(2, 1, height_ratios=[3.0 + len(theirs), 1.4 * len(gains)])
    figure.subplots_adjust(left=0.235, right=0.685, top=0.98, bottom=0.14, hspace=0.62)
    rows = {
        **{fitted(name, 1.6, most_lines=3): (value, figures.THEIRS, False) for name, value in theirs.items()},
        "learned, doubly robust": (evaluation.doubly_robust, OURS, True),
        "learned, importance\nsampling": (evaluation.importance_sampling, OURS, False),
        "learned, fitted Q": (evaluation.fitted_q, OURS, False),
    }
    core = [*theirs.values(), evaluation.doubly_robust, evaluation.fitted_q]
    _forest(values, rows, _limits(core, [evaluation.importance_sampling]))
    values.axvline(evaluation.logging.value, color=figures.FAINT, lw=1.0, zorder=0)
    _name_axis(values.xaxis, "mean reward of a trajectory", evaluation.reward_unit)
    differences = {
        fitted(name, 1.6, most_lines=3): (gain, VERDICT_COLOURS[verdict], gain is evaluation.difference)
        for name, (gain, verdict) in gains.items()
    }
    _forest(gap, differences, _limits([gain for gain, _ in gains.values()], []))
    gap.axvline(0.0, color=INK, lw=1.0, ls=(0, (4, 3)), zorder=0)
    _name_axis(gap.xaxis, "gain over the other policy (dashed: none)", evaluation.reward_unit)
    return figure


def _limits(core: list[Estimate], others: list[Estimate]) -> tuple[float, float]:
    """Show all of `core`, and of `others` the nearby part."""
    low, high = min(one.low for one in core), max(one.high for one in core)
    if not others:
        low, high = min(low, 0.0), max(high, 0.0)
    span = max(high - low, 1e-9 * max(1.0, abs(low), abs(high)))
    for one in others:
        low = max(min(low, one.low), low - BOUND_SPANS * span)
        high = min(max(high, one.high), high + BOUND_SPANS * span)
    pad = 0.06 * (high - low) or 0.5
    return low - pad, high + pad


def _name_axis(axis: Axis, quantity: str, unit: str | None, inches: float = math.inf) -> None:
    """Name a quantity and its unit beside an axis; the power of ten of large and small ticks goes to the unit."""
    largest = float(np.abs(axis.get_view_interval()).max())
    power = math.floor(math.log10(largest)) if largest > 0 else 0
    axis.set_major_formatter(ScalarFormatter(useOffset=False))
    if not PLAIN_POWERS[0] <= power < PLAIN_POWERS[1]:
        axis.set_major_formatter(lambda value, _: f"{value / 10.0**power:.4g}".replace("-", "−"))
        unit = " ".join([f"10{str(power).translate(SUPERSCRIPTS)}", *([unit] if unit else [])])
    name = labelled(quantity, unit)
    axis.set_label_text(name if inches == math.inf else fitted(name, inches))


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
        whole = f"{value}  ({interval})"
        axes.annotate(
            f"{value}\n({interval})" if "\n" in fitted(whole, NUMBERS_INCHES, weight="bold") else whole,
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


def drawn_actions(choices: Rows) -> list[str]:
    """Name the actions that have a panel: the most frequent of those that the policy or the log takes."""
    total = {
        name: sum(row["num_states"] * max(row["policy"][name], row["logged"][name] or 0.0) for row in choices)
        for name in choices[0]["policy"]
    }
    kept = sorted((name for name in total if total[name] > 0), key=lambda name: -total[name])[:MOST_CHOICES]
    return [name for name in total if name in kept]


def draw_choices(choices: Rows) -> Figure:
    """Draw a panel for each action: the proportion of the states of each stage in which it is taken."""
    names = drawn_actions(choices)
    columns = NUM_COLUMNS[len(names)]
    titles = [fitted(name, 0.85 * NARROW_INCHES / columns, weight="bold") for name in names]
    rows, more = -(-len(names) // columns), 0.17 * any("\n" in title for title in titles)
    is_full = rows * columns == len(names)
    head = (0.58 if is_full else 0.28) + more
    height = (2.2 + more) * rows + head + 0.35
    figure = Figure(figsize=(NARROW_INCHES, height))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    figure.subplots_adjust(
        left=0.105, right=0.985, top=1 - head / height, bottom=0.68 / height, hspace=0.36 + 0.6 * more, wspace=0.12
    )
    for axes, name, title in zip(panels.flat, names, titles, strict=False):
        _draw_action(axes, choices, name)
        axes.set_title(title, loc="left", fontsize=9.5, fontweight="bold")
    _mark_stages(panels, choices, len(names))
    for axes in panels[:, 0]:
        axes.set_ylabel("proportion of the states")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    if is_full:
        figure.legend(handles, labels, loc="upper left", ncols=2, frameon=False)
    else:
        panels.flat[-1].set_axis_off()
        panels.flat[-1].legend(handles, labels, loc="center left", frameon=False)
    return figure


def _draw_action(axes: Axes, choices: Rows, name: str) -> None:
    stage, count = np.array([(row["stage"], row["num_states"]) for row in choices], dtype=float).T
    area = np.maximum(LARGEST * count / count.max(), SMALLEST)
    many = count >= FEW_STATES
    place: Any = {"linewidths": 1.2, "clip_on": False, "zorder": 3}
    whose = ("logged", figures.THEIRS, "s", "what was done"), ("policy", OURS, "o", "the policy")
    for who, colour, marker, label in whose:
        share = np.array([np.nan if row[who][name] is None else row[who][name] for row in choices], dtype=float)
        for ends in pairwise(range(len(stage))):
            at = list(ends)
            width = 1.5 if many[at].all() else 0.6
            axes.plot(stage[at], share[at], "-", color=colour, lw=width, clip_on=False, zorder=2.5)
        face = [colour if each else "white" for each in many]
        axes.scatter(stage, share, s=area.tolist(), c=face, marker=marker, edgecolors=colour, **place)
        axes.plot([], [], f"{marker}-", color=colour, ms=6, lw=1.4, label=label)
    draw_grid(axes)
    axes.set_ylim(0.0, 1.0)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))


def _mark_stages(panels: Any, choices: Rows, num_panels: int) -> None:
    """Write the number of states below each stage, under the lowest panel of each column."""
    count = {row["stage"]: row["num_states"] for row in choices}
    stages = list(count)
    shown = MaxNLocator(MOST_TICKS, integer=True, min_n_ticks=1).tick_values(stages[0], stages[-1])
    ticks = stages if len(stages) <= MOST_TICKS else [int(stage) for stage in shown if stage in count]
    states = [f"{count[stage]}" if count[stage] < 10_000 else f"{count[stage] / 1000:.0f}k" for stage in ticks]
    panels[0, 0].set_xlim(stages[0] - 0.5, stages[-1] + 0.5)
    panels[0, 0].set_xticks(ticks, [f"{stage}\n({num})" for stage, num in zip(ticks, states, strict=True)])
    num_columns = panels.shape[1]
    for axes in panels.flat[max(num_panels - num_columns, 0) : num_panels]:
        axes.set_xlabel("stage (states)")
        axes.tick_params(labelbottom=True)


def draw_curves(curves: list[QCurve], colours: dict[str, str], unit: str | None = None) -> Figure:
    """Draw Q along each covariate, with the others at their medians and a band if there is one."""
    stages = sorted({curve.stage for curve in curves})
    names = list(dict.fromkeys(curve.covariate for curve in curves))
    valued = {name for curve in curves for name in curve.q}
    actions = [name for name in colours if name in valued]
    labels = [fitted(name, LEGEND_INCHES - figures.LEGEND_ENTRY_INCHES, most_lines=1) for name in actions]
    columns = legend_columns(labels, LEGEND_INCHES, LEGEND_COLUMNS)
    legend = 0.24 * -(-len(actions) // columns)
    height = 2.1 * len(stages) + 0.61 + legend
    figure = Figure(figsize=(NARROW_INCHES, height))
    panels = figure.subplots(len(stages), len(names), sharex="col", sharey="row", squeeze=False)
    figure.subplots_adjust(
        left=0.12, right=0.985, top=1 - (legend + 0.18) / height, bottom=0.52 / height, hspace=0.18, wspace=0.1
    )
    for curve in curves:
        axes = panels[stages.index(curve.stage), names.index(curve.covariate)]
        for action in (action for action in curve.q if action in actions):
            axes.plot(curve.values, curve.q[action], color=colours[action], lw=1.6)
            if curve.low is not None and curve.high is not None:
                low, high = curve.low[action], curve.high[action]
                axes.fill_between(curve.values, low, high, color=colours[action], alpha=0.14, lw=0)
        axes.xaxis.set_major_locator(MaxNLocator(4))
    for row, stage in zip(panels, stages, strict=True):
        _name_axis(row[0].yaxis, f"stage {stage}: Q", unit or "reward", 1.7)
    for axes, name in zip(panels[-1], names, strict=True):
        axes.set_xlabel(fitted(name, 0.85 * NARROW_INCHES / len(names), most_lines=1))
    handles = [panels[0, 0].plot([], [], color=colours[action])[0] for action in actions]
    figure.legend(handles, labels, loc="upper left", ncols=columns, frameon=False, fontsize=9.5)
    return figure


def draw_map(shown: PolicyMap, colours: dict[str, str]) -> Figure:
    """Draw the policy's actions in one stage, hatched where the log has few states; dots are the logged actions.

    Two covariates give a map; one gives a strip, above a row of dots for each action.
    """
    done = set(shown.done)
    rows = [name for name in (*colours, *(one for one in shown.names if one not in colours)) if name in done]
    is_map = shown.up is not None
    height = MAP_INCHES if is_map else STRIP_INCHES + ROW_INCHES * len(rows)
    width, left = (MAP_WIDTH_INCHES, 0.62) if is_map else (STRIP_WIDTH_INCHES, 1.24)
    figure = Figure(figsize=(width, height))
    axes = figure.add_axes((left / width, 0.5 / height, 0.965 - left / width, 1.0 - 0.82 / height))
    up = (-1.6, -0.6) if shown.up is None else (float(shown.up[0]), float(shown.up[-1]))
    _draw_areas(axes, shown, colours, up)
    for name in shown.names if is_map else rows:
        dots = shown.dots[shown.done == name]
        heights = dots[:, 1] if is_map else np.full(len(dots), float(rows.index(name)))
        colour = colours.get(name, OTHERS_COLOUR)
        axes.plot(dots[:, 0], heights, "o", color=colour, ms=4.2, mec="white", mew=0.5, zorder=3)
    if is_map:
        axes.set_ylim(*up)
        axes.set_ylabel(fitted(shown.covariates[1], 0.72 * MAP_INCHES, most_lines=1))
        axes.yaxis.set_major_locator(MaxNLocator(4))
    else:
        axes.set_ylim(len(rows) - 0.4, -1.75)
        axes.set_yticks([-1.1, *range(len(rows))], ["the policy", *(fitted(name, 1.1, most_lines=1) for name in rows)])
        axes.tick_params(axis="y", length=0)
    axes.set_xlim(float(shown.across[0]), float(shown.across[-1]))
    axes.set_xlabel(fitted(shown.covariates[0], 0.75 * MAP_WIDTH_INCHES, most_lines=1))
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.set_title(f"stage {shown.stage}", **PANEL_NAME)
    return figure


def _draw_areas(axes: Axes, shown: PolicyMap, colours: dict[str, str], up: tuple[float, float]) -> None:
    names, codes = np.unique(shown.taken, return_inverse=True)
    tints = [
        tuple(TINT * part + 1.0 - TINT for part in to_rgba(colours.get(name, OTHERS_COLOUR))[:3])
        for name in names.tolist()
    ]
    extent = (float(shown.across[0]), float(shown.across[-1]), *up)
    style: Any = {"origin": "lower", "extent": extent, "aspect": "auto", "interpolation": "nearest", "zorder": 0}
    codes = codes.reshape(shown.taken.shape)
    axes.imshow(codes, cmap=ListedColormap(tints), vmin=-0.5, vmax=len(names) - 0.5, **style)
    if not shown.is_supported.all():
        across = np.linspace(extent[0], extent[1], shown.taken.shape[1])
        heights = np.linspace(*up, max(shown.taken.shape[0], 2))
        lacking = np.broadcast_to(~shown.is_supported, (len(heights), len(across))).astype(float)
        axes.contourf(across, heights, lacking, levels=[0.5, 1.5], colors="none", hatches=["////"], zorder=1)


def draw_table_map(shown: TableMap, verb: str) -> Figure:
    """Draw how often a table policy would take a verb, by object; cells of too few objects are hatched."""
    figure = Figure(figsize=(3.7, 3.2), layout="constrained")
    axes = figure.subplots()
    axes.set_facecolor("white")
    share, across, up = shown.share[verb], shown.chance_edges, shown.hidden_edges
    axes.fill(across[[0, -1, -1, 0]], up[[0, 0, -1, -1]], facecolor="none", hatch="////", linewidth=0.0, zorder=0)
    largest = max(float(np.nanmax(share)), 0.01)
    cells = axes.pcolormesh(across, up, np.ma.masked_invalid(share), cmap=DEEPENING, vmin=0.0, vmax=largest, zorder=1)
    whole = PercentFormatter(1.0, decimals=0)
    bar = figure.colorbar(cells, ax=axes, shrink=0.9, format=whole)
    bar.outline.set_visible(False)
    axes.set_xlabel("probability of being dirty")
    axes.set_ylabel("hidden share")
    axes.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.set_title(f"{verb} it next", **PANEL_NAME)
    return figure
