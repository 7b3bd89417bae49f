"""Figures of points with intervals, as declared: panels, in them layers of series, and the names of lines.

A figure has a ``size`` [inch], a ``grid`` that begins ``below`` its title, a ``shape`` unless its panels are one below
the other, a ``legend``, and ``panels``, each drawn once for each of the figure's ``facets``. A panel has a ``title``, a
name ``across``, a ``zero`` line, ticks at ``sizes`` on a logarithmic axis, whatever it shall ``set``, and ``layers``.

A layer has ``rows`` (an expression), ``y`` (the columns of a value and the ends of its interval, or how all three
begin), ``x`` (a column), and how to ``draw`` them: as a ``curve`` with a band, as ``bars``, as a plain ``line``, as a
``level`` across the panel, or as a ``name`` at its right end only. It may have a column of ``series`` and their order
``of``, drawn side by side by the factor ``dodge`` or the distance ``apart``.
"""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from halfseen import figures as pages
from halfseen.figures import BAND_OPACITY, MARKERS, EndLabel, learned_shades
from halfseen.study.compare import ends_of
from halfseen.wording import amount, share

Value = Callable[..., Any]  # evaluates an expression, with the columns of a row
Text = Callable[..., str]  # fills in a text
DRAW = {"curve": pages.draw_curve, "bars": pages.draw_bars, "line": Axes.plot}


def in_colour(look: dict[str, Any]) -> dict[str, Any]:
    """A look with its colour, which may be given by the name that it has in `halfseen.figures`."""
    colour = look.get("color")
    return look | {"color": getattr(pages, colour)} if isinstance(colour, str) and colour.isidentifier() else look


