"""How often a policy of tables would do something to an object, by how dirty that seems and how much is hidden."""

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from halfseen.pages.palette import INK, OURS
from halfseen.report.table_map import TableMap

WIDTH_INCHES, HEIGHT_INCHES = 3.7, 3.2
DEEPENING = LinearSegmentedColormap.from_list("deepening", ["#f2f6fa", OURS, "#002c46"])


def draw_table_map(told: TableMap, verb: str) -> Figure:
    """Draw the cells of one verb; those of too few objects are hatched."""
    figure = Figure(figsize=(WIDTH_INCHES, HEIGHT_INCHES), layout="constrained")
    axes = figure.subplots()
    share = told.share[verb]
    axes.set_facecolor("white")
    across, up = told.chance_edges, told.hidden_edges
    ends = [(across[0], up[0]), (across[-1], up[0]), (across[-1], up[-1]), (across[0], up[-1])]
    axes.fill(*zip(*ends, strict=True), facecolor="none", hatch="////", linewidth=0.0, zorder=0)
    largest = max(float(np.nanmax(share)), 0.01)
    cells = axes.pcolormesh(across, up, np.ma.masked_invalid(share), cmap=DEEPENING, vmin=0.0, vmax=largest, zorder=1)
    bar = figure.colorbar(cells, ax=axes, shrink=0.9, format=PercentFormatter(1.0, decimals=0))
    bar.outline.set_visible(False)
    axes.set_xlabel("probability of being dirty")
    axes.set_ylabel("hidden share")
    axes.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.set_title(f"{verb} it next", loc="left", fontsize=10, fontweight="bold", color=INK)
    return figure
