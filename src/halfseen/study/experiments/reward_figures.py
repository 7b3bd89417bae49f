"""Figure 1, what is learned from logs of growing size beside all others; and the picture that the report opens with."""

import textwrap
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfseen.figures import BAND_OPACITY, WIDTH_INCHES, EndLabel, draw_curve, draw_zero, write_title
from halfseen.study import figures
from halfseen.study.compare import row_of, three, where
from halfseen.study.experiment import Drawing, words
from halfseen.study.experiments.reward_repetition import RewardRepetition
from halfseen.study.figures import INTERVAL
from halfseen.study.policies import BEST, FITTED_ONE_STEP, FITTED_RULE, HEURISTICS, LEARNED, LINEAR, ONE_STEP, Contender
from halfseen.study.setting import Setting
from halfseen.wording import INCONCLUSIVE, SUPPORTED, Claim, amount, share_in_words, significant

GAIN = three("gain")
GAIN_AXIS = "the same above what the strongest heuristic earns, which knows the true laws, on the same episodes"
DODGE = 1.02  # factor between neighbouring curves, which stand side by side rather than on one another
PLAIN = ("greedy", "history")  # rules of thumb that do not count what a wrong WASH costs


class Figure1:
    """Rewards above; below what those that come near one another earn above the strongest heuristic."""

    def __init__(self, design: RewardRepetition, table: pd.DataFrame, times_ms: Mapping[str, float]) -> None:
        self.design, self.table = design, table
        self.best = [design.contenders[str(row_of(table, role=role)["policy"])] for role in BEST]
        self.ms = {name: f"  ({significant(value, 2)} ms)" for name, value in times_ms.items()}

    def draw(self, title: str) -> Figure:
        """Draw it under a title."""
        figure, sizes = Figure(figsize=(WIDTH_INCHES, 8.6)), self.design.num_trajectories
        top = write_title(figure, title) - 0.045
        upper, lower = figures.two_panels(figure, top, 0.065, 0.50, 0.06, 0.085, lower_share=0.62)
        for axes, name, draw in ((upper, figures.REWARD_AXIS, self._rewards), (lower, GAIN_AXIS, self._gains)):
            figures.finish_by_size(axes, name, sizes, (1.08, 1.05), draw(axes))
        lower.set_xlabel(figures.TRAJECTORIES_AXIS)
        return figure

    def _rewards(self, axes: Axes) -> list[EndLabel]:
        """Learned with laws and without, the heuristics, and the strongest planner."""
        labels = self._levels(axes, [*(each.name for each in HEURISTICS), self.best[1].name], INTERVAL)
        if LINEAR.name in self.design.beside_names:
            labels.append(self._curve(axes, LINEAR, INTERVAL, "o"))
        rows = where(self.table, policy=LEARNED.name, cut_share=self.design.table_cut_share)
        draw_curve(axes, rows["num_trajectories"], rows[INTERVAL], color=LEARNED.colour, marker="s")
        return [*labels, self._label(LEARNED, float(rows["mean_reward"].iloc[-1]), is_bold=True)]

    def _gains(self, axes: Axes) -> list[EndLabel]:
        """Learned by share of cuts; with fitted laws and with the true ones, one step ahead and to the end."""
        draw_zero(axes, self.best[0].colour, 1.5)
        labels = [self._label(self.best[0], 0.0, is_bold=True)]
        labels += self._levels(axes, [*self.design.planner_names, ONE_STEP.name], GAIN)
        for who, marker in ((self.design.peer, "X"), (FITTED_ONE_STEP, "P"), (FITTED_RULE, "v")):
            labels.append(self._curve(axes, who, GAIN, marker))
        shares, ms = self.design.cut_shares, self.ms[LEARNED.name]
        return labels + figures.draw_by_cut_share(axes, self.table, shares, GAIN, draw_curve, DODGE, ms)

    def _levels(self, axes: Axes, names: Sequence[str], columns: list[str]) -> list[EndLabel]:
        """Draw what learns nothing as lines, with bands for the strongest."""
        labels = []
        for name in names:
            who, is_best = self.design.contenders[name], name in [each.name for each in self.best]
            value, low, high = (float(row_of(self.table, policy=name)[column]) for column in columns)
            labels.append(figures.draw_level(axes, who, value, is_best, self.ms[name]))
            if is_best:
                axes.axhspan(low, high, color=who.colour, alpha=BAND_OPACITY, linewidth=0, zorder=1)
        return labels

    def _curve(self, axes: Axes, who: Contender, columns: list[str], marker: str) -> EndLabel:
        """Draw what is made of logs, the mean over the proportions of cut trajectories."""
        means = where(self.table, policy=who.name, cut_share=None)
        look: dict[str, Any] = {"color": who.colour, "marker": marker, "linestyle": (0, who.dashes)}
        draw_curve(axes, means["num_trajectories"], means[columns], **look)
        return self._label(who, float(means[columns[0]].iloc[-1]))

    def _label(self, who: Contender, end: float, is_bold: bool = False) -> EndLabel:
        return EndLabel(end, f"{who.label}  {amount(end)}{self.ms[who.name]}", who.colour, is_bold)


