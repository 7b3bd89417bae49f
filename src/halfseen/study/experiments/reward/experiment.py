"""One repetition of the experiment."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, ClassVar

import numpy as np

from halfseen.study.experiment import PieceOf, Setting
from halfseen.study.experiments.reward.design import RewardDesign
from halfseen.study.experiments.reward.peer import peers_beside, planned, told_by
from halfseen.study.experiments.reward.section import section_of
from halfseen.study.experiments.reward.tables import tables_of
from halfseen.study.pipeline import SELECTION, Played, Source, episodes_in_turn
from halfseen.study.policies import HEURISTICS, LEARNED, planner
from halfseen.study.timing import measured_times
from halfseen.tables.laws.evidence import Evidence
from halfseen.world.cuts import CutKind

CUT_KIND: CutKind = "independent"
NUM_TIMED_STATES = 60


@dataclass(frozen=True)
class Reward(RewardDesign):
    """The experiment; its parameters are those of `RewardDesign`."""

    name: ClassVar[str] = "reward"
    tabulate = tables_of
    section = section_of

    def prepare(self, setting: Setting) -> PieceOf:
        """Calibrate the cuts, and choose the strongest baselines on episodes of their own."""
        source, num_all = Source.of(setting), self.episodes_per_scene * len(setting.scenes)
        blocks = [Source.of(setting, k) for k in range(self.selection_blocks)]
        earned: dict[str, float] = {}
        for each in HEURISTICS:
            policy = each.policy(setting.world)
            earned[each.name] = float(np.mean([block.evaluate(policy, num_all, SELECTION).reward for block in blocks]))
        some = episodes_in_turn(0, self.selection_planned, num_all)
        for each in (planner(size) for size, _ in self.planners):
            played = source.evaluate_some(each.policy(setting.world), some, SELECTION)
            earned[each.name] = played.means()["reward"]
        rates = [source.cut_rate(share, CUT_KIND) for share in self.cut_shares]
        return {"rates": rates, "selection": earned}

    def measure(self, setting: Setting) -> PieceOf:
        """Decision times of all who take part [ms]."""
        return {"decision_ms": measured_times(setting, self.contenders.values(), NUM_TIMED_STATES)}

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Learn from a fresh log at every size and proportion of cuts, and play all on the same fresh episodes."""
        source = Source.of(setting, index)
        num_all = self.episodes_per_scene * len(setting.scenes)
        episodes = source.play(max(self.num_paths))
        logs = [(source.cut(episodes, rate, CUT_KIND), "weighted") for rate in prepared["rates"]]
        learned = source.logged(episodes).learn_and_play(logs, self.num_paths, num_all)
        places = list(product(self.num_paths, self.cut_shares))
        rows = [
            {"num_paths": size, "cut_share": share, **weights, **played.means()}
            for (size, share), (weights, played) in zip(places, learned, strict=True)
        ]
        earned = {place: played for place, (_, played) in zip(places, learned, strict=True)}
        headline = earned[self.table_num_paths, self.table_cut_share]
        baselines, peer = self._ruled(source, headline), []
        if index < self.planned_repetitions:
            cut = {share: cuts for share, (cuts, _) in zip(self.cut_shares, logs, strict=True)}
            told = {share: told_by(cuts, CUT_KIND, setting) for share, cuts in cut.items()}
            first = told[self.table_cut_share].first(self.table_num_paths)
            baselines = baselines | self._planned(source, headline, first)
            peer = peers_beside(self, source, told, earned)
        return {"index": index, "learned": rows, "baselines": baselines, "peer": peer}

    def _ruled(self, source: Source, headline: Played) -> dict[str, Any]:
        """What each heuristic earned, and the policy of Table 1 on the same episodes."""
        num_all = len(headline.reward)
        each = source.evaluate_each([one.policy(source.world) for one in HEURISTICS], num_all)
        return {
            one.name: _beside(headline, range(num_all), played) for one, played in zip(HEURISTICS, each, strict=True)
        }

    def _planned(self, source: Source, headline: Played, told: Evidence) -> dict[str, Any]:
        """What each planner earned, and the policy of Table 1 on the same episodes."""
        num_all, found = len(headline.reward), {}
        for size, num_episodes in self.planners:
            some = episodes_in_turn(source.index, num_episodes, num_all)
            played = source.evaluate_some(planner(size).policy(source.world), some)
            found[planner(size).name] = _beside(headline, some, played)
        some = episodes_in_turn(source.index, self.planners[0][1], num_all)
        return found | {self.peer.name: _beside(headline, some, planned(self, source, told, some))}


def _beside(headline: Played, episodes: Sequence[int], played: Played) -> dict[str, Any]:
    """What a baseline earned on some of the episodes, and the learned policy of Table 1 on the same."""
    both = {LEARNED.name: headline.on(episodes), "other": played}
    return {"num_episodes": len(episodes)} | {who: each.means() for who, each in both.items()}
