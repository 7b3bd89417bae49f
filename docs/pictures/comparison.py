"""A policy against the rule of today in the bin cell: bounds of the gain and the policy's share, by trajectory."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from halfseen.figures import BLUE, INK, draw_grid
from pictures.examples import importable
from pictures.picture import Row, Table, plot, whole
from pictures.style import figure

importable("bin_cell")

NUM_DRAWN, SEED, LOOK_EVERY = 200, 4, 2


def _courses(policy: str, seed: int) -> Any:
    """Trajectories of the cell under one of its policies."""
    from bin_cell import Bin

    from halfseen.monitoring.comparison import Courses

    cell = Bin()
    cell.logging = getattr(cell, policy)
    logs = cell.log(NUM_DRAWN, seed, 0.0)
    stages, none = logs.stages, np.zeros(NUM_DRAWN)
    number = np.searchsorted(logs.trajectories["trajectory"], stages["trajectory"])
    state, reward, clock_s = (stages[name].to_numpy() for name in (list(cell.covariates), "reward", "elapsed_s"))
    return Courses(none > 0, none, logs.end_s, logs.is_finished, number, state, reward, clock_s)


def _comparison() -> Table:
    from halfseen.monitoring.comparison import Courses
    from halfseen.monitoring.dealing import Terms, standing

    arms, rng = [_courses("plain", 1), _courses("best", 2)], np.random.default_rng(SEED)
    so_far: list[Any] = []
    rows: list[Row] = []
    share = Terms().share
    for k in range(NUM_DRAWN):
        is_policy = rng.random() < share
        one = arms[int(is_policy)].part(k, k + 1)
        so_far.append(
            one._replace(is_policy=one.is_policy | is_policy, chance=one.chance + share, trajectory=one.trajectory + k)
        )
        if (k + 1) % LOOK_EVERY:
            continue
        found = standing(Courses(*(np.concatenate(each) for each in zip(*so_far, strict=True))), Terms())
        share = found.share
        if found.low is not None and found.high is not None:
            rows.append({"num": float(found.num), "low": found.low, "high": found.high, "share": share})
        if found.verdict != "going on":
            break
    return rows


def draw_comparison(rows: Table) -> Figure:
    """Draw bounds above, and the share below."""
    made = figure(3.8)
    above, below = made.subplots(2, 1, sharex=True, height_ratios=[2.2, 1.0])
    num, low, high, share = (np.array([row[name] for row in rows]) for name in ("num", "low", "high", "share"))
    above.fill_between(num, low, high, step="post", color=BLUE, alpha=0.25, lw=0)
    above.axhline(0.0, color=INK, lw=1.2)
    above.set_ylim(-1.0, 1.5)
    above.set_ylabel("gain of the policy")
    above.set_title(f"promoted after {num[-1]:.0f} trajectories", loc="left", fontsize=9.5)
    below.step(num, share, where="post", color=BLUE)
    below.set_ylim(0.0, 1.05)
    below.set(xlabel="trajectories", ylabel="its share")
    for axes in (above, below):
        draw_grid(axes)
    return made


COMPARISON = plot("comparison", draw_comparison, whole("comparison.csv", _comparison))
