"""The figures of a law."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from halfseen import figures as pages
from halfseen.arrays import Rows
from halfseen.cell.calibration import attempts
from halfseen.cell.calibration.attempts import OCCLUSION_EDGES, Share, glances, occlusion_bins, shares_by, trials
from halfseen.cell.calibration.fits import held_given_past
from halfseen.figures import BLUE, RED, WIDTH_INCHES, draw_bars, draw_grid, drawn
from halfseen.logs import Logs
from halfseen.shapes import Float, Int
from halfseen.tables.grasp_attempts import checked_attempts
from halfseen.world.seeing import SAME_VIEW, PersistentSeeing

HELD_TITLE = "How often attempts held, and what the fitted law predicts"
PARTS = 3  # number of quantile groups by width and by room
_HELD_APART = 0.12
Panels = Mapping[str, Mapping[str, Share]]  # shares by grouping variable, then by group name


def held_shares(theta: Float[np.ndarray, " p"], trials: pd.DataFrame) -> Panels:
    """Compare the share that held with the law's predictions given past attempts; attempts have weight 1/Ĝ.

    Parameters
    ----------
    theta
        Estimates of `halfseen.cell.calibration.fits.NAMES`.
    trials
        Attempts from `halfseen.cell.calibration.attempts.trials`.
    """
    decided = checked_attempts(trials)
    said, met = held_given_past(theta, trials)[decided.row], trials.iloc[decided.row]
    tables = pd.factorize(met["trajectory"])[0].astype(np.int64)
    occlusion, is_lying, width_m, room_m = (
        met[name].to_numpy(dtype=np.float64) for name in ("occlusion", "is_lying", "width_m", "room_m")
    )
    of_occlusion = [f"{low:g}–{high:g}" for low, high in pairwise(OCCLUSION_EDGES.tolist())]
    groups = {
        "hidden share": (occlusion_bins(occlusion), of_occlusion),
        "pose": (is_lying.astype(np.int64), ["standing", "lying"]),
        "width [cm]": _parts(100.0 * width_m),
        "room beside it [cm]": _parts(100.0 * room_m),
    }
    return {
        by: {names[k]: share for k, share in shares_by(of, decided.succeeded, said, decided.weight, tables).items()}
        for by, (of, names) in groups.items()
    }


def draw_held(panels: Panels) -> Figure:
    """Draw a panel for each grouping.

    Parameters
    ----------
    panels
        Shares from `held_shares`.
    """
    figure = Figure(figsize=(WIDTH_INCHES, 4.0))
    top = pages.write_title(figure, HELD_TITLE)
    ratios = [max(len(shares), 2.5) for shares in panels.values()]
    grid = figure.add_gridspec(
        1, len(panels), left=0.065, right=0.99, bottom=0.23, top=top - 0.20, wspace=0.08, width_ratios=ratios
    )
    axes = grid.subplots(sharey=True, squeeze=False)[0]
    for one, (by, shares) in zip(axes, panels.items(), strict=True):
        _draw_panel(one, by, shares)
    axes[0].yaxis.set_major_formatter(PercentFormatter(1.0, 0))
    pages.write_legend(figure, pages.named_curves(axes[0]), top - 0.02)
    return figure


def _draw_panel(axes: Axes, by: str, shares: Mapping[str, Share]) -> None:
    across = np.arange(len(shares), dtype=np.float64)
    held = np.array([(each.held, each.low, each.high) for each in shares.values()])
    name = "held, with its 95 % interval (clustered by table)"
    draw_bars(axes, across - _HELD_APART, held, color=BLUE, marker="o", linestyle="none", label=name)
    said = [each.predicted for each in shares.values()]
    axes.plot(
        across + _HELD_APART,
        said,
        color=RED,
        marker="D",
        linestyle="none",
        label="predicted by the law, given past attempts",
    )
    names = [f"{name}\n{each.num_attempts:,}" for name, each in shares.items()]
    axes.set_xticks(across, names, fontsize=8.0)
    axes.set_xlim(-0.5, len(shares) - 0.5)
    draw_grid(axes)
    axes.set_xlabel(f"{by};\nattempts")
    axes.set_title(f"by {by.split(' [')[0]}", **pages.PANEL_TITLE)


def _parts(values: Rows) -> tuple[Int[np.ndarray, " n"], list[str]]:
    """Group number of each value, in groups of about equal size, and the range of values of each group."""
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, PARTS + 1)))
    names = [f"{low:.1f}–{high:.1f}" for low, high in pairwise(edges.tolist())]
    return np.searchsorted(edges[1:-1], values, side="right").astype(np.int64), names or [f"{edges[0]:.1f}"]


LABELS_TITLE = "How labels depend on how much of an object has been in view"
_LABELS_APART = 0.004
LINES = {
    True: ("sensitivity", "dirty objects labelled dirty", BLUE, "o", 1),
    False: ("false_alarms", "clean objects labelled dirty", RED, "s", -1),
}
"""For dirty and for clean objects: attribute of the curve, its name, colour and marker, and side of the offset."""


class Count(NamedTuple):
    """Objects with about the same share in view (`view` is its mean): number labelled DIRTY, and number of all."""

    view: float
    num_labelled: int
    seen: int


def counted(rows: pd.DataFrame, seeing: PersistentSeeing) -> list[Count]:
    """Count objects whose first label was DIRTY, by the share in view; and those labelled DIRTY by when they were held.

    What later looks show depends on earlier actions; the first look does not, and lifted objects are chosen at random.
    These shares therefore estimate the curve without assumptions between its knots.

    Parameters
    ----------
    rows
        Dirty objects, or clean objects, from `halfseen.cell.calibration.attempts.glances`.
    """
    columns = (rows[name] for name in ("glance_occlusions", "glance_held", "glance_dirty"))
    labels = [
        [(float(occlusion), bool(held), bool(dirty)) for occlusion, held, dirty in zip(*each, strict=True)]
        for each in zip(*columns, strict=True)
    ]
    firsts = [
        (float(seeing.facing) * (1.0 - label[0][0]), label[0][2]) for label in labels if label and not label[0][1]
    ]
    knots = [-np.inf, *(float(view) for view in seeing.views)]
    groups = [
        [each for each in firsts if low + SAME_VIEW < each[0] <= high + SAME_VIEW] for low, high in pairwise(knots)
    ]
    groups.append([(1.0, _by_being_held(labels)) for labels in labels if any(held for _, held, _ in labels)])
    return [
        Count(float(np.mean([view for view, _ in group])), sum(dirty for _, dirty in group), len(group))
        for group in groups
        if group
    ]


def _by_being_held(labels: Iterable[tuple[float, bool, bool]]) -> bool:
    """Whether an object was labelled DIRTY by the time it was first seen in the hand."""
    for _, is_held, says_dirty in labels:
        if says_dirty or is_held:
            return says_dirty
    return False


def draw_labels(seeing: PersistentSeeing, glances: pd.DataFrame) -> Figure:
    """Draw both curves and the counts.

    Parameters
    ----------
    glances
        Data of the fit, from `halfseen.cell.calibration.attempts.glances`.
    """
    figure = Figure(figsize=(WIDTH_INCHES, 4.6))
    top = pages.write_title(figure, LABELS_TITLE)
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
        "share of its surface that was in view; marks: labelled dirty/seen, at the first label and when held, "
        "95 % intervals"
    )
    return figure


def _draw_curve(axes: Axes, seeing: PersistentSeeing, rows: pd.DataFrame, is_dirty: bool) -> None:
    name, words, colour, marker, side = LINES[is_dirty]
    views, curve = ([0.0, *map(float, values)] for values in (seeing.views, getattr(seeing, name)))
    axes.plot(views, curve, color=colour, label=words)
    counts = counted(rows, seeing)
    across = np.array([count.view for count in counts]) + side * _LABELS_APART
    shares = [count.num_labelled / count.seen for count in counts]
    ends = [(share, *attempts.wilson(share, float(count.seen))) for share, count in zip(shares, counts, strict=True)]
    draw_bars(axes, across, np.array(ends).reshape(-1, 3), color=colour, marker=marker, linestyle="none")
    for place, (*_, high), count in zip(across, ends, counts, strict=True):
        offset: Any = {"textcoords": "offset points", "xytext": (-4.0 * side, 3.0)}
        text = f"{count.num_labelled:,}/{count.seen:,}"
        axes.annotate(text, (place, high), ha="right", color=colour, fontsize=8.0, **offset)


KINDS = ("svg", "png")


def pictures_of(
    theta: Float[np.ndarray, " p"], seeing: PersistentSeeing, logs: Logs
) -> Mapping[str, Callable[[Path], None]]:
    """Functions that write the figures of a law, by file name."""
    panels = held_shares(theta, trials(logs, attempts.HORIZON))
    figures = {"held": partial(draw_held, panels), "labels": partial(draw_labels, seeing, glances(logs))}

    def write(draw: Callable[[], Figure], kind: str, file: Path) -> None:
        file.write_bytes(drawn(draw, kind))

    return {f"{name}.{kind}": partial(write, draw, kind) for name, draw in figures.items() for kind in KINDS}
