"""Logs as pictures: single trajectories with their stages and cuts, and how long trajectories were watched."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfseen.figures import BLUE, GREEN, INK, ORANGE, PINK, RED, SKY, SOFT
from halfseen.logs import Logs, read_logs
from halfseen.logs.columns import CUT
from halfseen.logs.formats.steps import TRUNCATED, StepTable
from pictures.guide_pages import names_after
from pictures.picture import ROOT, plot
from pictures.style import LEGEND, panel

COLOURS = {
    "suction": BLUE,
    "parallel": ORANGE,
    "soft": GREEN,
    "hand over": PINK,
    "stop": SOFT,
    "WASH": BLUE,
    "LIFT": ORANGE,
    "FINISH": SOFT,
    "look": ORANGE,
    "pick": BLUE,
}
CAUSES = {
    "operator": RED,
    "sensor-lost": PINK,
    "emergency-stop": RED,
    "time-out": SKY,
    "battery": RED,
}


def draw_two_trajectories() -> Figure:
    """Draw the two trajectories that the page on logs writes down: what is known of each stage, and what is not."""
    logs = names_after("logs", 0)["logs"]
    made, axes = panel(2.3, "seconds since the trajectory began", has_grid=False)
    for height, trajectory in enumerate(logs.trajectories.itertuples()):
        began_s = 0.0
        for stage in logs.stages[logs.stages["trajectory"] == trajectory.trajectory].itertuples():
            is_seen = not pd.isna(stage.elapsed_s)
            end_s = stage.elapsed_s if is_seen else trajectory.end_s
            look: Any = {"color": COLOURS[stage.action]} if is_seen else {"fc": "white", "ec": COLOURS[stage.action]}
            axes.barh(height, end_s - began_s, 0.5, began_s, **look, hatch=None if is_seen else "///", lw=1.0)
            text = f"{stage.action}\n{stage.reward:+.1f}" if is_seen else f"{stage.action}\nnot completed"
            box = None if is_seen else {"fc": "white", "ec": "none", "pad": 1.0}
            colour = "white" if is_seen else INK
            middle = (began_s + end_s) / 2
            axes.text(middle, height, text, ha="center", va="center", color=colour, fontsize=9.0, bbox=box)
            began_s = end_s
        is_cut = trajectory.ending == "cut"
        words = f" cut: {trajectory.cause}" if is_cut else " finished"
        axes.plot(trajectory.end_s, height, "x" if is_cut else "|", color=RED if is_cut else INK, ms=11, mew=2.5)
        axes.text(trajectory.end_s + 0.12, height, words, va="center", color=RED if is_cut else INK, fontweight="bold")
    axes.set_yticks(range(len(logs.trajectories)), list(logs.trajectories["trajectory"]))
    axes.set(xlim=(0.0, 5.6), ylim=(1.45, -0.45))
    axes.tick_params(axis="y", length=0)
    return made


def draw_steps() -> Figure:
    """Draw three steps of another's dataset, and the stages that they become, with and without what was seen last."""
    made, axes = panel(3.0, has_grid=False)
    actions, rewards = np.array(["look", "pick", "look"]), np.array([-0.1, 5.0, -0.1])
    for row, has_last in enumerate((True, False)):
        seen = np.arange(1.0, 4.0 + has_last)
        is_step, begins, ends_s = np.arange(len(seen)) < 3, np.array([0, len(seen)]), np.arange(1.0, 4.0)
        steps = StepTable([0], begins, is_step, {"x": seen}, actions, rewards, ends_s, [(CUT, TRUNCATED)])
        stages = steps.logs("three steps").stages
        top = 2.6 * row
        for number, x in enumerate(seen.tolist()):
            text = f"saw {x:g}\ndid {actions[number]}" if number < len(actions) else f"saw {x:g}"
            axes.barh(top, 0.94, 0.8, number, fc="white", ec=SOFT, lw=1.0)
            axes.text(number + 0.47, top, text, ha="center", va="center", fontsize=9.0)
        for number, stage in enumerate(stages.itertuples()):
            is_seen, colour = not pd.isna(stage.elapsed_s), COLOURS.get(str(stage.action), SOFT)
            look: Any = {"color": colour} if is_seen else {"fc": "white", "ec": RED, "hatch": "///", "lw": 1.0}
            axes.barh(top + 1.0, 0.94, 0.8, number, **look)
            action = "no action" if pd.isna(stage.action) else stage.action
            text = f"{action}\n{stage.reward:+.1f}" if is_seen else f"cut\n{action}"
            box = None if is_seen else {"fc": "white", "ec": "none", "pad": 1.0}
            axes.text(
                number + 0.47,
                top + 1.0,
                text,
                ha="center",
                va="center",
                fontsize=9.0,
                color="white" if is_seen else RED,
                bbox=box,
            )
    rows = ["rows, the last one\nonly seen", "stages", "rows, every one\na step", "stages"]
    axes.set_yticks([0.0, 1.0, 2.6, 3.6], rows)
    axes.set(xlim=(0.0, 4.0), ylim=(4.2, -0.6), xticks=[])
    axes.tick_params(axis="y", length=0)
    axes.spines[:].set_visible(False)
    return made


