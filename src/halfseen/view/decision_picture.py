"""Pictures of decisions: the camera's view, the chosen object and action, and the value of each action.

Beside the table, bars show the compared values, with the interval of Q and each action's chance of being best; the
reason stands below. A policy of named actions has the bars only. Text is large relative to the width, so that the
picture is legible at a width of 400 pixels.
"""

import os
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, PathPatch
from matplotlib.path import Path as Outline

from halfseen.figures import ALARM, FAINT, INK, OURS, SOFT, drawn
from halfseen.perception.picture import draw_view
from halfseen.perception.view import View
from halfseen.policies.decision import Decision
from halfseen.wording import MISSING, percent
from halfseen.writing import write_file

MOST_BARS = 8

LIKELY = 0.05  # chance of being best from which an action has a bar, whatever its value

WIDTH_INCHES = 7.2
HEAD_INCHES, FOOT_INCHES = 0.5, 0.7
LINE_INCHES, LETTER_SIZE, NUM_LETTERS = 0.215, 11.0, 84
BAR_INCHES, LEAST_BARS_INCHES = 0.36, 1.2
SHARE_OF_VIEW = 0.5
BADGE_SHARE = 0.05  # radius of the badge with the glyph, as a fraction of the shown width
ROOM, LEAST_SHOWN = 1.35, 0.4
"""Extent shown, relative to that of the objects; and least fraction of the image that is shown."""

Glyph = Callable[[Axes, float, float, float], None]  # draws an action: axes, centre (right, down), radius


def draw_decision(
    decision: Decision, path: str | os.PathLike[str], *, view: View | None = None, stage: int = 1, horizon: int = 1
) -> None:
    """Draw a decision as a PNG or SVG file.

    Parameters
    ----------
    path
        Destination; its extension determines the format. The file is written atomically, and missing parents are made.
    view
        The camera's view, for tables; None for named actions.
    stage, horizon
        The stage of the decision, from 1, and the largest number of stages of a trajectory.

    Raises
    ------
    ArgumentError
        The file cannot be written.
    """
    kind = Path(path).suffix.lower().removeprefix(".")
    write_file(Path(path), drawn(lambda: _figure(decision, view, stage, horizon), kind))


def _figure(decision: Decision, view: View | None, stage: int, horizon: int) -> Figure:
    reason = textwrap.wrap(decision.reason, NUM_LETTERS)
    warned = [line for one in decision.warnings for line in textwrap.wrap(f"Warning: {one}", NUM_LETTERS)]
    shown = _shown(decision)
    rows, columns = (0, 1) if view is None else view.labels.shape
    seen_inches = WIDTH_INCHES * SHARE_OF_VIEW * rows / columns
    body = max(seen_inches, LEAST_BARS_INCHES, BAR_INCHES * len(shown))
    words = LINE_INCHES * (len(reason) + len(warned)) + 0.2
    height = HEAD_INCHES + body + FOOT_INCHES + words
    figure = Figure(figsize=(WIDTH_INCHES, height))
    top, bottom = 1.0 - HEAD_INCHES / height, (FOOT_INCHES + words) / height
    figure.text(0.02, 1.0 - 0.12 / height, str(decision.action), va="top", size=17, weight="bold", color=OURS)
    figure.text(0.98, 1.0 - 0.16 / height, f"stage {stage} of {horizon}", va="top", ha="right", size=LETTER_SIZE)
    if view is not None:
        of_view = figure.add_axes((0.015, top - seen_inches / height, SHARE_OF_VIEW - 0.015, seen_inches / height))
        _draw_table(of_view, view, str(decision.action))
    left = 0.0 if view is None else SHARE_OF_VIEW
    longest = max((len(name) for name in shown), default=0)
    names = min(0.03 + 0.0135 * longest, 0.35)
    if shown:
        _draw_bars(figure.add_axes((left + names, bottom, 0.89 - left - names, top - bottom)), decision, shown)
    _write(figure, reason, warned, words / height, LINE_INCHES / height)
    return figure


