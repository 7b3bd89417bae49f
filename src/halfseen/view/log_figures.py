"""Figures of a log: trajectories over time, and their follow-up; and a colour for each action."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from halfseen import figures
from halfseen.figures import INK, LINES, NARROW_INCHES, OURS, draw_grid, fitted, legend_columns
from halfseen.view.log_findings import FINISHED, UNKNOWN_ACTION, EndingRows, FollowUp, Timeline
from halfseen.wording import counted

OTHERS, OTHERS_COLOUR = "other actions", figures.SOFT
UNKNOWN_COLOUR = "#b9b9b9"
THICKEST_INCHES, MOST_INCHES, FEWEST_INCHES = 0.16, 4.6, 0.5
GAP_ROWS = 0.02  # gap between two kinds of ending, as a fraction of all rows
CAUSE_MARKERS = "XvD^*"
LEGEND_COLUMNS, LEGEND_INCHES = 4, NARROW_INCHES - 0.2
LINE_INCHES = 0.235
MARGIN = 0.235  # fraction of the width for the names of the kinds of ending
NAME_INCHES, NAME_LINE_INCHES = MARGIN * NARROW_INCHES - 0.15, 0.17
UNFINISHED_OPACITY = 0.4


def action_colours(actions: Sequence[str]) -> dict[str, str]:
    """Colours of actions in order of importance; actions beyond the palette are `OTHERS`.

    Examples
    --------
    >>> list(action_colours(["A", "B"]))
    ['A', 'B']
    >>> list(action_colours("ABCDEFGHI"))
    ['A', 'B', 'C', 'D', 'E', 'F', 'other actions']
    """
    if len(actions) <= len(LINES):
        return dict(zip(actions, LINES, strict=False))
    return {**dict(zip(actions, LINES[:-1], strict=False)), OTHERS: OTHERS_COLOUR}


def names_shown(actions: Iterable[str], colours: dict[str, str]) -> list[str]:
    """Names in the legend of these actions, in the order of the colours."""
    shown = {action if action in colours else OTHERS for action in actions}
    return [name for name in colours if name in shown]


def draw_timeline(shown: Timeline, colours: dict[str, str]) -> Figure:
    """Draw a line of stages for each row, with a marker for its ending; rows are grouped by kind of ending."""
    stages: Any = shown.stages
    num_rows = shown.num_rows
    actions = names_shown(set(stages["action"]) - {UNKNOWN_ACTION}, colours)
    keys: list[Any] = [Patch(color=colours[name], label=name) for name in actions]
    if (stages["action"] == UNKNOWN_ACTION).any():
        keys.append(Patch(color=UNKNOWN_COLOUR, label=f"action {UNKNOWN_ACTION}"))
    if not stages["is_completed"].all():
        keys.append(Patch(color=INK, alpha=UNFINISHED_OPACITY, label="pale: not completed"))
    markers = _markers(shown.endings)
    for group, style in zip(shown.endings, markers, strict=True):
        keys.append(Line2D([], [], ls="", ms=7, label=group.name, **style))
    for key in keys:
        key.set_label(fitted(key.get_label(), LEGEND_INCHES - figures.LEGEND_ENTRY_INCHES, most_lines=1))
    columns = legend_columns([key.get_label() for key in keys], LEGEND_INCHES, LEGEND_COLUMNS)
    rows_inches = float(np.clip(THICKEST_INCHES * num_rows, FEWEST_INCHES, MOST_INCHES))
    names = [
        f"{fitted(group.name, NAME_INCHES)}\n{counted(group.num_trajectories, 'trajectory')}" for group in shown.endings
    ]
    places, top, bottom, body = _places(shown, names, rows_inches)
    place = np.concatenate(places)
    height = body + LINE_INCHES * -(-len(keys) // columns) + 0.12 + 0.6
    figure = Figure(figsize=(NARROW_INCHES, height))
    axes = figure.add_axes((MARGIN, 0.55 / height, 0.97 - MARGIN, body / height))
    _draw_stages(axes, shown, place, colours)
    size = float(np.clip(72.0 * rows_inches / num_rows, 4.0, 7.0))
    ends_s = np.split(shown.end_s, np.cumsum([group.num_rows for group in shown.endings])[:-1])
    for own_s, own, style in zip(ends_s, places, markers, strict=True):
        axes.plot(own_s, own, ls="", ms=size, clip_on=False, zorder=4, **style)
    axes.set_yticks([float(own.mean()) for own in places], names)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.set_ylim(bottom, top)
    axes.set_xlim(0.0, 1.02 * float(shown.end_s.max()))
    axes.set_xlabel("time since the trajectory began [s]")
    figure.legend(handles=keys, loc="upper left", ncols=columns, frameon=False)
    return figure


def _places(shown: Timeline, names: Sequence[str], rows_inches: float) -> tuple[list[np.ndarray], float, float, float]:
    """Heights of the rows of each kind of ending, with room for its name; top, bottom and total height [inches]."""
    gap = GAP_ROWS * shown.num_rows + 0.4
    row_inches = rows_inches / (shown.num_rows + (len(names) - 1) * gap + 0.5)
    halves = [NAME_LINE_INCHES * (name.count("\n") + 1) / 2 / row_inches for name in names]
    places, begin, below = [], 0.0, -0.5
    top = min(-0.5, (shown.endings[0].num_rows - 1) / 2 - halves[0])
    for group, half in zip(shown.endings, halves, strict=True):
        if places:
            begin = max(begin, below + half - (group.num_rows - 1) / 2)
        places.append(begin + np.arange(group.num_rows))
        below = float(places[-1].mean()) + half
        begin = float(places[-1][-1]) + 1.0 + gap
    bottom = max(float(places[-1][-1]) + 1.0, below)
    return places, top, bottom, row_inches * (bottom - top)


def _draw_stages(axes: Axes, shown: Timeline, place: np.ndarray, colours: dict[str, str]) -> None:
    """Draw one collection per colour, rasterized if there are many stages."""
    stages: Any = shown.stages
    for (action, is_completed), own in stages.groupby(["action", "is_completed"], sort=False):
        top = place[own["row"]] - 0.42
        boxes = [
            [(a, low), (b, low), (b, low + 0.84), (a, low + 0.84)]
            for a, b, low in zip(own["begin_s"], own["until_s"], top, strict=True)
        ]
        colour = UNKNOWN_COLOUR if action == UNKNOWN_ACTION else colours.get(str(action), OTHERS_COLOUR)
        style: Any = {"facecolors": colour, "edgecolors": "none", "alpha": 1.0 if is_completed else UNFINISHED_OPACITY}
        axes.add_collection(PolyCollection(boxes, rasterized=len(stages) > figures.MOST_MARKERS, **style))


def _markers(groups: Sequence[EndingRows]) -> list[dict[str, Any]]:
    """A stroke for trajectories that finished, and a shape of its own for each cause of a cut."""
    shapes = iter(CAUSE_MARKERS)
    stroke: dict[str, Any] = {"marker": "|", "color": INK, "mew": 1.3}
    cut: dict[str, Any] = {"color": INK, "mew": 0.5, "mec": "white"}
    return [stroke if group.name == FINISHED else cut | {"marker": next(shapes)} for group in groups]


def _with_count(name: str, count: int) -> str:
    """Fit a name and its count into the margin; the count is never left out."""
    whole = fitted(f"{name} ({count:,})", NAME_INCHES, most_lines=3)
    return whole if "…" not in whole else f"{fitted(name, NAME_INCHES, most_lines=2)}\n({count:,})"


def draw_follow_up(shown: FollowUp) -> Figure:
    """Draw Ĝ, below it the ends of trajectories, and below these the numbers still under observation."""
    names = [_with_count(name, len(ends_s)) for name, ends_s in shown.ends_s.items()]
    num_rows, num_lines = len(names), max(name.count("\n") + 1 for name in names)
    heights = [2.5, (0.24 if num_lines == 1 else NAME_LINE_INCHES * num_lines + 0.06) * num_rows + 0.1]
    figure = Figure(figsize=(NARROW_INCHES, sum(heights) + 0.9))
    curve, ends = figure.subplots(2, 1, sharex=True, height_ratios=heights)
    figure.subplots_adjust(left=MARGIN, right=0.97, top=0.97, bottom=0.73 / (sum(heights) + 0.9), hspace=0.08)
    curve.step(shown.time_s, shown.survival, where="post", color=OURS)
    curve.set_ylim(0.0, 1.04)
    curve.set_ylabel("Ĝ: probability that a trajectory\nhas not been cut so far")
    draw_grid(curve)
    curve.tick_params(axis="x", length=0, labelbottom=False)
    for place, (name, ends_s) in enumerate(shown.ends_s.items()):
        colour = INK if name == FINISHED else LINES[1:][(place - 1) % (len(LINES) - 1)]
        ends.plot(ends_s, np.full(len(ends_s), place), "|", ms=9, mew=0.9, alpha=0.7, color=colour)
    ends.set_yticks(range(num_rows), names)
    ends.tick_params(axis="y", length=0)
    ends.set_ylim(num_rows - 0.4, -0.6)
    ends.set_xlim(0.0, 1.01 * shown.time_s[-1])
    ends.set_xticks(shown.risk_time_s.tolist())
    ends.set_xlabel("time since the trajectory began [s]", labelpad=20)
    below: Any = {"xytext": (0, -21), "textcoords": "offset points", "va": "top", "color": OURS}
    for time_s, count in zip(shown.risk_time_s, shown.num_watched, strict=True):
        ends.annotate(f"{count:,}", (float(time_s), 0), xycoords=("data", "axes fraction"), ha="center", **below)
    ends.annotate("at risk", (-0.05, 0), xycoords="axes fraction", ha="right", **below)
    return figure
