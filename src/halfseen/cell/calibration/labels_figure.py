"""What labels say by how much was in view: the curves, and beside them objects that were counted."""

from collections.abc import Iterable
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from halfseen.cell.calibration.clustered_share import wilson
from halfseen.figures import BLUE, RED, WIDTH_INCHES, draw_bars, draw_grid, write_title
from halfseen.world.seeing import SAME_VIEW, PersistentSeeing

TITLE = "What labels say by how much of an object has been in view"
APART = 0.004
LINES = {
    True: ("sensitivity", "dirty objects that were found", BLUE, "o", 1),
    False: ("false_alarms", "clean objects that were taken for dirty", RED, "s", -1),
}
"""Of dirty objects and of clean ones: the curve, its name, how it is drawn, and on which side of a place."""


class Count(NamedTuple):
    """Objects that were seen to about the same share."""

    view: float
    """Mean share of their surface."""
    told: int
    """Those whose label said DIRTY."""
    seen: int
    """All of them."""


def counted(rows: pd.DataFrame, seeing: PersistentSeeing) -> list[Count]:
    """Count the objects whose first label said DIRTY, by the share that it showed; and those that had by being held.

    Whatever a later look shows depends on what was done before; the first does not, and which objects are lifted is
    drawn at random. So these shares estimate the curve with nothing assumed between its knots.

    Parameters
    ----------
    rows
        Objects that are dirty, or that are clean, as `halfseen.cell.calibration.trials.glances` gives them.
    seeing
        Its views are the ends of the groups.
    """
    columns = (rows[name] for name in ("glance_occlusions", "glance_held", "glance_dirty"))
    told = [
        [(float(occlusion), bool(held), bool(dirty)) for occlusion, held, dirty in zip(*each, strict=True)]
        for each in zip(*columns, strict=True)
    ]
    firsts = [(float(seeing.facing) * (1.0 - label[0][0]), label[0][2]) for label in told if label and not label[0][1]]
    knots = [-np.inf, *(float(view) for view in seeing.views)]
    groups = [
        [each for each in firsts if low + SAME_VIEW < each[0] <= high + SAME_VIEW] for low, high in pairwise(knots)
    ]
    groups.append([(1.0, _by_being_held(labels)) for labels in told if any(held for _, held, _ in labels)])
    return [
        Count(float(np.mean([view for view, _ in group])), sum(dirty for _, dirty in group), len(group))
        for group in groups
        if group
    ]


def _by_being_held(labels: Iterable[tuple[float, bool, bool]]) -> bool:
    """Whether an object had told when it was first seen in the hand."""
    for _, is_held, says_dirty in labels:
        if says_dirty or is_held:
            return says_dirty
    return False


def draw_labels(seeing: PersistentSeeing, glances: pd.DataFrame) -> Figure:
    """Draw both curves, and what was counted.

    Parameters
    ----------
    seeing
        The curves.
    glances
        What they were fitted to, as `halfseen.cell.calibration.trials.glances` gives it.
    """
    figure = Figure(figsize=(WIDTH_INCHES, 4.6))
    top = write_title(figure, TITLE)
    axes = figure.add_axes((0.065, 0.12, 0.92, top - 0.18))
    for is_dirty in LINES:
        _draw_curve(axes, seeing, pd.DataFrame(glances[glances["is_dirty"] == is_dirty]), is_dirty)
    axes.set_xlim(0.0, 1.06)
    axes.set_ylim(0.0, 1.0)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(PercentFormatter(1.0, 0))
    draw_grid(axes)
    axes.legend(loc="upper left", frameon=False)
    axes.set_xlabel(
        "share of its surface that was in view; marks: told/seen at the first label, and when held, 95 % intervals",
    )
    return figure


def _draw_curve(axes: Axes, seeing: PersistentSeeing, rows: pd.DataFrame, is_dirty: bool) -> None:
    name, words, colour, marker, side = LINES[is_dirty]
    views, curve = ([0.0, *map(float, values)] for values in (seeing.views, getattr(seeing, name)))
    axes.plot(views, curve, color=colour, label=words)
    counts = counted(rows, seeing)
    across = np.array([count.view for count in counts]) + side * APART
    shares = [count.told / count.seen for count in counts]
    ends = [(share, *wilson(share, float(count.seen))) for share, count in zip(shares, counts, strict=True)]
    draw_bars(axes, across, np.array(ends).reshape(-1, 3), color=colour, marker=marker, linestyle="none")
    for place, (*_, high), count in zip(across, ends, counts, strict=True):
        offset: Any = {"textcoords": "offset points", "xytext": (-4.0 * side, 3.0)}
        text = f"{count.told:,}/{count.seen:,}"
        axes.annotate(text, (place, high), ha="right", color=colour, fontsize=8.0, **offset)