def _shown(decision: Decision) -> list[str]:
    """Actions by name, the best first: those with a fair chance of being best, and as many others as fit."""
    known = {name: q for name, q in decision.q_values.items() if q is not None}
    ranked = sorted(known, key=lambda name: -known[name])
    likely = [name for name in ranked[1:] if decision.chance_best.get(name, 0.0) >= LIKELY]
    first = [*ranked[:1], *likely, *(name for name in ranked[1:] if name not in likely)][:MOST_BARS]
    return sorted(first, key=lambda name: -known[name])


def _draw_table(axes: Axes, view: View, action: str) -> None:
    """The image of the cloud, cropped to the objects on the table, with the chosen object outlined."""
    draw_view(axes, view, LETTER_SIZE - 1.0, has_shares=False)
    left, right, top, bottom = _cut(view)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    radius = BADGE_SHARE * (right - left)
    verb, _, target = action.partition(" ")
    corner = right - 1.3 * radius, top + 1.3 * radius
    # Objects that are known only from the history have no outline.
    if target and int(target) < len(view.objects):
        silhouette = view.silhouettes[int(target)]
        for width, colour in ((6.0, "white"), (3.2, ALARM)):
            axes.contour(silhouette.astype(float), levels=[0.5], colors=[colour], linewidths=width)
        corner = _badge_place(view, silhouette, radius, (left, right, top, bottom))
    axes.add_patch(Circle(corner, radius, facecolor="white", edgecolor=ALARM, linewidth=2.2, zorder=10))
    if verb in GLYPHS:
        GLYPHS[verb](axes, *corner, radius)


def _cut(view: View) -> tuple[float, float, float, float]:
    """Left, right, top and bottom of the crop [px]: all objects with a margin, at the aspect ratio of the image."""
    num_rows, num_columns = view.labels.shape
    is_object = (view.labels >= 0) | view.silhouettes.any(axis=0)
    rows, columns = np.flatnonzero(is_object.any(axis=1)), np.flatnonzero(is_object.any(axis=0))
    share = max(np.ptp(rows) / num_rows, np.ptp(columns) / num_columns)
    share = float(min(1.0, max(ROOM * share, LEAST_SHOWN)))
    width, height = share * num_columns, share * num_rows
    left = np.clip(columns[[0, -1]].mean() - width / 2, 0, num_columns - width)
    top = np.clip(rows[[0, -1]].mean() - height / 2, 0, num_rows - height)
    return float(left), float(left + width), float(top), float(top + height)


def _badge_place(
    view: View, silhouette: np.ndarray, radius: float, cut: tuple[float, float, float, float]
) -> tuple[float, float]:
    """A position beside the chosen object (column, row) at which the badge covers the least of other objects [px]."""
    left, right, top, bottom = cut
    rows, columns = np.nonzero(silhouette)
    middle = columns.mean(), rows.mean()
    reach = np.array([np.ptp(columns) / 2 + 1.25 * radius, np.ptp(rows) / 2 + 1.25 * radius])
    down, aside = np.indices(view.labels.shape)
    best, least = middle, np.inf
    for angle in np.linspace(-np.pi / 2, 1.5 * np.pi, 12, endpoint=False):
        column = float(np.clip(middle[0] + reach[0] * np.cos(angle), left + 1.1 * radius, right - 1.1 * radius))
        row = float(np.clip(middle[1] + reach[1] * np.sin(angle), top + 1.1 * radius, bottom - 1.1 * radius))
        is_under = (aside - column) ** 2 + (down - row) ** 2 < (1.15 * radius) ** 2
        covered = float(np.sum(is_under & ((view.labels >= 0) | silhouette)))
        if covered < least:
            best, least = (column, row), covered
    return best


def _arrow_up(axes: Axes, column: float, row: float, radius: float) -> None:
    size = 0.62 * radius
    corners = [(0, -1.1), (0.95, 0), (0.35, 0), (0.35, 1), (-0.35, 1), (-0.35, 0), (-0.95, 0)]
    axes.fill(*zip(*[(column + size * x, row + size * y) for x, y in corners], strict=True), color=ALARM, zorder=11)


