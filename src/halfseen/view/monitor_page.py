"""The page of a policy in service: the answer, its rewards over time, and the evidence for a change over time."""

from functools import partial
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from halfseen.figures import ALARM, BAND_OPACITY, GREEN, NARROW_INCHES, ORANGE, OURS, PINK, SOFT, draw_grid, inline_svg
from halfseen.monitoring.answer import Monitored
from halfseen.monitoring.monitor import ALPHAS
from halfseen.view.page import MARK
from halfseen.view.templates import rendered
from halfseen.wording import as_sentence, counted, labelled, significant

NAMES = {"rewards": "rewards", "promise": "promise", "inputs": "inputs", "parts": "parts of the cell"}
COLOURS = {"rewards": OURS, "promise": ORANGE, "inputs": GREEN, "parts": PINK}
SMALLEST_P = 1e-12


def monitor_page(found: Monitored, unit: str | None, command: str) -> str:
    """Write the page, including the command that makes it again."""
    content = {"mark": MARK, "found": found, "figures": figures_of(found, unit), "command": command}
    functions = {"as_sentence": as_sentence, "counted": counted, "significant": significant}
    return rendered("halfseen.view", "monitor.html.j2", content, **functions)


def figures_of(found: Monitored, unit: str | None) -> dict[str, Markup]:
    """Draw the rewards over time, if known, and the evidence for a change over time, by title."""
    figures = {}
    if found.course is not None and found.outcomes is not None:
        title = "Mean reward of a trajectory so far, with bounds that hold at all times, and the promised reward"
        figures[title] = inline_svg(partial(_draw_earned, found, unit), "f-earned", title)
    title = "Evidence for a change: an alarm where a curve falls below its dotted line"
    figures[title] = inline_svg(partial(_draw_evidence, found), "f-evidence", title)
    return figures


def _draw_earned(found: Monitored, unit: str | None) -> Figure:
    figure = Figure(figsize=(NARROW_INCHES, 3.0))
    axes = figure.subplots()
    figure.subplots_adjust(left=0.11, right=0.97, top=0.97, bottom=0.17)
    outcomes: Any = found.outcomes
    course: Any = found.course
    at = np.flatnonzero(outcomes.is_weighed) + 1
    mean = np.cumsum(outcomes.values[at - 1]) / np.arange(1, len(at) + 1)
    if found.promised is not None:
        axes.axhspan(found.promised["low"], found.promised["high"], color=SOFT, alpha=BAND_OPACITY, linewidth=0)
        axes.axhline(found.promised["value"], color=SOFT, linestyle="--", label="promised, with its interval")
    # The bounds are of one mean, so they end where it has changed.
    held = at < found.findings[0].since if found.findings else at > 0
    axes.fill_between(at[held], course.lower[held], course.upper[held], color=OURS, alpha=BAND_OPACITY, linewidth=0)
    axes.plot(at, np.clip(mean, course.lower[0], course.upper[0]), color=OURS, label="earned, mean so far")
    _mark(axes, found)
    axes.set_ylabel(labelled("reward a trajectory", unit))
    return figure


def _draw_evidence(found: Monitored) -> Figure:
    figure = Figure(figsize=(NARROW_INCHES, 2.6))
    axes = figure.subplots()
    figure.subplots_adjust(left=0.11, right=0.97, top=0.97, bottom=0.2)
    for family, p in found.p_values.items():
        shown = np.maximum(p, SMALLEST_P)
        axes.plot(np.arange(1, len(p) + 1), shown, color=COLOURS[family], label=NAMES[family])
        axes.axhline(ALPHAS[family], color=COLOURS[family], linestyle=":", linewidth=1.0)
    axes.set_yscale("log")
    axes.set_ylim(SMALLEST_P / 2.0, 2.0)
    axes.set_yticks([1.0, 1e-3, 1e-6, 1e-9, 1e-12], ["1", "0.001", "1e-6", "1e-9", "1e-12"])
    axes.minorticks_off()
    _mark(axes, found)
    axes.set_ylabel("adjusted p-value")
    return figure


def _mark(axes: Any, found: Monitored) -> None:
    if found.findings:
        first = found.findings[0]
        axes.axvspan(first.since_low, first.since_high + 1, color=ALARM, alpha=BAND_OPACITY, linewidth=0)
        axes.axvline(found.alarm_at, color=ALARM, label="alarm; shaded: when it may have changed")
    axes.set_xlim(1, max(found.num_trajectories, 2))
    axes.set_xlabel("trajectories so far")
    axes.legend(frameon=False, loc="best", fontsize=8.5)
    draw_grid(axes)
