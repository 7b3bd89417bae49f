"""Figures of the numbers that pages of the guide print, which other tests hold against what made them."""

import re

import numpy as np
from matplotlib.figure import Figure

from halfseen.figures import BLUE, GREEN, INK, ORANGE, PINK, RED, SKY, SOFT, draw_grid, mark_sizes
from pictures.guide_pages import numbers_in, table_of, text_of
from pictures.picture import ROOT, plot
from pictures.style import LEGEND, figure, panel

SITUATIONS = {
    "independent": "cuts depend on nothing",
    "linear": "cuts rise with a covariate",
    "curved": "cuts at both ends of it",
    "unrecorded": "its cause was not recorded",
}


def draw_bias() -> Figure:
    """Draw the bias of each weighting where half of the attempts are cut, from the page's table."""
    head, *rows = table_of("which-censoring-model", "<!-- benchmarks/dependent_cuts.py -->")
    models = [row[0] for row in rows]
    made = figure(4.3)
    panels = made.subplots(2, 2, sharex=True, sharey=True)
    for axes, (name, text) in zip(panels.flat, SITUATIONS.items(), strict=True):
        bias, error, _ = np.array([numbers_in(row[head.index(name)]) for row in rows]).T
        colours = [RED if abs(one) > 3 * width else BLUE for one, width in zip(bias, error, strict=True)]
        for row, (one, width, colour) in enumerate(zip(bias, error, colours, strict=True)):
            axes.barh(row, one, 0.62, color=colour)
            axes.plot([one - 1.96 * width, one + 1.96 * width], [row, row], color=INK, lw=1.2)
        axes.axvline(0.0, color=INK, lw=1.0)
        axes.set_title(text, loc="left", fontsize=9.5)
        axes.set_yticks(range(len(models)), models)
        axes.tick_params(axis="y", length=0)
    panels[0, 0].invert_yaxis()
    made.supxlabel("bias of the mean time of an attempt [s]", fontsize=9.5)
    return made


LEARNERS = {
    "default": BLUE,
    "paper (linear, separate, Kaplan–Meier)": ORANGE,
    "d3rlpy CQL": PINK,
    "fitted Q, boosting": GREEN,
    "d3rlpy double DQN": SKY,
    "rule of thumb": SOFT,
}


def draw_learners() -> Figure:
    """Draw the share of the optimum that each learner reaches on the cell, by the size of the log."""
    head, *rows = table_of("how-good-is-it", "A part of it, by n and world")
    columns = [k for k, name in enumerate(head) if name.startswith("cell ")]
    sizes = [int(numbers_in(head[k])[0]) for k in columns]
    made, axes = panel(3.8, "trajectories of the log", "share of the optimum on the cell")
    for name, colour in LEARNERS.items():
        (row,) = (row for row in rows if row[0] == name)
        value, error = np.array([numbers_in(row[k]) for k in columns]).T
        width = 2.6 if name == "default" else 1.6
        axes.errorbar(sizes, value, error, color=colour, marker="o", lw=width, elinewidth=1.0, capsize=2.5)
        axes.plot([], [], color=colour, marker="o", lw=width, label=name.partition(" (")[0])
    mark_sizes(axes, sizes)
    made.legend(loc="outside lower center", ncols=2, **LEGEND)
    return made


def draw_calibration() -> Figure:
    """Draw how often the action that was said to be best was best, by what it was learned from."""
    _, *rows = table_of("planners", "this share was best")
    names = [row[0] for row in rows]
    near, sure = np.array([numbers_in(row[1]) for row in rows]).T
    made, axes = panel(2.9, "the log that Q was learned from", "share that was best")
    places = np.arange(len(rows))
    axes.bar(places - 0.2, near, 0.38, color=SKY, label="said to be best with about 0.9")
    axes.bar(places + 0.2, sure, 0.38, color=BLUE, label="with 0.95 or more")
    axes.axhline(0.9, color=INK, ls="--", lw=1.0)
    axes.set_xticks(places, [name.replace(" trajectories", "\ntrajectories") for name in names])
    axes.set_ylim(0.0, 1.04)
    made.legend(loc="outside upper left", ncols=2, **LEGEND)
    return made