def _drop(axes: Axes, column: float, row: float, radius: float) -> None:
    size = 0.62 * radius
    corners = [(0, -1.05), (0.25, -0.5), (0.75, -0.1), (0.75, 0.35), (0.75, 0.8), (0.4, 1.0), (0, 1.0)]
    mirrored = [(-x, y) for x, y in reversed(corners[:-1])]
    points = [(column + size * x, row + size * y) for x, y in [*corners, *mirrored]]
    codes = [Outline.MOVETO, *[Outline.CURVE4] * 12]
    axes.add_patch(PathPatch(Outline(points, codes), facecolor=OURS, linewidth=0, zorder=11))


def _flag(axes: Axes, column: float, row: float, radius: float) -> None:
    size = 0.62 * radius
    pole = [(column - 0.5 * size, row + size), (column - 0.5 * size, row - size)]
    axes.plot(*zip(*pole, strict=True), color=INK, linewidth=2.2, zorder=11)
    cloth = [(column - 0.5 * size, row - size), (column + size, row - 0.5 * size), (column - 0.5 * size, row)]
    axes.fill(*zip(*cloth, strict=True), color=ALARM, linewidth=0, zorder=11)


GLYPHS: dict[str, Glyph] = {"WASH": _drop, "LIFT": _arrow_up, "FINISH": _flag}
"""Glyph of each verb; others have an empty badge."""


def _draw_bars(axes: Axes, decision: Decision, shown: Sequence[str]) -> None:
    values = np.array([decision.q_values[name] for name in shown], dtype=np.float64)
    ends = np.array([decision.intervals.get(name, (q, q)) for name, q in zip(shown, values, strict=True)])
    low, high = min(values.min(), ends.min()), max(values.max(), ends.max())
    room = 0.08 * (high - low) or 0.1 * max(1.0, abs(high))
    # If all values are far from 0, bars from 0 would look alike.
    from_zero = bool(low - 3.0 * (high - low) <= 0.0 <= high + 3.0 * (high - low))
    left, right = (min(low, 0.0), max(high, 0.0)) if from_zero else (low - room, high)
    axes.set_xlim(left - (room if left < 0.0 and from_zero else 0.0), right + room)
    rows = np.arange(len(shown))
    colours = [OURS if name == str(decision.action) else FAINT for name in shown]
    start = 0.0 if from_zero else left
    axes.barh(rows, values - start, left=start, color=colours, height=0.66)
    if decision.intervals:
        axes.hlines(rows, ends[:, 0], ends[:, 1], color=INK, linewidth=2.0)
        axes.vlines(ends.T.ravel(), np.tile(rows - 0.17, 2), np.tile(rows + 0.17, 2), color=INK, linewidth=1.5)
        for row, name in enumerate(shown):
            axes.text(
                1.03, row, percent(decision.chance_best.get(name)), transform=axes.get_yaxis_transform(), va="center"
            )
        axes.text(1.03, -0.75, "best", transform=axes.get_yaxis_transform(), va="center", color=SOFT)
    if from_zero:
        axes.axvline(0.0, color=INK, linewidth=0.8)
    axes.set_yticks(rows, shown)
    axes.set_ylim(len(shown) - 0.4, -1.0)
    axes.tick_params(axis="y", length=0)
    axes.tick_params(labelsize=LETTER_SIZE - 0.5)
    axes.locator_params(axis="x", nbins=4)
    axes.spines["left"].set_visible(False)
    axes.set_xlabel(_axis_label(decision, shown, from_zero), size=LETTER_SIZE - 0.5)


def _axis_label(decision: Decision, shown: Sequence[str], from_zero: bool) -> str:
    known = sum(q is not None for q in decision.q_values.values())
    more = f"; {known - len(shown)} more not shown" if known > len(shown) else ""
    cut = "" if from_zero else ", not from 0"
    lines = "line: 95 % interval of Q" if decision.intervals else f"{MISSING} no interval known"
    return f"value [reward]{cut}{more}\n{lines}"


def _write(figure: Figure, reason: Sequence[str], warned: Sequence[str], top: float, line: float) -> None:
    for k, words in enumerate([*reason, *warned]):
        colour = INK if k < len(reason) else ALARM
        figure.text(0.02, top - 0.3 * line - k * line, words, va="top", size=LETTER_SIZE, color=colour)
