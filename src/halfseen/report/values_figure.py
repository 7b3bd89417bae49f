"""What the learned policy and its opponents earn, and the differences."""

from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from halfseen.evaluation import Estimate, Evaluation
from halfseen.pages.axes import NARROW_INCHES
from halfseen.pages.numbers import with_interval
from halfseen.pages.palette import ALARM, FAINT, INK, OURS, SOFT, THEIRS
from halfseen.report.opponents import gains_of, values_of
from halfseen.report.units import labelled

BOUND_SPANS = 1.0
"""How far beyond the other intervals that of importance sampling is drawn, in their span."""
VERDICT_COLOURS = {"better": OURS, "not better": ALARM, "cannot be said": SOFT}


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
    values.set_xlabel(labelled("mean reward of a trajectory", evaluation.reward_unit))
    told = {
        fill(name, 20): (gain, VERDICT_COLOURS[verdict], gain is evaluation.difference)
        for name, (gain, verdict) in gains.items()
    }
    _forest(gap, told, _limits([gain for gain, _ in gains.values()], []))
    gap.axvline(0.0, color=INK, lw=1.0, ls=(0, (4, 3)), zorder=0)
    over = labelled("gain: reward of the learned policy over the other's", evaluation.reward_unit)
    gap.set_xlabel(f"{over}; dashed: no gain")
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
