"""Medians of times that were cut, as the guide estimates them."""

import contextlib
import io

import numpy as np
from matplotlib.figure import Figure

from halfseen.figures import ALARM, BLUE, INK, ORANGE, SOFT
from pictures.guide_pages import names_after
from pictures.picture import Table, plot, whole
from pictures.style import LEGEND, panel


def _medians() -> Table:
    with contextlib.redirect_stdout(io.StringIO()):
        names = names_after("times-that-were-cut", 0)
    grid = np.linspace(0.0, 1.0, 21)[:, None]
    found: dict[str, list[float]] = {"clutter": grid[:, 0].tolist()}
    for censoring in ("none", "kaplan-meier", "cox"):
        median = names["CensoredSVR"](loss="absolute", target="log", censoring=censoring)
        median.fit(names["clutter"], names["survival_array"](names["end_s"], names["is_finished"]))
        found[censoring] = np.exp(median.predict(grid)).tolist()
    return [dict(zip(found, row, strict=True)) for row in zip(*found.values(), strict=True)]


def draw_medians(rows: Table) -> Figure:
    """Draw attempts, cut ones hollow, and the medians that are estimated from them beside the truth."""
    rng = np.random.default_rng(0)
    clutter = rng.uniform(size=(400, 1))
    time_s = np.exp(1.0 + clutter[:, 0] + 0.5 * rng.normal(size=400))
    cut_s = rng.exponential(20.0 * np.exp(-1.5 * clutter[:, 0]))
    end_s, is_finished = np.minimum(time_s, cut_s), time_s <= cut_s
    made, axes = panel(3.4, "clutter", "time until the grasp holds [s]")
    few = slice(0, 200)
    for is_it, look in (
        (is_finished[few], {"mfc": SOFT, "label": "held"}),
        (~is_finished[few], {"mfc": "w", "label": "cut"}),
    ):
        axes.plot(clutter[few, 0][is_it], end_s[few][is_it], "o", ms=3.2, mec=SOFT, mew=0.8, **look)
    across = [row["clutter"] for row in rows]
    for name, colour, label in (
        ("none", ALARM, "dropping what was cut"),
        ("kaplan-meier", ORANGE, "Kaplan–Meier weights"),
        ("cox", BLUE, "Cox weights"),
    ):
        axes.plot(across, [row[name] for row in rows], color=colour, lw=2.2, label=label)
    axes.plot(across, np.exp(1.0 + np.array(across)), "--", color=INK, lw=1.4, label="the true median")
    axes.set_ylim(0.0, 14.0)
    made.legend(loc="outside lower center", ncols=2, **LEGEND)
    return made


MEDIANS = plot("medians", draw_medians, whole("medians.csv", _medians))
