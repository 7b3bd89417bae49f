"""Figure 1: what is learned from logs of growing size, beside all others, with what a decision of each takes."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfseen.figures import (
    BAND_OPACITY,
    PANEL_TITLE,
    WIDTH_INCHES,
    EndLabel,
    draw_curve,
    draw_zero,
    mark_sizes,
    write_end_labels,
    write_title,
)
from halfseen.study.experiments.reward.design import RewardDesign
from halfseen.study.experiments.reward.tables import BEST
from halfseen.study.figures import MEAN, draw_by_cut_share, draw_level
from halfseen.study.frames import row_of, where
from halfseen.study.policies import FITTED_ONE_STEP, FITTED_RULE, HEURISTICS, LEARNED, LINEAR, ONE_STEP, Contender
from halfseen.study.wording import REWARD_AXIS, TRAJECTORIES_AXIS
from halfseen.wording import amount, significant

GAIN = ["gain", "gain_low", "gain_high"]
GAIN_AXIS = "the same above what the strongest heuristic earns, which knows the true laws, on the same episodes"
DODGE = 1.02
"""Factor between neighbouring curves, which stand side by side rather than on one another."""
_HEIGHT_IN, _MARGINS = 8.6, (1.08, 1.05)
_LEFT, _WIDTH, _FOOT, _GAP = 0.065, 0.50, 0.06, 0.085
_LOWER = 0.62
"""Share of the height that the lower panel takes."""

Times = Mapping[str, float]
"""Decision time of each policy [ms]."""


def draw_figure1(design: RewardDesign, figure1: pd.DataFrame, times_ms: Times, title: str) -> Figure:
    """Rewards above; below what those that come near one another earn above the strongest heuristic."""
    figure = Figure(figsize=(WIDTH_INCHES, _HEIGHT_IN))
    top = write_title(figure, title) - 0.045
    foot = _FOOT + _LOWER * (top - _FOOT - _GAP)
    upper = figure.add_axes((_LEFT, foot + _GAP, _WIDTH, top - foot - _GAP))
    lower = figure.add_axes((_LEFT, _FOOT, _WIDTH, foot - _FOOT), sharex=upper)
    for axes, name, draw in ((upper, REWARD_AXIS, _draw_rewards), (lower, GAIN_AXIS, _draw_gains)):
        labels = draw(axes, design, figure1, times_ms)
        mark_sizes(axes, design.num_trajectories)
        axes.set_xlim(min(design.num_trajectories) / _MARGINS[0], max(design.num_trajectories) * _MARGINS[1])
        axes.set_title(name, **PANEL_TITLE)
        write_end_labels(axes, labels)
    lower.set_xlabel(TRAJECTORIES_AXIS)
    return figure


def _draw_rewards(axes: Axes, design: RewardDesign, figure1: pd.DataFrame, times_ms: Times) -> list[EndLabel]:
    """Learned with laws and without, the heuristics, and the strongest planner."""
    planner = str(row_of(figure1, role=BEST[1])["policy"])
    labels = _levels(axes, design, figure1, [*(each.name for each in HEURISTICS), planner], MEAN, times_ms)
    if LINEAR.name in design.beside_names:
        labels.append(_curve(axes, LINEAR, figure1, MEAN, times_ms, "o"))
    rows = where(figure1, policy=LEARNED.name, cut_share=design.table_cut_share)
    draw_curve(axes, rows["num_trajectories"], rows[MEAN], color=LEARNED.colour, marker="s")
    end = float(rows["mean_reward"].iloc[-1])
    return [*labels, _label(LEARNED, LEARNED.label, end, times_ms, is_bold=True)]


def _draw_gains(axes: Axes, design: RewardDesign, figure1: pd.DataFrame, times_ms: Times) -> list[EndLabel]:
    """Learned by share of cuts; with fitted laws and with the true ones, one step ahead and to the end."""
    rule = design.contenders[str(row_of(figure1, role=BEST[0])["policy"])]
    draw_zero(axes, rule.colour, 1.5)
    labels = [_label(rule, rule.label, 0.0, times_ms, is_bold=True)]
    labels += _levels(axes, design, figure1, [*design.planner_names, ONE_STEP.name], GAIN, times_ms)
    for who, marker in ((design.peer, "X"), (FITTED_ONE_STEP, "P"), (FITTED_RULE, "v")):
        labels.append(_curve(axes, who, figure1, GAIN, times_ms, marker))
    learned = draw_by_cut_share(axes, figure1, design.cut_shares, GAIN, draw_curve, DODGE)
    return labels + [replace(label, text=f"{label.text}  ({_ms(LEARNED, times_ms)})") for label in learned]


def _levels(
    axes: Axes, design: RewardDesign, figure1: pd.DataFrame, names: list[str], columns: list[str], times_ms: Times
) -> list[EndLabel]:
    """Draw what learns nothing as lines, with bands for the strongest."""
    labels = []
    for name in names:
        row, who = row_of(figure1, policy=name), design.contenders[name]
        is_best = row["role"] in BEST
        label = draw_level(axes, who, float(row[columns[0]]), is_best)
        labels.append(replace(label, text=f"{label.text}  ({_ms(who, times_ms)})"))
        if is_best:
            axes.axhspan(row[columns[1]], row[columns[2]], color=who.colour, alpha=BAND_OPACITY, linewidth=0, zorder=1)
    return labels


def _curve(
    axes: Axes, who: Contender, figure1: pd.DataFrame, columns: list[str], times_ms: Times, marker: str
) -> EndLabel:
    """Draw what is made of logs, the mean over the proportions of cut trajectories."""
    rows = where(figure1, policy=who.name)
    means = pd.DataFrame(rows[rows["cut_share"].isna()])
    dashes: Any = (0, who.dashes)
    draw_curve(axes, means["num_trajectories"], means[columns], color=who.colour, marker=marker, linestyle=dashes)
    return _label(who, who.label, float(means[columns[0]].iloc[-1]), times_ms)


def _label(who: Contender, name: str, end: float, times_ms: Times, is_bold: bool = False) -> EndLabel:
    return EndLabel(end, f"{name}  {amount(end)}  ({_ms(who, times_ms)})", who.colour, is_bold)


def _ms(who: Contender, times_ms: Times) -> str:
    return f"{significant(times_ms[who.name], 2)} ms"
