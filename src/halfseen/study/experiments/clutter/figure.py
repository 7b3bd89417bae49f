"""The map as a figure: how much learning gains over the best heuristic, over clutter, in each world."""

from dataclasses import asdict, replace
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure

from halfseen.pages.axes import WIDTH_INCHES, write_above, write_title
from halfseen.pages.numbers import MISSING, amount
from halfseen.pages.palette import INK
from halfseen.study.experiments.clutter.design import ClutterDesign
from halfseen.study.experiments.clutter.places import FACTORS, Place, assumed_laws
from halfseen.study.experiments.clutter.table import ENOUGH, LEARN, NO_SCALE, UNDECIDED
from halfseen.world.config import WorldConfig

ROW_INCHES, HEAD_INCHES, FOOT_INCHES = 1.42, 0.75, 1.25
GAP = 0.28
"""Between the two blocks, in widths of a panel."""
# Diverging, and told apart by colour-blind eyes.
COLOURS = "PuOr"
STEPS = np.array([-0.25, -0.15, -0.10, -0.05, 0.0, 0.05, 0.10, 0.15, 0.25])
"""Bounds of the colours, as distances from the share that is worth the trouble."""
DARK = 0.15
"""Distance from which on a field is so dark that its number is written in white."""
MARKS = {LEARN: "▲", UNDECIDED: "?", ENOUGH: "", NO_SCALE: ""}
HEADS = ("share of right labels (down) and cost of washing a clean cup (across)", "spread of grip offsets")
HIDDEN_AXIS, OBJECTS_AXIS = "mean hidden share [%]", "objects N"
SCALE_AXIS = "gain of the learned policy [% of what the best heuristic earns above FINISH at once]"
SMALL = 8.0


class Panel(NamedTuple):
    """One world of the map, and where it stands in the figure."""

    row: int
    column: int
    place: Place
    """Its world; its clutter means nothing."""
    title: str


def draw_map(design: ClutterDesign, world: WorldConfig, table: pd.DataFrame, title: str) -> Figure:
    """Draw a panel for each world, in it a field for each clutter."""
    panels = _panels(design, world)
    num_rows = 1 + max(panel.row for panel in panels)
    last = max(panel.column for panel in panels)
    height = HEAD_INCHES + FOOT_INCHES + num_rows * ROW_INCHES
    figure = Figure(figsize=(WIDTH_INCHES, height))
    top = write_title(figure, title)
    grid = figure.add_gridspec(
        num_rows,
        last + 2,
        left=0.06,
        right=0.99,
        bottom=FOOT_INCHES / height,
        top=top - 0.52 / height,
        hspace=0.32,
        wspace=0.08,
        width_ratios=[1.0] * last + [GAP, 1.0],
    )
    for panel in panels:
        axes = figure.add_subplot(grid[panel.row, panel.column + (panel.column == last)])
        is_lowest = not any(other.column == panel.column and other.row > panel.row for other in panels)
        _draw_panel(axes, table, design, panel, is_left=panel.column in (0, last), is_lowest=is_lowest)
        if panel.row == 0 and panel.column in (0, last):
            write_above(axes, HEADS[panel.column == last], 19.0)
    _draw_scale(figure, design.worthwhile_share, height)
    _explain_marks(figure, design.worthwhile_share, height)
    return figure


def _panels(design: ClutterDesign, world: WorldConfig) -> list[Panel]:
    """Quality of labels by cost of washing a clean cup; and in a column of its own, the spread of grip offsets."""
    costs = sorted(design.wash_clean_rewards, reverse=True)
    own = Place.of(world)
    panels = []
    for row, gain in enumerate(sorted(design.label_gains)):
        for column, reward in enumerate(costs):
            place = replace(own, label_gain=gain, reward_wash_clean=reward)
            words = f"labels {_percent(float(assumed_laws(world)[1].floor) + gain)} %, cost {amount(-reward, 0)}"
            panels.append(Panel(row, column, place, words))
    for row, spread in enumerate(sorted(design.grip_offset_stds)):
        panels.append(Panel(row, len(costs), replace(own, grip_offset_std=spread), f"spread {spread:g}"))
    return [panel._replace(title=f"{panel.title}{' (default)' if panel.place == own else ''}") for panel in panels]


