"""One repetition of the experiment."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from halfseen.study.experiment import PieceOf, Pieces, Section, Setting, Tables
from halfseen.study.experiments.reward.design import RewardDesign
from halfseen.study.experiments.reward.section import section_of
from halfseen.study.experiments.reward.tables import tables_of
from halfseen.study.pipeline import SELECTION, Played, Source, episodes_in_turn, members
from halfseen.study.policies import HEURISTICS, LEARNED, planner
from halfseen.study.single_play import decision_times_ms, play_singly, states_along_the_way
from halfseen.tables.features import NUM_FEATURES
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world.action_space import Verb
from halfseen.world.cuts import CutKind

CUT_KIND: CutKind = "independent"
NUM_TIMED_STATES = 60


@dataclass(frozen=True)
class Reward(RewardDesign):
    """The experiment; its parameters are those of `RewardDesign`."""

    name: ClassVar[str] = "reward"

    def prepare(self, setting: Setting) -> PieceOf:
        """Calibrate the cuts, and choose the strongest heuristic and planner on episodes of their own."""
        source = Source(setting.world, setting.layouts, setting.seed)
        num_all = self.selection_per_scene * len(setting.scenes)
        played = {each.name: source.evaluate(each.policy(setting.world), num_all, SELECTION) for each in HEURISTICS}
        some = episodes_in_turn(0, self.selection_planned, num_all)
        for each in (planner(size) for size, _ in self.planners):
            played[each.name] = play_singly(source, each.policy(setting.world), some, SELECTION)
        return {
            "rates": [source.cut_rate(share, CUT_KIND) for share in self.cut_shares],
            "selection": {name: each.means()["reward"] for name, each in played.items()},
        }

    def measure(self, setting: Setting) -> PieceOf:
        """Decision times of all who take part [ms]."""
        # The time of a learned decision does not depend on what was learned.
        unlearned = jnp.zeros((setting.world.horizon, len(Verb), NUM_FEATURES + 1), dtype=jnp.float32)
        policies = {LEARNED.name: LinearTablePolicy(unlearned)}
        policies |= {name: each.policy(setting.world) for name, each in self.contenders.items() if each.make}
        source = Source(setting.world, setting.layouts, setting.seed)
        times = decision_times_ms(policies, states_along_the_way(source, NUM_TIMED_STATES))
        return {"decision_ms": {name: float(np.median(values)) for name, values in times.items()}}

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Learn from a fresh log at every size and proportion of cuts, and play all on the same fresh episodes."""
        source = Source(setting.world, setting.layouts, setting.seed, index)
        num_all = self.episodes_per_scene * len(setting.scenes)
        rules = {each.name: source.evaluate(each.policy(setting.world), num_all) for each in HEURISTICS}
        rows, headline = self._learned(source, prepared["rates"], num_all)
        return {
            "index": index,
            "learned": rows,
            "heuristics": {name: played.means() for name, played in rules.items()},
            "planners": {planner(size).name: self._planned(source, size, headline) for size, _ in self.planners},
        }

    def _learned(self, source: Source, rates: Sequence[float], num_all: int) -> tuple[list[dict[str, Any]], Played]:
        """A row for each learned policy; and what the one of Table 1 earned."""
        episodes = source.play(max(self.num_paths))
        encoded = source.encode(episodes)
        logs = [(source.cut(episodes, rate, CUT_KIND), "weighted") for rate in rates]
        rows, policies = [], []
        for size in self.num_paths:
            batch, weights = encoded.learn(logs, size)
            policies += members(batch)
            rows += [
                {"num_paths": size, "cut_share": share, **weight}
                for share, weight in zip(self.cut_shares, weights, strict=True)
            ]
        together = LinearTablePolicy(jnp.stack([each.coefficients for each in policies]))
        played = source.evaluate_batch(together, num_all)
        rows = [row | each.means() for row, each in zip(rows, played, strict=True)]
        place = self.num_paths.index(self.table_num_paths) * len(rates) + self.cut_shares.index(self.table_cut_share)
        return rows, played[place]

    def _planned(self, source: Source, size: int, headline: Played) -> dict[str, Any]:
        """What a planner earned on some of the episodes, and the learned policy on the same."""
        episodes = episodes_in_turn(source.index, dict(self.planners)[size], len(headline.reward))
        played = play_singly(source, planner(size).policy(source.world), episodes)
        return {"num_episodes": len(episodes), **played.means(), LEARNED.name: headline.on(episodes).means()}

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make figure1, table1 and weights."""
        return tables_of(self, setting, pieces)

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Say whether learning earns more, and how few logged paths suffice."""
        return section_of(self, setting, tables)
