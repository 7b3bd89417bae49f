"""One repetition: at every place a fresh log, a learned policy, and the heuristics on the same episodes."""

from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np

from halfseen.study.experiment import PieceOf, Pieces, Section, Setting, Tables
from halfseen.study.experiments.clutter.design import ClutterDesign
from halfseen.study.experiments.clutter.places import Place, random_tables
from halfseen.study.experiments.clutter.section import section_of
from halfseen.study.experiments.clutter.table import table_of
from halfseen.study.pipeline import EVALUATION, LOGS, PILOT, Source
from halfseen.study.policies import HEURISTICS, LEARNED
from halfseen.world.cuts import CutKind, cut_rate
from halfseen.world.state import pad_scenes

MAP_SEED, TABLES = 16, 2
CUT_KIND: CutKind = "independent"


@dataclass(frozen=True)
class Clutter(ClutterDesign):
    """The experiment; its parameters are those of `ClutterDesign`."""

    name: ClassVar[str] = "clutter"

    def prepare(self, setting: Setting) -> PieceOf:
        """Calibrate the cuts at each place, from a pilot of its own."""
        return {"rates": [self._rate(setting, place) for place in self.places(setting.world)]}

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Learn and play at every place: a row for each."""
        places = zip(self.places(setting.world), prepared["rates"], strict=True)
        return {"index": index, "map": [self.at(setting, place, rate, index) for place, rate in places]}

    def at(self, setting: Setting, place: Place, rate: float, index: int) -> dict[str, Any]:
        """Learn and play at one place: the place, and the mean reward of each policy.

        It depends on no other place but through the largest N, to which all tables are padded so that one compiled
        call serves all places.
        """
        source = self._source(setting, place, index)
        episodes = source.play(self.num_paths, MAP_SEED + LOGS)
        learned = source.encode(episodes).learn_one(source.cut(episodes, rate, CUT_KIND), self.num_paths)
        policies = {LEARNED.name: learned} | {each.name: each.policy(source.world) for each in HEURISTICS}
        num_episodes = self.num_tables * self.episodes_per_table
        rewards = {
            name: source.evaluate(policy, num_episodes, MAP_SEED + EVALUATION).means()["reward"]
            for name, policy in policies.items()
        }
        return asdict(place) | {"rewards": rewards}

    def _rate(self, setting: Setting, place: Place) -> float:
        pilot = self._source(setting, place, 0).play(self.num_paths, MAP_SEED + PILOT)
        return cut_rate(pilot, self.cut_share, CUT_KIND)

    def _source(self, setting: Setting, place: Place, index: int) -> Source:
        """At one N the same tables everywhere, denser or looser."""
        rng = np.random.default_rng([setting.seed, index, TABLES, place.num_objects])
        scenes = random_tables(place.num_objects, place.occlusion, self.num_tables, rng)
        return Source(place.world(setting.world), pad_scenes(scenes, max(self.num_objects)), setting.seed, index)

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make map."""
        return {"map": table_of(self, setting.world, pieces.repetitions)}

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Say where to learn, and where the best heuristic is good enough."""
        return section_of(self, setting.world, tables["map"])
