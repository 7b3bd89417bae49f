"""The first figure of Goldberg and Kosorok, on its axes, from the kept results of the benchmark of that name."""

import json

import numpy as np
from matplotlib.figure import Figure

from halfseen.figures import BLUE, GREEN, INK, ORANGE, PINK, SOFT, draw_grid, mark_sizes
from pictures.picture import ROOT, plot
from pictures.style import LEGEND, figure

RESULTS = ROOT / "benchmarks" / "published" / "results" / "goldberg_kosorok.json"
SHOWN = {"eq. 3, linear": "the paper's: eq. 3, linear", "default": "the default"}
COLOURS = {0.0: INK, 0.1: BLUE, 0.2: PINK, 0.3: GREEN, 0.5: ORANGE}


def draw_goldberg_kosorok() -> Figure:
    """Draw expected survival by the number of patients, a line for each share of cuts."""
    found = json.loads(RESULTS.read_text(encoding="utf-8"))
    made = figure(3.9)
    panels = made.subplots(1, 2, sharex=True, sharey=True)
    for axes, (method, title) in zip(panels, SHOWN.items(), strict=True):
        draw_grid(axes)
        axes.set_title(title, loc="left", fontsize=9.5)
        axes.set_xlabel("patients")
        for share in dict.fromkeys(row["share"] for row in found["rows"]):
            rows = [row for row in found["rows"] if row["share"] == share]
            values = np.array([row["values"][method] for row in rows])
            error = values.std(axis=1, ddof=1) / np.sqrt(values.shape[1])
            line = {"color": COLOURS[share], "marker": "o", "ms": 3.5, "lw": 1.6, "capsize": 2.0}
            sizes = [row["size"] for row in rows]
            axes.errorbar(sizes, values.mean(axis=1), error, label=f"{share:.0%} cut", **line)
        for name in ("optimum", "B B B"):
            axes.axhline(found["plain"][name], color=SOFT, ls="--", lw=1.0)
            axes.text(sizes[0], found["plain"][name], name, fontsize=8.0, va="bottom")
        mark_sizes(axes, sizes[::2])
    panels[0].set_ylabel("expected survival [months]")
    made.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, **LEGEND)
    return made


PUBLISHED = plot("goldberg-kosorok", draw_goldberg_kosorok)