def _draw_trajectories(axes: Axes, logs: Logs, num_trajectories: int, per_unit: float = 1.0) -> None:
    """Draw the first trajectories, one line each, stages in the colours of their actions, a cross where it was cut."""
    some = logs.select(list(logs.trajectory_ids[:num_trajectories]))
    for action in dict.fromkeys(some.stages["action"]):
        axes.plot([], [], "s", color=COLOURS[action], label=action)
    for height, trajectory in enumerate(some.trajectories.itertuples()):
        began_s = 0.0
        for stage in some.stages[some.stages["trajectory"] == trajectory.trajectory].itertuples():
            end_s = trajectory.end_s if pd.isna(stage.elapsed_s) else stage.elapsed_s
            ends = [began_s / per_unit, end_s / per_unit]
            axes.plot(ends, [height, height], color=COLOURS[stage.action], lw=4.2, solid_capstyle="butt")
            began_s = end_s
        if trajectory.ending == "cut":
            axes.plot(trajectory.end_s / per_unit, height, "x", color=RED, ms=6.5, mew=1.9, zorder=3)
    axes.plot([], [], "x", color=RED, ms=6.5, mew=1.9, label="cut")
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_ylim(num_trajectories - 0.3, -0.7)
    axes.set_xlim(left=0.0)


def draw_trajectories_of(folder: str, num_trajectories: int) -> Figure:
    """Draw the first trajectories of a shipped log."""
    logs = read_logs(ROOT / folder)
    made, axes = panel(3.4, "seconds since the trajectory began", has_grid=False)
    _draw_trajectories(axes, logs, num_trajectories)
    axes.set_title(
        f"The first {num_trajectories} of {len(logs.trajectories)} trajectories, a line each", loc="left", fontsize=9.5
    )
    made.legend(loc="outside lower center", ncols=6, columnspacing=0.9, handletextpad=0.2, **LEGEND)
    return made


def draw_causes(folder: str) -> Figure:
    """Draw when the trajectories of a shipped log ended, by what ended them."""
    logs = read_logs(ROOT / folder)
    causes = logs.trajectories["cause"].where(~logs.is_finished, "finished").astype(str)
    names = ["finished", *sorted(set(causes) - {"finished"}, key=lambda name: -int((causes == name).sum()))]
    made, axes = panel(0.9 + 0.45 * len(names), "seconds since the trajectory began", has_grid=False)
    jitter = np.random.default_rng(0)
    for row, name in enumerate(names):
        ends_s = logs.trajectories.loc[(causes == name).to_numpy(), "end_s"].to_numpy()
        heights = row + jitter.uniform(-0.28, 0.28, len(ends_s))
        axes.plot(ends_s, heights, ".", ms=4.0, mew=0, alpha=0.7, color=CAUSES.get(name, INK))
    counts = [int((causes == name).sum()) for name in names]
    axes.set_yticks(range(len(names)), [f"{name}\n({count})" for name, count in zip(names, counts, strict=True)])
    axes.tick_params(axis="y", length=0)
    axes.set(xlim=(0.0, None), ylim=(len(names) - 0.5, -0.5))
    return made


PICTURES = (
    plot("two-trajectories", draw_two_trajectories),
    plot("steps", draw_steps),
    plot("pick-cell-trajectories", lambda: draw_trajectories_of("examples/pick_cell/logs", 24)),
    plot("later-logs", lambda: draw_causes("examples/pick_cell/later_logs")),
    plot("physical-cell-logs", lambda: draw_causes("examples/physical_cell/logs")),
)
