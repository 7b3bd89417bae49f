"""Figures 2 and 3: reward of planners by simulations and by planning horizon."""

from collections.abc import Mapping

import pandas as pd
from matplotlib.figure import Figure

from halfseen.pages.axes import (
    PANEL_TITLE,
    WIDTH_INCHES,
    EndLabel,
    draw_bars,
    draw_grid,
    draw_zero,
    mark_sizes,
    named_curves,
    write_end_labels,
    write_legend,
    write_title,
)
from halfseen.pages.numbers import amount
from halfseen.pages.palette import PLANNER
from halfseen.study.figures import MEAN, Level, draw_levels
from halfseen.study.frames import records, row_of
from halfseen.study.policies import HEURISTICS, LEARNED, Contender, Kind
from halfseen.study.wording import REWARD_AXIS

OVER = [f"over_{LEARNED.name}", "over_low", "over_high"]
STEP = ["over_previous", "over_previous_low", "over_previous_high"]
SIMULATIONS_AXIS = "simulations a decision, to the end of the path (log scale)"
HORIZON_AXIS = "planning horizon [steps]"


def draw_simulations(figure2: pd.DataFrame, title: str) -> Figure:
    """Reward of planners by simulations above, the difference from the learned policy below."""
    figure = Figure(figsize=(WIDTH_INCHES, 7.2))
    top, foot, gap = write_title(figure, title) - 0.06, 0.075, 0.085
    upper_foot = foot + gap + 0.40 * (top - foot - gap)
    upper = figure.add_axes((0.07, upper_foot, 0.61, top - upper_foot))
    lower = figure.add_axes((0.07, foot, 0.61, upper_foot - gap - foot), sharex=upper)
    rows = pd.DataFrame(figure2[figure2["simulations"].notna()])
    rewards = {who: float(row_of(figure2, policy=who.name)["mean_reward"]) for who in (LEARNED, *HEURISTICS)}
    labels = draw_levels(upper, [Level(who, reward, who.kind == Kind.LEARNED) for who, reward in rewards.items()])
    end = float(rows["mean_reward"].iloc[-1])
    labels.append(EndLabel(end, f"POMDP planner  {amount(end)}", PLANNER, is_bold=True))
    draw_bars(upper, rows["simulations"], rows[MEAN], color=PLANNER, marker="o")
    draw_zero(lower, LEARNED.colour, 1.5)
    draw_bars(lower, rows["simulations"], rows[OVER], color=PLANNER, marker="o")
    upper.set_title(REWARD_AXIS, **PANEL_TITLE)
    lower.set_title("reward over the learned policy’s, on the same episodes", **PANEL_TITLE)
    lower.set_xlabel(SIMULATIONS_AXIS)
    sizes = rows["simulations"].tolist()
    for axes in (upper, lower):
        mark_sizes(axes, sizes)
    upper.set_xlim(min(sizes) / 1.4, max(sizes) * 1.4)
    write_end_labels(upper, labels)
    return figure


def draw_horizons(
    contenders: Mapping[str, Contender], figure2: pd.DataFrame, figure3: pd.DataFrame, title: str
) -> Figure:
    """Reward by planning horizon at the left, what one more step gains at the right."""
    figure = Figure(figsize=(WIDTH_INCHES, 4.4))
    top = write_title(figure, title)
    grid = figure.add_gridspec(1, 2, left=0.07, right=0.985, bottom=0.12, top=top - 0.18, wspace=0.16)
    left, right = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    horizons, steps = figure3["planning_horizon"].to_numpy(), figure3.iloc[1:]
    draw_bars(left, horizons, figure3[MEAN], color=PLANNER, marker="o", label="POMDP planner")
    best = max(records(figure2, kind=str(Kind.HEURISTIC)), key=lambda row: row["mean_reward"])["policy"]
    for who in (LEARNED, contenders[best]):
        mean = float(row_of(figure2, policy=who.name)["mean_reward"])
        left.axhline(mean, color=who.colour, linestyle=(0, who.dashes), linewidth=1.5, zorder=1.2, label=who.label)
    left.set_title(REWARD_AXIS, **PANEL_TITLE)
    draw_zero(right)
    draw_bars(right, steps["planning_horizon"], steps[STEP], color=PLANNER, marker="o", linestyle="none")
    right.set_title("reward that one more step gains", **PANEL_TITLE)
    for axes in (left, right):
        axes.set_xticks(horizons)
        axes.set_xlim(horizons.min() - 0.4, horizons.max() + 0.4)
        axes.set_xlabel(HORIZON_AXIS)
        draw_grid(axes)
    write_legend(figure, named_curves(left), top - 0.005)
    return figure
