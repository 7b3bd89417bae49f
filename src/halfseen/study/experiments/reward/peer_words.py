"""Who earns more, the learned policy or the planner with laws fitted to the same logs, and from which logs."""

from collections.abc import Callable

import pandas as pd

from halfseen.study.experiment import Listing, Row, Setting
from halfseen.study.experiments.reward.design import RewardDesign
from halfseen.study.frames import records
from halfseen.study.wording import EFFECT, estimated_in
from halfseen.wording import counted, listed, share

MARK = " *"
"""Marks a difference that the test finds."""


def peer_sentence(design: RewardDesign, peer: pd.DataFrame) -> str:
    """Say who earns more from how many trajectories, over all proportions of cut trajectories and at single ones."""
    is_mean = peer["cut_share"].isna()
    means, single = (records(pd.DataFrame(peer[which])) for which in (is_mean, ~is_mean))
    ends = " and ".join(f"{estimated_in(row, EFFECT)} from {row['num_trajectories']}" for row in (means[0], means[-1]))
    return (
        f"Against the planner with laws fitted to the same logs ({design.planners[0][0]:,} simulations), over all "
        f"proportions of cut trajectories the learned policy {_by_verdict(means, _sizes)} (learned − planner: {ends} "
        f"trajectories); by single proportions, it {_by_verdict(single, _places)} (two-sided signed-rank tests, "
        f"adjusted by Holm’s procedure for all {len(peer)})."
    )


def _by_verdict(rows: list[Row], told: Callable[[list[Row]], str]) -> str:
    found = [row for row in rows if row["supported"]]
    more, less = ([row for row in found if (row["effect"] > 0) is is_more] for is_more in (True, False))
    verbs = {"earns more": more, "earns less": less}
    parts = [f"{verb} from {told(where)}" for verb, where in verbs.items() if where]
    rest = "elsewhere shows no significant difference" if parts else "shows no significant difference anywhere"
    return listed([*parts, rest] if len(found) < len(rows) else parts)


def _sizes(rows: list[Row]) -> str:
    return f"{listed([str(row['num_trajectories']) for row in rows])} trajectories"


def _places(rows: list[Row]) -> str:
    """Sizes with the proportions of cut trajectories, those of the same proportions together."""
    shares: dict[int, list[str]] = {}
    for row in rows:
        shares.setdefault(row["num_trajectories"], []).append(share(row["cut_share"]))
    sizes: dict[str, list[str]] = {}
    for size, of in shares.items():
        sizes.setdefault(listed(of, "or"), []).append(str(size))
    return listed([f"{listed(those)} trajectories (cut: {cut})" for cut, those in sizes.items()])


def peer_listing(design: RewardDesign, setting: Setting, peer: pd.DataFrame) -> Listing:
    """Write the differences by size and by proportion of cut trajectories."""
    num_played = counted(design.fitted_episodes, "episode")
    caption = (
        "Reward of the learned policy less that of the planner with laws fitted to the same log, which plays "
        f"{num_played} of a repetition for each log, with 95 % intervals (not adjusted). {MARK.strip()}: p of a "
        f"two-sided Wilcoxon signed-rank test, adjusted by Holm’s procedure for all {len(peer)}, below α = "
        f"{setting.alpha:g}."
    )
    header = (
        "logged trajectories",
        *(f"cut: {share(cut_share)}" for cut_share in design.cut_shares),
        "mean over these",
    )
    rows = [(str(size), *map(_difference, records(peer, num_trajectories=size))) for size in design.num_trajectories]
    return Listing("Learned, or planned with fitted laws", caption, header, {"": rows})


def _difference(row: Row) -> str:
    return f"{estimated_in(row, EFFECT)}{MARK if row['supported'] else ''}"