def looks_of(declared: Mapping[str, dict[str, Any]], contenders: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Looks of declared series, with markers in turn, and of contenders."""
    own = {
        key: {"marker": marker} | in_colour(look)
        for marker, (key, look) in zip(MARKERS, declared.items(), strict=False)
    }
    return own | {name: who.look for name, who in contenders.items()}


def shades(cut_shares: Sequence[float]) -> dict[float, dict[str, Any]]:
    """Looks of what is learned from logs with these proportions of cut trajectories, which are in order."""
    cut = ["no trajectory" if each == 0 else f"{share(each)} of the trajectories" for each in cut_shares]
    return {
        each: {"color": colour, "marker": marker, "label": f"learned, {trajectories} cut"}
        for each, trajectories, colour, marker in zip(cut_shares, cut, learned_shades(len(cut)), MARKERS, strict=False)
    }


def draw_figure(of: dict[str, Any], value: Value, text: Text, title: str) -> Figure:
    """Draw a declared figure under a title: each panel once for each of its facets, but where a facet is None."""
    figure, facets = Figure(figsize=value(of["size"])), value(of.get("facets", [{}]))
    begin = pages.write_title(figure, title)
    grid, top = {name: value(each) for name, each in of["grid"].items()}, begin - value(of["below"])
    if gap := grid.pop("gap", None):  # between two rows, as a fraction of the figure's height
        grid["hspace"] = 2.0 * gap / (top - grid["bottom"] - gap)
    shape = value(of.get("shape", (len(of["panels"]), len(facets))))
    panels = figure.add_gridspec(*shape, top=top, **grid).subplots(squeeze=False, **of.get("share", {})).ravel()
    for axes, (panel, facet) in zip(panels, product(of["panels"], facets), strict=True):
        if facet is None:
            axes.remove()
        else:
            _draw_panel(axes, panel, facet, value, text)
    if "up" in of:
        figure.supylabel(text(of["up"]), x=0.012, fontsize=8.5)
    if legend := dict(of.get("legend", {})):
        known, height = pages.named_curves(*panels[::-1]), begin - value(legend.pop("below"))
        names = [value("labels")[key] for key in legend.pop("of", [])]
        pages.write_legend(figure, {name: known[name] for name in names or known if name in known}, height, **legend)
    return figure


def _draw_panel(axes: Axes, panel: dict[str, Any], facet: dict[str, Any], value: Value, text: Text) -> None:
    if band := panel.get("band"):
        axes.axhspan(-band, band, color=pages.FAINT, alpha=0.5, linewidth=0, zorder=0.5)
    if "zero" in panel:
        pages.draw_zero(axes, *value(panel["zero"]))
    labels = [label for layer in panel["layers"] for label in _draw_layer(axes, layer, facet, value)]
    if "sizes" in panel:
        pages.mark_sizes(axes, [int(size) for size in value(panel["sizes"])])
    if "margins" in panel:
        sizes, (before, after) = value(panel["sizes"]), panel["margins"]
        axes.set_xlim(min(sizes) / before, max(sizes) * after)
    axes.set(**{name: value(each) for name, each in panel.get("set", {}).items()})
    if panel.get("is_share"):
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, 0))
    pages.draw_grid(axes)
    axes.tick_params(labelbottom=True)
    for words, points, weight in panel.get("above", []):
        pages.write_above(axes, text(words, facet), points, weight)
    axes.set_title(text(panel["title"], facet), **pages.PANEL_TITLE)
    axes.set_xlabel(text(panel.get("across", ""), facet))
    if "note" in panel:
        # In the upper right corner, with room made for it.
        note: Any = {"xycoords": "axes fraction", "ha": "right", "va": "top", "fontsize": 8.0}
        axes.annotate(text(panel["note"]), (0.98, 0.98), color=value(panel["note_colour"]), **note)
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.12 * (high - low))
    if "legend" in panel:
        axes.legend(frameon=False, fontsize=8.5, **panel["legend"])
    if panel.get("has_names"):
        pages.write_end_labels(axes, labels)


def _draw_layer(axes: Axes, layer: dict[str, Any], facet: dict[str, Any], value: Value) -> list[EndLabel]:
    """Draw the series of a layer, and return the names of their ends."""
    rows, y, series = value(layer["rows"], facet), layer["y"], layer.get("series")
    middle, *ends = y = ends_of(y)
    keys = value(layer["of"]) if "of" in layer else list(dict.fromkeys(rows[series])) if series else [None]
    looks, labels = value(layer.get("looks", "looks")), []
    for k, key in enumerate(keys):
        some = rows if series is None else rows[rows[series] == key]
        if some.empty:
            continue
        look, last = in_colour(looks.get(key, {}) | layer.get("look", {})), some.iloc[-1].to_dict()
        is_bold, height = bool(value(layer.get("bold", False), last)), float(last[middle])
        if layer["draw"] == "level":
            axes.axhline(height, **{"linestyle": "-", "linewidth": 1.5 if is_bold else 0.9, "zorder": 1.2} | look)
            if ends and is_bold:
                low, high = (float(last[end]) for end in ends)
                axes.axhspan(low, high, color=look["color"], alpha=BAND_OPACITY, linewidth=0, zorder=1)
        elif layer["draw"] != "name":
            place = k - (len(keys) - 1) / 2
            across = some[layer["x"]].to_numpy(dtype=np.float64) * layer.get("dodge", 1.0) ** place
            DRAW[layer["draw"]](axes, across + layer.get("apart", 0.0) * place, some[y], **look)
        more = value(layer.get("more", "''"), last)
        labels.append(EndLabel(height, f"{look.get('label')}  {amount(height)}{more}", look["color"], is_bold))
    return labels


def draw_named_bars(points: pd.DataFrame, colours: Sequence[str], across: str, title: str) -> Figure:
    """Draw values with their intervals, the columns of `INTERVAL`, as bars from 0, by name."""
    lines = textwrap.wrap(title, 62)
    figure = Figure(figsize=(7.2, 0.75 + 0.55 * len(points) + 0.26 * len(lines)), layout="constrained")
    axes = figure.add_subplot()
    beside: Any = {"xytext": (6, 0), "textcoords": "offset points", "va": "center", "fontsize": 13}
    for place, (mean, low, high) in enumerate(points.to_numpy().tolist()):
        axes.barh(place, mean, height=0.62, color=colours[place])
        for colour, width in (("white", 3.4), ("black", 1.2)):
            axes.plot([low, high], [place, place], color=colour, linewidth=width, solid_capstyle="butt")
        axes.annotate(amount(mean, 1), (max(high, mean), place), fontweight="bold", **beside)
    axes.set_yticks(range(len(points)), list(points.index), fontsize=12)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.22 * float(points[["mean_reward", "high"]].max(axis=None)))
    axes.set_xlabel(across, fontsize=11, x=0.9, ha="right")
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    if title:
        figure.suptitle("\n".join(lines), x=0.012, ha="left", fontsize=13, fontweight="bold", linespacing=1.3)
    return figure
