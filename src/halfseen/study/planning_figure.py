"""Figures 2 and 3: reward against the time of a decision, and by planning horizon."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from halfseen.study.figures import (
    FAINT,
    HEURISTIC_COLOUR,
    INK,
    PANEL_TITLE,
    PLANNER_COLOUR,
    EndLabel,
    spread,
    write_end_labels,
    write_title,
)
from halfseen.study.findings import LEARNED
from halfseen.study.planning import HORIZON_PREFIX, SEARCH_PREFIX
from halfseen.study.planning_table import HEURISTIC_KIND, PLANNER_KIND
from halfseen.study.planning_words import figure2_title, figure3_title, milliseconds, policy_name
from halfseen.study.results import StudyResults
from halfseen.study.wording import amount

FIGURE2_INCHES = (9.0, 7.6)
FIGURE3_INCHES = (9.0, 4.4)
LEARNED_COLOUR = "#0072B2"
FAINT_PLANNER_COLOUR = "#8fc7b8"
DECISION_AXIS = "time of one decision, measured on one core [ms] (log scale)"
HORIZON_AXIS = "planning horizon [steps]"
REWARD_AXIS = "mean reward of a path, with 95 % intervals"
SIDE_BY_SIDE = 0.07
"""Least distance of the looks ahead, which take much the same time, in powers of ten."""
ROOM = 0.16
"""Left free at the foot of the axes for what is told of learning, as a share of their height."""


def figure2_for(results: StudyResults, is_titled: bool = True) -> Figure:
    """`figure2_of` for the results of a study."""
    return figure2_of(results.figure2, results.learning_s, results.design.table_num_paths, is_titled)


def figure3_for(results: StudyResults, is_titled: bool = True) -> Figure:
    """`figure3_of` for the results of a study."""
    return figure3_of(results.figure3, results.figure2, is_titled)


def figure2_of(figure2: pd.DataFrame, learning_s: float, num_paths: int, is_titled: bool = True) -> Figure:
    """Figure 2, to be made and drawn within `halfseen.study.figures.style`.

    Parameters
    ----------
    figure2
        Of `halfseen.study.planning_table.figure2`.
    learning_s
        Time that learning took, once [s].
    num_paths
        Logged paths that were learned from.
    is_titled
        Whether the title stands in the figure.
    """
    figure = Figure(figsize=FIGURE2_INCHES)
    top = write_title(figure, figure2_title(figure2) if is_titled else "", 92) - 0.095
    foot, gap = 0.075, 0.085
    upper_foot = foot + gap + 0.40 * (top - foot - gap)
    upper = figure.add_axes((0.07, upper_foot, 0.645, top - upper_foot))
    lower = figure.add_axes((0.07, foot, 0.645, upper_foot - gap - foot), sharex=upper)
    labels = _draw_lines(upper, figure2)
    _draw_planners(upper, figure2, "mean_reward", ("low", "high"))
    upper.set_title(REWARD_AXIS, **PANEL_TITLE)
    lower.axhline(0.0, color=LEARNED_COLOUR, linewidth=1.5, zorder=1.5)
    _draw_planners(lower, figure2, "over_cql", ("over_low", "over_high"))
    lower.set_title("reward over the learned policy's, on the same episodes, with 95 % intervals", **PANEL_TITLE)
    lower.set_xlabel(DECISION_AXIS)
    _mark_times(upper, figure2, learning_s)
    upper.tick_params(labelbottom=True)
    _tell_learning(upper, learning_s, num_paths)
    write_end_labels(upper, labels)
    handles, names = upper.get_legend_handles_labels()
    figure.legend(handles, names, loc="upper left", bbox_to_anchor=(0.05, top + 0.07), ncols=2, frameon=False)
    return figure


def figure3_of(figure3: pd.DataFrame, figure2: pd.DataFrame, is_titled: bool = True) -> Figure:
    """Figure 3, to be made and drawn within `halfseen.study.figures.style`.

    Parameters
    ----------
    figure3, figure2
        Of `halfseen.study.planning_table`; the second for the learned policy and the best heuristic.
    is_titled
        Whether the title stands in the figure.
    """
    figure = Figure(figsize=FIGURE3_INCHES)
    top = write_title(figure, figure3_title(figure3) if is_titled else "", 92)
    grid = figure.add_gridspec(1, 2, left=0.07, right=0.985, bottom=0.12, top=top - 0.18, wspace=0.16)
    left, right = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    _draw_bars(left, figure3, "planning_horizon", "mean_reward", ("low", "high"), PLANNER_COLOUR, "POMDP planner")
    heuristics = pd.DataFrame(figure2[figure2["kind"] == HEURISTIC_KIND])
    best = str(heuristics.loc[heuristics["mean_reward"].idxmax(), "policy"])
    for policy, colour, name in (
        (LEARNED, LEARNED_COLOUR, "learned policy"),
        (best, HEURISTIC_COLOUR, f"best heuristic ({policy_name(best)})"),
    ):
        reward = float(figure2.loc[figure2["policy"] == policy, "mean_reward"].iloc[0])
        left.axhline(reward, color=colour, linestyle=(0, (4, 2)), linewidth=1.5, zorder=1.2, label=name)
    left.set_title(REWARD_AXIS, **PANEL_TITLE)
    right.axhline(0.0, color=INK, linewidth=1.0, zorder=1.5)
    steps = pd.DataFrame(figure3[figure3["over_previous"].notna()])
    ends = ("over_previous_low", "over_previous_high")
    _draw_bars(right, steps, "planning_horizon", "over_previous", ends, PLANNER_COLOUR, "", is_joined=False)
    right.set_title("reward that one more step adds, with 95 % intervals", **PANEL_TITLE)
    horizons = figure3["planning_horizon"].to_numpy(dtype=float)
    for axes in (left, right):
        axes.set_xticks(horizons)
        axes.set_xlim(horizons.min() - 0.4, horizons.max() + 0.4)
        axes.set_xlabel(HORIZON_AXIS)
        _grid(axes)
    handles, names = left.get_legend_handles_labels()
    figure.legend(handles, names, loc="upper left", bbox_to_anchor=(0.05, top - 0.005), ncols=3, frameon=False)
    return figure


def _draw_lines(axes: Axes, figure2: pd.DataFrame) -> list[EndLabel]:
    """Draw the learned policy and the heuristics as points, and a faint line from each to its name."""
    labels = []
    for _, row in figure2[figure2["kind"] != PLANNER_KIND].iterrows():
        is_learned, reward = row["policy"] == LEARNED, float(row["mean_reward"])
        colour = LEARNED_COLOUR if is_learned else HEURISTIC_COLOUR
        axes.axhline(reward, color=colour, linestyle=(0, (4, 2)), linewidth=1.2 if is_learned else 0.7, zorder=1.2)
        axes.errorbar(
            [float(row["decision_ms"])],
            [reward],
            _reach(pd.DataFrame([row]), "mean_reward", ("low", "high")),
            color=colour,
            marker="D" if is_learned else "v",
            markersize=6.0,
            capsize=2.5,
            zorder=3,
        )
        labels.append(EndLabel(reward, f"{policy_name(str(row['policy']))}  {amount(reward)}", colour, is_learned))
    return labels


def _draw_planners(axes: Axes, figure2: pd.DataFrame, value: str, ends: tuple[str, str]) -> None:
    planners = pd.DataFrame(figure2[figure2["kind"] == PLANNER_KIND]).sort_values(by="decision_ms")
    is_search = planners["policy"].str.startswith(SEARCH_PREFIX)
    search, ahead = pd.DataFrame(planners[is_search]), pd.DataFrame(planners[~is_search])
    if not ahead.empty:
        powers = np.log10(ahead["decision_ms"].to_numpy(dtype=float)).tolist()
        ahead["decision_ms"] = 10.0 ** np.array(spread(powers, SIDE_BY_SIDE, -np.inf, np.inf))
        numbers = ahead["policy"].str.removeprefix(HORIZON_PREFIX).astype(int)
        label = f"POMDP, {_range(numbers.tolist())} steps ahead"
        _draw_bars(axes, ahead, "decision_ms", value, ends, FAINT_PLANNER_COLOUR, label, is_joined=False)
    if not search.empty:
        label = f"search to the end of the path, {_range(search['simulations'].tolist())} simulations"
        _draw_bars(axes, search, "decision_ms", value, ends, PLANNER_COLOUR, label)
    _grid(axes)


def _range(numbers: Sequence[int]) -> str:
    low, high = min(numbers), max(numbers)
    return f"{low}" if low == high else f"{low} to {high}"


def _draw_bars(
    axes: Axes,
    rows: pd.DataFrame,
    across: str,
    value: str,
    ends: tuple[str, str],
    colour: str,
    label: str,
    is_joined: bool = True,
) -> None:
    axes.errorbar(
        rows[across].to_numpy(dtype=float),
        rows[value].to_numpy(dtype=float),
        _reach(rows, value, ends),
        color=colour,
        marker="o" if is_joined else "s",
        linestyle="-" if is_joined else "none",
        elinewidth=1.4,
        capsize=2.5,
        zorder=2.5 if is_joined else 2.2,
        label=label or None,
    )


def _reach(rows: pd.DataFrame, value: str, ends: tuple[str, str]) -> Any:
    mean, low, high = (rows[name].to_numpy(dtype=float) for name in (value, *ends))
    return np.stack([mean - low, high - mean])


def _mark_times(axes: Axes, figure2: pd.DataFrame, learning_s: float) -> None:
    """Mark every power of ten on the axis of decision times."""
    times = [*figure2["decision_ms"].to_numpy(dtype=float), 1e3 * learning_s]
    axes.set_xscale("log")
    powers = np.arange(np.floor(np.log10(min(times))), np.ceil(np.log10(max(times))) + 1)
    axes.xaxis.set_major_locator(FixedLocator((10.0**powers).tolist()))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(lambda size, _: f"{size:g}")
    axes.set_xlim(min(times) / 1.7, max(times) * 1.7)


def _tell_learning(axes: Axes, learning_s: float, num_paths: int) -> None:
    """Tell the time of learning apart from decisions: a tick at the foot, where no reward is."""
    low, high = axes.get_ylim()
    axes.set_ylim(low - ROOM * (high - low), high)
    at = axes.get_xaxis_transform()
    axes.plot([1e3 * learning_s] * 2, [0.0, ROOM / 2], transform=at, color=LEARNED_COLOUR, linewidth=2.0)
    axes.annotate(
        f"learning, once, from {num_paths} paths: {milliseconds(1e3 * learning_s)} ms",
        (1e3 * learning_s, ROOM / 4),
        xycoords=at,
        xytext=(-5.0, 0.0),
        textcoords="offset points",
        ha="right",
        va="center",
        fontsize=8.5,
        color=LEARNED_COLOUR,
    )


def _grid(axes: Axes) -> None:
    axes.grid(axis="y", color=FAINT, linewidth=0.6, zorder=0)
    axes.set_axisbelow(True)
