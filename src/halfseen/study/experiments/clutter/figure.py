"""The map as a figure: how much learning gains over the best heuristic, over clutter, in each world."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure

from halfseen.figures import GAINS, INK, WIDTH_INCHES, write_above, write_title
from halfseen.study.experiment import Setting
from halfseen.study.experiments.clutter.places import FACTORS, ClutterDesign, Place, label_number, label_share
from halfseen.study.experiments.clutter.table import ENOUGH, LEARN, NO_SCALE, UNDECIDED
from halfseen.wording import MISSING, amount
from halfseen.world.config import WorldConfig

ROW_INCHES, HEAD_INCHES, FOOT_INCHES = 1.42, 0.75, 1.25
GAP = 0.28
"""Between the two blocks, in widths of a panel."""
STEPS = np.array([-0.25, -0.15, -0.10, -0.05, 0.0, 0.05, 0.10, 0.15, 0.25])
"""Bounds of the colours, as distances from the share that is worth the trouble."""
DARK = 0.15
"""Distance from which on a field is so dark that its number is written in white."""
MARKS = {LEARN: "▲", UNDECIDED: "?", ENOUGH: "", NO_SCALE: ""}
LABEL_NAMES = {"gain": "labels", "facing": "shown"}
LABEL_HEADS = {"gain": "share of right labels", "facing": "surface that a look shows"}
HIDDEN_AXIS, OBJECTS_AXIS = "mean hidden share [%]", "objects N"
SCALE_AXIS = "gain of the learned policy [% of what the best heuristic earns above FINISH at once]"
SMALL = 8.0


def draw_map(design: ClutterDesign, setting: Setting, table: pd.DataFrame, title: str) -> Figure:
    """Draw a panel for each world, in it a field for each clutter."""
    columns = _columns(design, setting)
    by_labels = f"{LABEL_HEADS[label_number(setting.world)]} (down) and cost of washing a clean cup (across)"
    heads = by_labels, "spread of grip offsets" if setting.law is None else "spread of grips, and laws"
    num_rows = max(len(panels) for panels in columns)
    height = HEAD_INCHES + FOOT_INCHES + num_rows * ROW_INCHES
    figure = Figure(figsize=(WIDTH_INCHES, height))
    top, bottom = write_title(figure, title) - 0.52 / height, FOOT_INCHES / height
    widths = [1.0] * (len(columns) - 1) + [GAP, 1.0]
    grid = figure.add_gridspec(num_rows, len(widths), width_ratios=widths, hspace=0.32, wspace=0.08)
    grid.update(left=0.06, right=0.99, bottom=bottom, top=top)
    for column, panels in enumerate(columns):
        is_last = panels is columns[-1]
        is_left = column == 0 or is_last
        for row, (words, here) in enumerate(panels.items()):
            axes = figure.add_subplot(grid[row, column + is_last])
            _draw_panel(axes, table, design, here, is_left=is_left, is_lowest=row == len(panels) - 1)
            default = " (default)" if here == Place.of(setting.world) else ""
            axes.set_title(f"{words}{default}", loc="left", fontsize=SMALL, pad=3.0)
            if row == 0 and is_left:
                write_above(axes, heads[is_last], 19.0)
    _draw_scale(figure, design.worthwhile_share, height)
    _explain_marks(figure, design.worthwhile_share, height)
    return figure


def _columns(design: ClutterDesign, setting: Setting) -> list[dict[str, Place]]:
    """Worlds by title: quality of labels by cost of washing a clean cup; last, the spread of grip offsets."""
    *by_cost, last = design.panels(setting)
    columns = [{_labelled(each, setting.world): each for each in panels} for panels in by_cost]
    return [*columns, {_spread(each): each for each in last}]


def _labelled(place: Place, world: WorldConfig) -> str:
    shown = _percent(label_share(place.labels, world))
    return f"{LABEL_NAMES[label_number(world)]} {shown} %, cost {amount(-place.reward_wash_clean, 0)}"


def _spread(place: Place) -> str:
    return "assumed laws" if place.is_assumed else f"spread {place.grip_offset_std:.3g}"


def _draw_panel(
    axes: Axes, table: pd.DataFrame, design: ClutterDesign, here: Place, *, is_left: bool, is_lowest: bool
) -> None:
    """Draw one world: N upwards, occlusion to the right, and in each field the share and the verdict's mark."""
    sizes, occlusions = sorted(design.num_objects), sorted(design.occlusions)
    same = [np.isclose(table[name], getattr(here, name)) for name in FACTORS[2:]]
    is_here = np.logical_and.reduce([*same, table["is_assumed"] == here.is_assumed])
    rows = table[is_here].set_index(["num_objects", "occlusion"])
    shares = rows["gain_share"].unstack().loc[sizes, occlusions].to_numpy(dtype=float)
    verdicts = rows["verdict"].unstack().loc[sizes, occlusions].to_numpy()
    beyond = np.clip(shares - design.worthwhile_share, 1.01 * STEPS[0], 1.01 * STEPS[-1])
    axes.pcolormesh(np.ma.masked_invalid(beyond), cmap=GAINS, norm=_norm(), edgecolors="white", linewidth=1.0)
    for y, x in np.ndindex(shares.shape):
        _write_field(axes, x, y, float(shares[y, x]), verdicts[y, x], abs(float(beyond[y, x])) >= DARK)
    axes.set_xticks(np.arange(len(occlusions)) + 0.5, [_percent(each) for each in occlusions] if is_lowest else [])
    axes.set_yticks(np.arange(len(sizes)) + 0.5, [str(n) for n in sizes] if is_left else [])
    axes.tick_params(length=0, labelsize=SMALL)
    axes.spines[:].set_visible(False)
    axes.set_xlabel(HIDDEN_AXIS if is_lowest else "", fontsize=SMALL)
    axes.set_ylabel(OBJECTS_AXIS if is_left else "", fontsize=SMALL)


def _write_field(axes: Axes, x: int, y: int, share: float, verdict: str, is_dark: bool) -> None:
    number = MISSING if np.isnan(share) else amount(100 * share, 0)
    weight, colour = "bold" if verdict == LEARN else "normal", "white" if is_dark else INK
    look: Any = {"ha": "center", "va": "center", "fontsize": SMALL, "fontweight": weight, "color": colour}
    axes.text(x + 0.5, y + 0.5, f"{MARKS[verdict]} {number}".strip(), **look)


def _norm() -> BoundaryNorm:
    return BoundaryNorm(STEPS, GAINS.N, extend="both")


def _draw_scale(figure: Figure, worthwhile_share: float, height: float) -> None:
    axes = figure.add_axes((0.06, 0.52 / height, 0.93, 0.11 / height))
    bar: Any = figure.colorbar(
        ScalarMappable(_norm(), GAINS), cax=axes, orientation="horizontal", spacing="uniform", extendfrac=0.06
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