def _draw_panel(
    axes: Axes, table: pd.DataFrame, design: ClutterDesign, panel: Panel, *, is_left: bool, is_lowest: bool
) -> None:
    """Draw one world: N upwards, occlusion to the right, and in each field the share and the verdict's mark."""
    sizes, occlusions = sorted(design.num_objects), sorted(design.occlusions)
    fixed = {name: value for name, value in asdict(panel.place).items() if name in FACTORS[2:]}
    is_here = np.logical_and.reduce([np.isclose(table[name], value) for name, value in fixed.items()])
    rows = table[is_here].set_index(["num_objects", "occlusion"])
    shares = np.array([[rows.loc[(n, occlusion), "gain_share"] for occlusion in occlusions] for n in sizes], float)
    beyond = np.clip(shares - design.worthwhile_share, 1.01 * STEPS[0], 1.01 * STEPS[-1])
    axes.pcolormesh(np.ma.masked_invalid(beyond), cmap=COLOURS, norm=_norm(), edgecolors="white", linewidth=1.0)
    for y, n in enumerate(sizes):
        for x, occlusion in enumerate(occlusions):
            verdict = str(rows.loc[(n, occlusion), "verdict"])
            _write_field(axes, x, y, float(shares[y, x]), verdict, abs(float(beyond[y, x])) >= DARK)
    axes.set_title(panel.title, loc="left", fontsize=SMALL, pad=3.0)
    axes.set_xticks(np.arange(len(occlusions)) + 0.5, [_percent(each) for each in occlusions] if is_lowest else [])
    axes.set_yticks(np.arange(len(sizes)) + 0.5, [str(n) for n in sizes] if is_left else [])
    axes.tick_params(length=0, labelsize=SMALL)
    axes.spines[:].set_visible(False)
    if is_lowest:
        axes.set_xlabel(HIDDEN_AXIS, fontsize=SMALL)
    if is_left:
        axes.set_ylabel(OBJECTS_AXIS, fontsize=SMALL)


def _write_field(axes: Axes, x: int, y: int, share: float, verdict: str, is_dark: bool) -> None:
    number = MISSING if np.isnan(share) else amount(100 * share, 0)
    axes.text(
        x + 0.5,
        y + 0.5,
        f"{MARKS[verdict]} {number}".strip(),
        ha="center",
        va="center",
        fontsize=SMALL,
        fontweight="bold" if verdict == LEARN else "normal",
        color="white" if is_dark else INK,
    )


def _norm() -> BoundaryNorm:
    return BoundaryNorm(STEPS, matplotlib.colormaps[COLOURS].N, extend="both")


def _draw_scale(figure: Figure, worthwhile_share: float, height: float) -> None:
    axes = figure.add_axes((0.06, 0.52 / height, 0.93, 0.11 / height))
    bar: Any = figure.colorbar(
        ScalarMappable(_norm(), COLOURS), cax=axes, orientation="horizontal", spacing="uniform", extendfrac=0.06
    )
    bar.set_ticks(STEPS, labels=[amount(100 * (step + worthwhile_share), 0) for step in STEPS])
    bar.ax.tick_params(length=2, labelsize=SMALL)
    bar.ax.set_title(SCALE_AXIS, loc="left", fontsize=SMALL, pad=3.0)


def _explain_marks(figure: Figure, worthwhile_share: float, height: float) -> None:
    bound = f"{_percent(worthwhile_share)} %"
    words = (
        f"{MARKS[LEARN]} learn: the 95 % interval lies above {bound}      "
        f"{MARKS[UNDECIDED]} inconclusive: it covers {bound}      "
        f"no mark: the heuristic is good enough, it lies below {bound}"
    )
    figure.text(0.06, 0.12 / height, words, fontsize=SMALL, va="bottom")


def _percent(share: float) -> str:
    return f"{100 * share:.3g}"
