"""Intervals of the value of a policy whose value is known: those of forty logs of the pick cell."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from halfseen.figures import ALARM, BLUE, INK
from pictures.examples import importable
from pictures.picture import Numbers, Row, Table, plot
from pictures.style import panel

importable("pick_cell")


NUM_INTERVALS, NUM_TRAJECTORIES, FIRST_SEED = 40, 400, 5000


def _interval(index: int) -> Row:
    """The interval for the cell's rule of thumb, from one log of parts, and what that rule is worth in truth."""
    from cell_optimum import policy_value
    from cell_parts import ACTIONS_ALL, HORIZON
    from cell_trajectories import rule_of_thumb, simulate

    from halfseen.evaluation import evaluate
    from halfseen.policies import Rule

    names = np.array(ACTIONS_ALL, dtype=object)
    rule = Rule(lambda parts, stage: names[rule_of_thumb(parts, stage)], tuple(ACTIONS_ALL), HORIZON)
    found = evaluate(rule, simulate(NUM_TRAJECTORIES, FIRST_SEED + index), against="logging").doubly_robust
    return {"value": found.value, "low": found.low, "high": found.high, "truth": policy_value(rule_of_thumb)}


def _intervals() -> Table:
    return [_interval(index) for index in range(NUM_INTERVALS)]


def draw_intervals(rows: Table) -> Figure:
    """Draw intervals, one for each log, across the true value."""
    made, axes = panel(3.8, "mean reward of a part under the rule of thumb", has_grid=False)
    num_held = 0
    for place, row in enumerate(rows):
        is_held = row["low"] <= row["truth"] <= row["high"]
        num_held += is_held
        colour = BLUE if is_held else ALARM
        axes.plot([row["low"], row["high"]], [place, place], color=colour, lw=2.0, solid_capstyle="butt")
        axes.plot(row["value"], place, "o", color=colour, ms=3.5)
    axes.axvline(rows[0]["truth"], color=INK, ls="--", lw=1.3)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_ylabel(f"{len(rows)} logs of {NUM_TRAJECTORIES} parts")
    axes.set_title(f"{num_held} of {len(rows)} intervals hold the truth, dashed", loc="left", fontsize=9.5)
    return made


def _some() -> Mapping[int, Row]:
    return {index: _interval(index) for index in (0, 1)}


INTERVALS = plot("intervals", draw_intervals, Numbers("intervals.csv", _intervals, _some))