def draw_push() -> Figure:
    """Draw what a PUSH of the object in front does to who is hidden, and what it adds to the reward."""
    page = text_of("another-verb")
    after, before = (float(number) for number in re.findall(r"after it was pushed: \[([\d.]+) ([\d.]+) *\]", page)[0])
    earned = int(re.findall(r"earns about (\d+) an episode", page)[0])
    without = int(re.findall(r"the same lines print (\d+)\.", page)[0])
    made = figure(2.7)
    hidden, reward = made.subplots(1, 2, width_ratios=[3, 2])
    places = np.arange(1, 5)
    hidden.bar(places - 0.2, np.full(4, before), 0.38, color=SOFT, label="before")
    hidden.bar(places + 0.2, np.full(4, after), 0.38, color=BLUE, label="after PUSH 0")
    hidden.set(xlabel="object", ylabel="hidden by object 0", ylim=(0.0, 1.25), xticks=places)
    hidden.legend(loc="upper left", ncols=2, columnspacing=0.8, **LEGEND)
    bars = reward.bar(["without\nPUSH", "with\nPUSH"], [without, earned], 0.6, color=[SOFT, BLUE])
    reward.bar_label(bars)
    reward.set(ylabel="reward an episode", ylim=(0.0, 1.15 * earned))
    draw_grid(hidden)
    return made


def draw_extras() -> Figure:
    """Draw which extra each command asks for, by the extras of the package."""
    import tomllib

    from halfseen.cli import VERBS

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [name for name in project["optional-dependencies"] if name not in ("all", "docs", "dev", "release")]
    asked = {verb: ASKS_FOR.get(verb, ()) for verb in VERBS}
    made, axes = panel(3.3, has_grid=False)
    for row, names in enumerate(asked.values()):
        axes.axhline(row, color="#e9e9e9", lw=0.8, zorder=0)
        if not names:
            axes.text(-0.45, row, "none", va="center", color=SOFT)
        for name in names:
            axes.plot(extras.index(name), row, "o", color=SKY if name in ON_DEMAND else BLUE, ms=9)
    axes.set_yticks(range(len(asked)), [f"halfseen {verb}" for verb in asked])
    axes.set_xticks(range(len(extras)), extras, rotation=60, ha="left", rotation_mode="anchor")
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set(xlim=(-0.6, len(extras) - 0.5), ylim=(len(asked) - 0.5, -0.6))
    return made


SHOWN_OF_TEAMS = {
    ("1", "rule"): "one robot: rule",
    ("1", "with laws"): "one robot: learned",
    ("2", "rule"): "two: rule",
    ("2", "with laws"): "two: learned",
    ("2", "one Q"): "two: one Q, without laws",
    ("2", "each alone"): "two: each alone, without laws",
}


def draw_teams() -> Figure:
    """Draw what one and two robots earn where a second costs .05, and the seconds that they take."""
    _, *rows = table_of("several-robots", "<!-- teams.py -->")
    made, axes = panel(2.7, "points above leaving the table, price of seconds included")
    for place, (key, name) in enumerate(SHOWN_OF_TEAMS.items()):
        (row,) = (each for each in rows if (each[0], each[1]) == key)
        points, error = numbers_in(row[2])
        axes.barh(place, points, 0.62, color=SOFT if "rule" in name else BLUE)
        axes.plot([points - 1.96 * error, points + 1.96 * error], [place, place], color=INK, lw=1.2)
        axes.text(0.3, place, f"{name}, {round(numbers_in(row[3])[0])} s", va="center", color="white", fontsize=9.0)
    axes.set_yticks([])
    axes.invert_yaxis()
    return made


ASKS_FOR = {
    "serve": ("serve", "opcua"),
    "export": ("onnx",),
    "watch": ("watch",),
    "report": ("study",),
    "convert": ("excel", "minari", "hdf5", "mcap", "ros", "sql", "stores"),
    "learn": ("stores",),
    "look": ("perception",),
    "simulate": ("perception",),
    "cell": ("scene", "ray", "dask"),
    "study": ("study", "ray", "dask"),
}
"""Command → the extras that it asks for, some of which hold others."""
ON_DEMAND = ("excel", "minari", "hdf5", "mcap", "ros", "sql", "ray", "dask", "stores", "opcua")
"""Extras that a format, an engine or a wire alone needs: pale dots."""

PICTURES = (
    plot("bias-of-weights", draw_bias),
    plot("learners", draw_learners),
    plot("said-to-be-best", draw_calibration),
    plot("push", draw_push),
    plot("extras", draw_extras),
    plot("several-robots", draw_teams),
)
