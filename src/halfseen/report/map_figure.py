"""A map of a policy: what it would do, hatched where the log has few states, with what was done as dots."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from halfseen.pages.palette import INK
from halfseen.report.action_colours import colour_of
from halfseen.report.policy_map import PolicyMap

WIDTH_INCHES, MAP_INCHES, STRIP_INCHES = 3.1, 3.2, 1.15
ROW_INCHES = 0.26
TINT = 0.42
"""Of a colour in an area; the rest is white, so that dots of the same colour stand out."""


def draw_map(told: PolicyMap, colours: dict[str, str]) -> Figure:
    """Draw one stage; a strip where there is one covariate."""
    if told.up is None:
        return _draw_strip(told, colours)
    figure = Figure(figsize=(WIDTH_INCHES, MAP_INCHES))
    axes = figure.add_axes((0.2, 0.5 / MAP_INCHES, 0.765, 1.0 - 0.82 / MAP_INCHES))
    up = (float(told.up[0]), float(told.up[-1]))
    _draw_areas(axes, told, colours, up, told.taken, told.is_supported)
    for name in told.names:
        own = told.dots[told.done == name]
        _dot(axes, own[:, 0], own[:, 1], colours, name)
    axes.set_ylim(*up)
    axes.set_ylabel(told.covariates[1])
    axes.yaxis.set_major_locator(MaxNLocator(4))
    _finish(axes, told)
    return figure


def _draw_strip(told: PolicyMap, colours: dict[str, str]) -> Figure:
    done = [name for name in colours if name in set(told.done)]
    others = [name for name in told.names if name in set(told.done) and name not in colours]
    rows = {name: place for place, name in enumerate([*done, *others])}
    height = STRIP_INCHES + ROW_INCHES * len(rows)
    figure = Figure(figsize=(2 * WIDTH_INCHES, height))
    axes = figure.add_axes((0.2, 0.5 / height, 0.765, 1.0 - 0.82 / height))
    _draw_areas(axes, told, colours, (-1.6, -0.6), told.taken, told.is_supported)
    for name, place in rows.items():
        own = told.dots[told.done == name]
        _dot(axes, own[:, 0], np.full(len(own), float(place)), colours, name)
    axes.set_ylim(len(rows) - 0.4, -1.75)
    axes.set_yticks([-1.1, *rows.values()], ["the policy", *rows])
    axes.tick_params(axis="y", length=0)
    _finish(axes, told)
    return figure


def _draw_areas(
    axes: Axes,
    told: PolicyMap,
    colours: dict[str, str],
    up: tuple[float, float],
    taken: np.ndarray,
    is_supported: np.ndarray,
) -> None:
    names = list(dict.fromkeys(taken.ravel().tolist()))
    tints = [tuple(TINT * part + 1.0 - TINT for part in to_rgba(colour_of(name, colours))[:3]) for name in names]
    codes = np.vectorize({name: code for code, name in enumerate(names)}.get)(taken)
    extent = (float(told.across[0]), float(told.across[-1]), *up)
    shown: Any = {"origin": "lower", "extent": extent, "aspect": "auto", "interpolation": "nearest", "zorder": 0}
    axes.imshow(codes, cmap=ListedColormap(tints), vmin=-0.5, vmax=len(names) - 0.5, **shown)
    if not is_supported.all():
        across = np.linspace(extent[0], extent[1], taken.shape[1])
        heights = np.linspace(*up, max(taken.shape[0], 2))
        lacking = np.broadcast_to(~is_supported, (len(heights), len(across))).astype(float)
        axes.contourf(across, heights, lacking, levels=[0.5, 1.5], colors="none", hatches=["////"], zorder=1)


def _dot(axes: Axes, across: np.ndarray, up: np.ndarray, colours: dict[str, str], name: str) -> None:
    axes.plot(across, up, "o", color=colour_of(name, colours), ms=4.2, mec="white", mew=0.5, zorder=3)


def _finish(axes: Axes, told: PolicyMap) -> None:
    axes.set_xlim(float(told.across[0]), float(told.across[-1]))
    axes.set_xlabel(told.covariates[0])
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.set_title(f"stage {told.stage}", loc="left", fontsize=10, fontweight="bold", color=INK)
