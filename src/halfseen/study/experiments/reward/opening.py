"""What a reader sees first: one picture and one sentence, before any statistics.

Points are counted above leaving a table as it is: what FINISH at once costs for the dirty objects left, in expectation.
"""

import textwrap
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from halfseen.study.experiment import Drawing, Setting
from halfseen.study.experiments.reward.design import RewardDesign
from halfseen.study.experiments.reward.tables import BEST
from halfseen.study.frames import records, row_of, where
from halfseen.study.policies import LEARNED, Contender
from halfseen.wording import INCONCLUSIVE, SUPPORTED, Claim, amount, share_in_words

_WIDTH_IN, _BAR_IN = 7.2, 0.55
_LINE_IN, _TITLE_CHARS = 0.26, 62
PLAIN = ("greedy", "history")
"""Rules of thumb that do not count what a wrong WASH costs."""


class _Bar(NamedTuple):
    name: str
    who: Contender
    mean: float
    low: float
    high: float


def opening_of(design: RewardDesign, setting: Setting, figure1: pd.DataFrame, rule: Claim) -> Drawing:
    """Draw what each way of clearing a table brings, and say whether learning is the better one.

    Parameters
    ----------
    design, setting
        Of the experiment.
    figure1
        Its table.
    rule
        That the learned policy earns more than the strongest heuristic.
    """
    bars = _bars(design, figure1, _left_as_it_is(setting))
    world, few = (
        setting.world,
        f"{design.table_num_trajectories} old runs, {share_in_words(design.table_cut_share)} of them",
    )
    theirs, ours = (f"{amount(bar.mean, 1)}" for bar in bars[1:3])
    sentence = (
        f"In simulation, a robot that learned from {few} cut short, clears a table {_verdict(rule.verdict)} the best "
        f"rule of thumb: {ours} points a table, against {theirs}."
    )
    washed, spared = -world.reward_dirty_left + world.reward_wash_dirty, world.reward_wash_clean
    caption = (
        f"Points won on a table, above leaving it as it is: {amount(float(washed), 0)} for a dirty cup that is washed, "
        f"{amount(float(spared), 0)} for a clean one, and {amount(float(world.reward_lift_per_s), 1)} for each second "
        "that it takes to lift a cup and look behind it. The robot sees only part of each cup, and cannot know which "
        "are dirty; even the planner that knows how often looks and grasps fail wins only so much. Rules of thumb know "
        "that, too. A planner with laws from the runs: the mean over all proportions cut, as in Figure 1. Thin lines: "
        "95 % intervals."
    )
    return Drawing("opening", "", sentence, caption, partial(_draw, bars))


def _verdict(verdict: str) -> str:
    if verdict == SUPPORTED:
        return "better than"
    return "about as well as" if verdict == INCONCLUSIVE else "worse than"


def _left_as_it_is(setting: Setting) -> float:
    """Expected reward of FINISH at once, the mean over the tables."""
    num_objects = float(np.mean([scene.num_objects for scene in setting.scenes]))
    return float(setting.world.reward_dirty_left) * float(setting.world.dirty_share) * num_objects


def _bars(design: RewardDesign, figure1: pd.DataFrame, nothing: float) -> list[_Bar]:
    place = {"num_trajectories": design.table_num_trajectories, "cut_share": design.table_cut_share}
    rule, planner = (row_of(figure1, role=role) for role in BEST)
    plain = max((row_of(figure1, policy=name) for name in PLAIN), key=lambda row: float(row["mean_reward"]))
    peers = where(figure1, policy=design.peer.name, num_trajectories=design.table_num_trajectories)
    rows = (
        ("a plain rule of thumb", design.contenders[str(plain["policy"])], plain),
        ("the best rule of thumb", design.contenders[str(rule["policy"])], rule),
        ("learned from the runs", LEARNED, row_of(figure1, policy=LEARNED.name, **place)),
        (
            "plans ahead, with laws from the runs",
            design.peer,
            records(pd.DataFrame(peers[peers["cut_share"].isna()]))[0],
        ),
        ("plans ahead, and knows the true laws", design.contenders[str(planner["policy"])], planner),
    )
    return [
        _Bar(name, who, *(float(row[column]) - nothing for column in ("mean_reward", "low", "high")))
        for name, who, row in rows
    ]


def _draw(bars: list[_Bar], title: str) -> Figure:
    lines = textwrap.wrap(title, _TITLE_CHARS)
    height_in = 0.75 + _BAR_IN * len(bars) + _LINE_IN * len(lines)
    figure = Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")
    axes = figure.add_subplot()
    for place, bar in enumerate(bars):
        axes.barh(place, bar.mean, height=0.62, color=bar.who.colour)
        axes.plot([bar.low, bar.high], [place, place], color="white", linewidth=3.4, solid_capstyle="butt")
        axes.plot([bar.low, bar.high], [place, place], color="black", linewidth=1.2, solid_capstyle="butt")
        axes.annotate(
            amount(bar.mean, 1), (max(bar.high, bar.mean), place), xytext=(6, 0), textcoords="offset points",
            va="center", fontsize=13, fontweight="bold",
        )  # fmt: skip
    axes.set_yticks(range(len(bars)), [bar.name for bar in bars], fontsize=12)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.22 * max(max(bar.high, bar.mean) for bar in bars))
    axes.set_xlabel(
        "points won on a table, above leaving it as it is; thin lines: 95 % intervals", fontsize=11, x=0.9, ha="right"
    )
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    if title:
        figure.suptitle("\n".join(lines), x=0.012, ha="left", fontsize=13, fontweight="bold", linespacing=1.3)
    return figure
