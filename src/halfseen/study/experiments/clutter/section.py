"""What the experiment says: Figure 6, and where to learn."""

from functools import partial

import pandas as pd

from halfseen.pages.numbers import amount, interval, share_in_words
from halfseen.study.experiment import Drawing, Listing, Section
from halfseen.study.experiments.clutter.design import ClutterDesign
from halfseen.study.experiments.clutter.figure import draw_map
from halfseen.study.experiments.clutter.words import map_sentence, map_title
from halfseen.study.frames import records
from halfseen.study.policies import HEURISTICS, LEARNED, by_name
from halfseen.world.config import WorldConfig


def section_of(design: ClutterDesign, world: WorldConfig, table: pd.DataFrame) -> Section:
    """Say where to learn, and where the best heuristic is good enough."""
    draw = partial(draw_map, design, world, table)
    drawing = Drawing("map", "Figure 6", map_title(table, world), _caption(design, table), draw)
    return Section("Where is learning worth it?", (map_sentence(table, design, world),), (drawing,), (_numbers(table),))


def _caption(design: ClutterDesign, table: pd.DataFrame) -> str:
    return (
        f"In each field: what the policy learned from {design.num_paths} paths, of which "
        f"{share_in_words(design.cut_share)} are cut in expectation, gains over the best of the four heuristics, as a "
        "share of what that heuristic earns above FINISH at once (which leaves every dirty object). The best heuristic "
        "is chosen with hindsight on the very episodes of the comparison, which favours it, and knows the true world. "
        f"{int(table['repetitions'].iloc[0])} repetitions, each with a fresh log and {design.num_tables} fresh random "
        f"tables; all policies play the same {design.num_tables * design.episodes_per_table} fresh episodes. Labels: "
        "how often a label is right in full view. Cost: of washing a clean object. Spread: of the hidden grip offset. "
        "Verdicts are by 95 % intervals of the share (Fieller’s), which are not adjusted for the number of places; "
        "neighbouring places share their random numbers."
    )


def _numbers(table: pd.DataFrame) -> Listing:
    names = by_name(*HEURISTICS)
    rows = []
    for row in records(table):
        low_high = interval(100 * row["gain_share_low"], 100 * row["gain_share_high"], 0)
        place = (
            str(row["num_objects"]),
            amount(row["occlusion"], 1),
            amount(row["label_gain"]),
            amount(row["reward_wash_clean"], 0),
            amount(row["grip_offset_std"], 1),
        )
        earned = amount(row[LEARNED.name]), f"{amount(row['heuristic_reward'])} ({names[row['best_heuristic']].label})"
        rows.append((*place, *earned, f"{amount(100 * row['gain_share'], 0)} ({low_high})", row["verdict"]))
    header = ("objects", "hidden", "label gain", "washing a clean one", "grip spread", "learned", "best heuristic")
    return Listing("The numbers of Figure 6", "", (*header, "gain [%]", "verdict"), {"": rows})
