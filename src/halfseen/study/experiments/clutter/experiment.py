"""One repetition: at every place a fresh log, a learned policy, and the heuristics on the same episodes."""

from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from halfseen.study.experiment import Drawing, Listing, PieceOf, Pieces, Section, Setting, Tables
from halfseen.study.experiments.clutter.figure import draw_map
from halfseen.study.experiments.clutter.places import ClutterDesign, Place, label_number, random_tables
from halfseen.study.experiments.clutter.table import table_of
from halfseen.study.experiments.clutter.words import map_sentence, map_title
from halfseen.study.frames import records
from halfseen.study.pipeline import EVALUATION, LOGS, PILOT, Source
from halfseen.study.policies import HEURISTICS, LEARNED, by_name
from halfseen.wording import amount, estimated, share_in_words
from halfseen.world.cuts import CutKind, cut_rate
from halfseen.world.state import pad_scenes

MAP_SEED, TABLES = 16, 2
GAIN = ("gain_share", "gain_share_low", "gain_share_high")
CUT_KIND: CutKind = "independent"


@dataclass(frozen=True)
class Clutter(ClutterDesign):
    """The experiment; its parameters are those of `ClutterDesign`."""

    name: ClassVar[str] = "clutter"

    def prepare(self, setting: Setting) -> PieceOf:
        """Calibrate the cuts at each place, from a pilot of its own."""
        pilots = (
            self._source(setting, place, 0).play(self.num_trajectories, MAP_SEED + PILOT)
            for place in self.places(setting)
        )
        return {"rates": [cut_rate(pilot, self.cut_share, CUT_KIND) for pilot in pilots]}

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Learn and play at every place: a row for each."""
        places = zip(self.places(setting), prepared["rates"], strict=True)
        return {"index": index, "map": [self.at(setting, place, rate, index) for place, rate in places]}

    def at(self, setting: Setting, place: Place, rate: float, index: int) -> dict[str, Any]:
        """Learn and play at one place: the place, and the mean reward of each policy.

        It depends on no other place but through the largest N, to which all tables are padded so that one compiled
        call serves all places.
        """
        source = self._source(setting, place, index)
        episodes = source.play(self.num_trajectories, MAP_SEED + LOGS)
        cuts = source.cut(episodes, rate, CUT_KIND)
        learned = source.logged(episodes, laws=self.laws).learn_one(cuts, self.num_trajectories)
        policies = {LEARNED.name: learned} | {each.name: each.policy(source.world) for each in HEURISTICS}
        num_episodes = self.num_tables * self.episodes_per_table
        rewards = {
            name: source.evaluate(policy, num_episodes, MAP_SEED + EVALUATION).means()["reward"]
            for name, policy in policies.items()
        }
        return asdict(place) | {"rewards": rewards}

    def _source(self, setting: Setting, place: Place, index: int) -> Source:
        """At one N the same tables everywhere, denser or looser."""
        rng = np.random.default_rng([setting.seed, index, TABLES, place.num_objects])
        grips = () if place.is_assumed else setting.grips
        scenes = random_tables(place.num_objects, place.occlusion, self.num_tables, rng, grips)
        return Source(place.world(setting.world), pad_scenes(scenes, max(self.num_objects)), setting.seed, index)

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make map."""
        return {"map": table_of(self, setting.world, pieces.repetitions)}

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Say where to learn, and where the best heuristic is good enough."""
        table, world = tables["map"], setting.world
        caption, draw = _caption(self, setting, table), partial(draw_map, self, setting, table)
        drawing = Drawing("map", "Figure 6", map_title(table, world), caption, draw)
        sentence = map_sentence(table, self, world)
        return Section("Where is learning worth it?", (sentence,), (drawing,), (_numbers(table),))


LABEL_WORDS = {"gain": "how often a label is right in full view", "facing": "the surface that one look shows"}


def _caption(design: ClutterDesign, setting: Setting, table: pd.DataFrame) -> str:
    assumed = "" if setting.law is None else " Assumed laws: those that this project chose before a cell was tried."
    return (
        f"In each field: what the policy learned from {design.num_trajectories} trajectories, of which "
        f"{share_in_words(design.cut_share)} are cut in expectation, gains over the best of the four heuristics, as a "
        "share of what that heuristic earns above FINISH at once (which leaves every dirty object). The best heuristic "
        "is chosen with hindsight on the very episodes of the comparison, which favours it, and knows the true world. "
        f"{int(table['repetitions'].iloc[0])} repetitions, each with a fresh log and {design.num_tables} fresh random "
        f"tables; all policies play the same {design.num_tables * design.episodes_per_table} fresh episodes. Labels: "
        f"{LABEL_WORDS[label_number(setting.world)]}. Cost: of washing a clean object. Spread: of the hidden grip "
        f"offset.{assumed} "
        "Verdicts are by 95 % intervals of the share (Fieller’s), which are not adjusted for the number of places; "
        "neighbouring places share their random numbers."
    )


def _numbers(table: pd.DataFrame) -> Listing:
    rules = by_name(*HEURISTICS)
    cells = {
        "objects": lambda row: str(row["num_objects"]),
        "hidden": lambda row: amount(row["occlusion"], 1),
        "laws": lambda row: "assumed" if row["is_assumed"] else "the study’s",
        "labels": lambda row: amount(row["labels"]),
        "washing a clean one": lambda row: amount(row["reward_wash_clean"], 0),
        "grip spread": lambda row: amount(row["grip_offset_std"], 1),
        "learned": lambda row: amount(row[LEARNED.name]),
        "best heuristic": lambda row: f"{amount(row['heuristic_reward'])} ({rules[row['best_heuristic']].label})",
        "gain [%]": lambda row: estimated(*(100 * row[name] for name in GAIN), decimals=0),
        "verdict": lambda row: row["verdict"],
    }
    return Listing.of("The numbers of Figure 6", "", records(table), cells)
