"""What policies learned from logs of ICU-Sepsis are worth, from the kept results of the benchmark of that name."""

import json

from matplotlib.figure import Figure

from halfseen.figures import BLUE, GREEN, INK, ORANGE, PINK, SOFT, draw_grid, mark_sizes
from pictures.picture import ROOT, plot
from pictures.style import LEGEND, figure

RESULTS = ROOT / "benchmarks" / "published" / "results" / "icu_sepsis.json"
SHOWN = {
    "informed": (INK, "--"),
    "ours": (BLUE, "-"),
    "CQL": (PINK, "-"),
    "BCQ": (ORANGE, "-"),
    "pessimistic VI": (GREEN, "-"),
}
PANELS = ("uncut", "half cut")


def draw_icu_sepsis() -> Figure:
    """Draw value by the number of trajectories, a line for each way of learning."""
    found = json.loads(RESULTS.read_text(encoding="utf-8"))
    made = figure(3.9)
    panels = made.subplots(1, 2, sharex=True, sharey=True)
    for axes, setting in zip(panels, PANELS, strict=True):
        draw_grid(axes)
        axes.set_title(setting, loc="left", fontsize=9.5)
        axes.set_xlabel("trajectories")
        rows = [row for row in found["rows"] if row["setting"] == setting]
        sizes = [row["size"] for row in rows]
        for name, (color, style) in SHOWN.items():
            values, errors = ([row[what][name] for row in rows] for what in ("mean", "error"))
            axes.errorbar(sizes, values, errors, label=name, color=color, ls=style, marker="o", ms=3.5, lw=1.6)
        axes.axhline(found["exact"]["expert"], color=SOFT, ls="--", lw=1.0)
        axes.text(sizes[-1], found["exact"]["expert"], "expert", fontsize=8.0, va="bottom", ha="right")
        mark_sizes(axes, [sizes[0], sizes[1], sizes[-1]])
    panels[0].set_ylabel("share that survives")
    made.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, **LEGEND)
    return made


ICU_SEPSIS = plot("icu-sepsis", draw_icu_sepsis)
