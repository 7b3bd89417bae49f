"""Trajectories along time: a line of stages each, coloured by what was done, with a marker for how it ended."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from halfseen.pages.axes import NARROW_INCHES
from halfseen.pages.drawing import MOST_MARKERS
from halfseen.pages.palette import INK
from halfseen.report.action_colours import UNKNOWN_COLOUR, colour_of, names_shown
from halfseen.report.endings import FINISHED_ROW
from halfseen.report.timeline import UNKNOWN_ACTION, Timeline, TimelineEnding

THICKEST_INCHES, MOST_INCHES, FEWEST_INCHES = 0.16, 4.6, 0.5
GAP_ROWS = 0.02
"""Room between two ways to end, as a share of all rows."""
CAUSE_MARKERS = "XvD^*"
LEGEND_COLUMNS = 4
LINE_INCHES = 0.235
UNFINISHED_OPACITY = 0.4


def draw_timeline(told: Timeline, colours: dict[str, str]) -> Figure:
    """Draw each row as a line of stages; the ways to end lie below each other."""
    names = names_shown((name for name in told.action if name != UNKNOWN_ACTION), colours)
    is_unknown = bool((told.action == UNKNOWN_ACTION).any())
    body = float(np.clip(THICKEST_INCHES * told.num_rows, FEWEST_INCHES, MOST_INCHES))
    num_keys = len(names) + is_unknown + (not told.is_completed.all()) + len(told.endings)
    legend = LINE_INCHES * -(-num_keys // LEGEND_COLUMNS) + 0.12
    height = body + legend + 0.6
    figure = Figure(figsize=(NARROW_INCHES, height))
    axes = figure.add_axes((0.235, 0.55 / height, 0.735, body / height))
    place, ticks = _places(told)
    _draw_stages(axes, told, place, colours)
    size = float(np.clip(72.0 * body / told.num_rows, 4.0, 7.0))
    _draw_ends(axes, told, place, size)
    axes.set_yticks(list(ticks), [_name(group) for group in told.endings])
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.set_ylim(place[-1] + 1.0, -0.5)
    axes.set_xlim(0.0, 1.02 * float(told.end_s.max()))
    axes.set_xlabel("time since the trajectory began [s]")
    figure.legend(
        handles=_keys(told, names, colours, is_unknown), loc="upper left", ncols=LEGEND_COLUMNS, frameon=False
    )
    return figure


def _places(told: Timeline) -> tuple[np.ndarray, list[float]]:
    """Height of each row, with a gap between two ways to end; and the middle of each way."""
    gap, place, ticks, begin = GAP_ROWS * told.num_rows + 0.4, [], [], 0.0
    for group in told.endings:
        own = begin + np.arange(group.num_rows)
        place.append(own)
        ticks.append(float(own.mean()))
        begin = float(own[-1]) + 1.0 + gap
    return np.concatenate(place), ticks


def _draw_stages(axes: Axes, told: Timeline, place: np.ndarray, colours: dict[str, str]) -> None:
    top = place[told.row] - 0.42
    corners = np.stack([told.begin_s, top, told.until_s, top + 0.84], axis=1)
    # One drawing a colour, and a picture within it where they are many.
    kinds = dict.fromkeys(zip(told.action, told.is_completed, strict=True))
    for action, is_completed in kinds:
        own = corners[(told.action == action) & (told.is_completed == is_completed)]
        boxes = [[(a, low), (b, low), (b, high), (a, high)] for a, low, b, high in own]
        colour = UNKNOWN_COLOUR if action == UNKNOWN_ACTION else colour_of(action, colours)
        shown: Any = {"facecolors": colour, "edgecolors": "none", "alpha": 1.0 if is_completed else UNFINISHED_OPACITY}
        axes.add_collection(PolyCollection(boxes, rasterized=len(corners) > MOST_MARKERS, **shown))


def _draw_ends(axes: Axes, told: Timeline, place: np.ndarray, size: float) -> None:
    first = 0
    for group, (marker, style) in zip(told.endings, _markers(told.endings), strict=True):
        own = slice(first, first + group.num_rows)
        axes.plot(told.end_s[own], place[own], marker, ms=size, clip_on=False, zorder=4, **style)
        first += group.num_rows


def _markers(groups: tuple[TimelineEnding, ...]) -> list[tuple[str, dict[str, Any]]]:
    """A stroke where a trajectory finished, and a shape of its own for each cause of a cut."""
    shapes = iter(CAUSE_MARKERS)
    stroke: dict[str, Any] = {"color": INK, "mew": 1.3}
    cut: dict[str, Any] = {"color": INK, "mew": 0.5, "mec": "white"}
    return [("|", stroke) if group.name == FINISHED_ROW else (next(shapes), cut) for group in groups]


def _name(group: TimelineEnding) -> str:
    trajectories = "trajectory" if group.num_trajectories == 1 else "trajectories"
    return f"{group.name}\n{group.num_trajectories:,} {trajectories}"


def _keys(told: Timeline, names: list[str], colours: dict[str, str], is_unknown: bool) -> list[Any]:
    keys: list[Any] = [Patch(color=colours[name], label=name) for name in names]
    keys += [Patch(color=UNKNOWN_COLOUR, label=f"action {UNKNOWN_ACTION}")] if is_unknown else []
    if not told.is_completed.all():
        keys.append(Patch(color=INK, alpha=UNFINISHED_OPACITY, label="pale: not completed"))
    for group, (marker, style) in zip(told.endings, _markers(told.endings), strict=True):
        keys.append(Line2D([], [], marker=marker, ls="", ms=7, label=group.name, **style))
    return keys
