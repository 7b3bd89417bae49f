"""How often attempts held, beside what the law says of them: by occlusion, pose, width and room."""

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from halfseen.arrays import Rows
from halfseen.cell.calibration.clustered_share import Share, shares_by
from halfseen.cell.calibration.held_given_past import held_given_past
from halfseen.cell.calibration.occlusion_bins import OCCLUSION_EDGES, occlusion_bins
from halfseen.figures import (
    BLUE,
    PANEL_TITLE,
    RED,
    WIDTH_INCHES,
    draw_bars,
    draw_grid,
    named_curves,
    write_legend,
    write_title,
)
from halfseen.shapes import Float, Int
from halfseen.tables.grasp.inputs import checked_attempts

TITLE = "How often attempts held, and what the law that was fitted to them says"
PARTS = 3
"""Groups of attempts by width and by room, about alike in number."""
APART = 0.12
Panels = Mapping[str, Mapping[str, Share]]
"""Shares by the name of their group, by what they are grouped by."""


def held_shares(theta: Float[np.ndarray, " p"], trials: pd.DataFrame) -> Panels:
    """Count what held and sum what the law says, given past attempts; attempts weigh 1/Ĝ.

    Parameters
    ----------
    theta
        Estimates of `halfseen.cell.calibration.grasp_fit.NAMES`.
    trials
        As `halfseen.cell.calibration.trials.trials` gives them.
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
        As `held_shares` gives them.
    """
    figure = Figure(figsize=(WIDTH_INCHES, 4.0))
    top = write_title(figure, TITLE)
    ratios = [max(len(shares), 2.5) for shares in panels.values()]
    grid = figure.add_gridspec(
        1, len(panels), left=0.065, right=0.99, bottom=0.23, top=top - 0.20, wspace=0.08, width_ratios=ratios
    )
    axes = grid.subplots(sharey=True, squeeze=False)[0]
    for one, (by, shares) in zip(axes, panels.items(), strict=True):
        _draw_panel(one, by, shares)
    axes[0].yaxis.set_major_formatter(PercentFormatter(1.0, 0))
    write_legend(figure, named_curves(axes[0]), top - 0.02)
    return figure


def _draw_panel(axes: Axes, by: str, shares: Mapping[str, Share]) -> None:
    across = np.arange(len(shares), dtype=np.float64)
    held = np.array([(each.held, each.low, each.high) for each in shares.values()])
    name = "held, with its 95 % interval (clustered by table)"
    draw_bars(axes, across - APART, held, color=BLUE, marker="o", linestyle="none", label=name)
    said = [each.predicted for each in shares.values()]
    axes.plot(
        across + APART, said, color=RED, marker="D", linestyle="none", label="what the law says, given past attempts"
    )
    names = [f"{name}\n{each.num_attempts:,}" for name, each in shares.items()]
    axes.set_xticks(across, names, fontsize=8.0)
    axes.set_xlim(-0.5, len(shares) - 0.5)
    draw_grid(axes)
    axes.set_xlabel(f"{by};\nattempts")
    axes.set_title(f"by {by.split(' [')[0]}", **PANEL_TITLE)


def _parts(values: Rows) -> tuple[Int[np.ndarray, " n"], list[str]]:
    """Groups about alike in number, and the values that each spans."""
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, PARTS + 1)))
    names = [f"{low:.1f}–{high:.1f}" for low, high in pairwise(edges.tolist())]
    return np.searchsorted(edges[1:-1], values, side="right").astype(np.int64), names or [f"{edges[0]:.1f}"]