def opening_of(design: RewardRepetition, setting: Setting, figure1: pd.DataFrame, rule: Claim) -> Drawing:
    """Draw what each way of clearing a table brings, and say whether learning is the better one.

    Points are counted above leaving a table as it is: what FINISH at once costs for the dirty objects left, in
    expectation. `rule` is the claim that the learned policy earns more than the strongest heuristic.
    """
    world, size, cut_share = setting.world, design.table_num_trajectories, design.table_cut_share
    num_objects = float(np.mean([scene.num_objects for scene in setting.scenes]))
    nothing = float(world.reward_dirty_left) * float(world.dirty_share) * num_objects
    bars = {
        "a plain rule of thumb": max(
            (row_of(figure1, policy=name) for name in PLAIN), key=lambda row: float(row["mean_reward"])
        ),
        "the best rule of thumb": row_of(figure1, role=BEST[0]),
        "learned from the runs": row_of(figure1, policy=LEARNED.name, num_trajectories=size, cut_share=cut_share),
        "plans ahead, with laws from the runs": row_of(
            figure1, policy=design.peer.name, num_trajectories=size, cut_share=None
        ),
        "plans ahead, and knows the true laws": row_of(figure1, role=BEST[1]),
    }
    table = pd.DataFrame(bars.values(), index=pd.Index(bars))
    points = table[INTERVAL].astype(float) - nothing
    colours = [design.contenders[name].colour for name in table["policy"]]
    theirs, ours = (amount(mean, 1) for mean in points["mean_reward"].iloc[1:3])
    how = {SUPPORTED: "better than", INCONCLUSIVE: "about as well as"}.get(rule.verdict, "worse than")
    sentence = (
        f"In simulation, a robot that learned from {size} old runs, {share_in_words(cut_share)} of them cut short, "
        f"clears a table {how} the best rule of thumb: {ours} points a table, against {theirs}."
    )
    return Drawing(
        "opening", "", sentence, words("reward", "opening", world=world), partial(_draw_bars, points, colours)
    )


def _draw_bars(points: pd.DataFrame, colours: Sequence[str], title: str) -> Figure:
    lines = textwrap.wrap(title, 62)
    figure = Figure(figsize=(7.2, 0.75 + 0.55 * len(points) + 0.26 * len(lines)), layout="constrained")
    axes = figure.add_subplot()
    beside: Any = {"xytext": (6, 0), "textcoords": "offset points", "va": "center", "fontsize": 13}
    for place, (mean, low, high) in enumerate(points.to_numpy().tolist()):
        axes.barh(place, mean, height=0.62, color=colours[place])
        for colour, width in (("white", 3.4), ("black", 1.2)):
            axes.plot([low, high], [place, place], color=colour, linewidth=width, solid_capstyle="butt")
        axes.annotate(amount(mean, 1), (max(high, mean), place), fontweight="bold", **beside)
    axes.set_yticks(range(len(points)), list(points.index), fontsize=12)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.22 * float(points[["mean_reward", "high"]].max(axis=None)))
    across = "points won on a table, above leaving it as it is; thin lines: 95 % intervals"
    axes.set_xlabel(across, fontsize=11, x=0.9, ha="right")
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    if title:
        figure.suptitle("\n".join(lines), x=0.012, ha="left", fontsize=13, fontweight="bold", linespacing=1.3)
    return figure
