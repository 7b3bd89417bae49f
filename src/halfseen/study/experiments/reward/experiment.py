"""One repetition of the experiment."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, ClassVar

import numpy as np

from halfseen.study.experiment import PieceOf, Setting
from halfseen.study.experiments.reward.design import RewardDesign
from halfseen.study.experiments.reward.peer import Place, peers_beside
from halfseen.study.experiments.reward.section import section_of
from halfseen.study.experiments.reward.tables import BEST, strongest, tables_of
from halfseen.study.pipeline import SELECTION, Learned, Played, Source, episodes_in_turn
from halfseen.study.policies import FITTED_ONE_STEP, FITTED_RULE, HEURISTICS, LEARNED, LINEAR, ONE_STEP, planner
from halfseen.study.timing import measured_times
from halfseen.study.told import told_by
from halfseen.tables.laws import fitted_to
from halfseen.tables.learner import LINEAR as LINEAR_BASIS
from halfseen.world.config import WorldConfig
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
        start = source.start_value(self.num_starts)
        blocks = [Source.of(setting, k) for k in range(self.selection_blocks)]
        rules = [each.policy(setting.world) for each in HEURISTICS]
        each = [block.control_each(rules, range(num_all), start, SELECTION) for block in blocks]
        earned = {
            one.name: float(np.mean([played.reward for played in of_blocks]))
            for one, of_blocks in zip(HEURISTICS, zip(*each, strict=True), strict=True)
        }
        some = episodes_in_turn(0, self.selection_planned, num_all)
        for each in (planner(size) for size, _ in self.planners):
            (played,) = source.control_each([each.policy(setting.world)], some, start, SELECTION)
            earned[each.name] = played.means()["reward"]
        rates = [source.cut_rate(share, CUT_KIND) for share in self.cut_shares]
        return {"rates": rates, "selection": earned, "start": start}

    def measure(self, setting: Setting) -> PieceOf:
        """Decision times of all who take part [ms]."""
        return {"decision_ms": measured_times(setting, self.contenders.values(), NUM_TIMED_STATES, self.laws)}

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Learn from a fresh log at every size and proportion of cuts, and play all on the same fresh episodes."""
        source, start = Source.of(setting, index), float(prepared["start"])
        num_all = self.episodes_per_scene * len(setting.scenes)
        learned, fitted = self._learned(source, prepared["rates"])
        rule = self.contenders[strongest(self, prepared["selection"])[BEST[0]]]
        of_logs = {
            LEARNED.name: {place: one.policy for place, one in learned.items()},
            LINEAR.name: {place: one.linear for place, one in learned.items()},
            FITTED_ONE_STEP.name: {place: FITTED_ONE_STEP.policy(world) for place, world in fitted.items()},
            FITTED_RULE.name: {place: rule.policy(world) for place, world in fitted.items()},
        }
        made = {(name, place): of_logs[name][place] for name in (LEARNED.name, *self.beside_names) for place in learned}
        made |= {(each.name, None): each.policy(source.world) for each in (*HEURISTICS, ONE_STEP)}
        each = source.control_each(list(made.values()), range(num_all), start)
        played: dict[tuple[str, Place | None], Played] = dict(zip(made, each, strict=True))
        place = self.table_num_trajectories, self.table_cut_share
        headline = played[LEARNED.name, place]
        baselines, peer = {}, []
        for name in (*self.beside_names, ONE_STEP.name, *(each.name for each in HEURISTICS)):
            other = played[name, place if name in self.beside_names else None]
            baselines[name] = _beside(headline, range(num_all), other)
        if index < self.planned_repetitions:
            baselines = baselines | self._planned(source, headline, fitted[place], start)
            earned = {where: played[LEARNED.name, where] for where in learned}
            peer = peers_beside(self, source, fitted, earned, start)

        def row(name: str, at: Place) -> dict[str, Any]:
            return {"num_trajectories": at[0], "cut_share": at[1], **played[name, at].means()}

        return {
            "index": index,
            "learned": [row(LEARNED.name, at) | one.weights | {"basis": _basis(one)} for at, one in learned.items()],
            "beside": {name: [row(name, at) for at in learned] for name in self.beside_names},
            "baselines": baselines,
            "peer": peer,
        }

    def _learned(self, source: Source, rates: Sequence[float]) -> tuple[dict[Place, Learned], dict[Place, WorldConfig]]:
        """What is learned from each log, and the world with laws fitted to it; prices and times are the true ones."""
        episodes = source.play(max(self.num_trajectories))
        cuts = [source.cut(episodes, rate, CUT_KIND) for rate in rates]
        places = list(product(self.num_trajectories, self.cut_shares))
        found = source.logged(episodes, laws=self.laws).learn(
            [(each, "weighted") for each in cuts], self.num_trajectories
        )
        learned = dict(zip(places, found, strict=True))
        fitted = {place: one.assisted.laws.config for place, one in learned.items() if one.assisted is not None}
        if not fitted:
            told = {share: told_by(each, source.world) for share, each in zip(self.cut_shares, cuts, strict=True)}
            fitted = {(size, share): fitted_to(told[share].first(size), source.world) for size, share in places}
        return learned, fitted

    def _planned(self, source: Source, headline: Played, fitted: WorldConfig, start: float) -> dict[str, Any]:
        """What each planner earned, and the policy of Table 1 on the same episodes."""
        who = [(planner(size), source.world, count) for size, count in self.planners]
        who.append((self.peer, fitted, self.planners[0][1]))
        found = {}
        for each, world, num_episodes in who:
            some = episodes_in_turn(source.index, num_episodes, len(headline.reward))
            (played,) = source.control_each([each.policy(world)], some, start)
            found[each.name] = _beside(headline, some, played)
        return found


def _basis(one: Learned) -> str:
    """What the policy is built on."""
    return LINEAR_BASIS if one.assisted is None else one.assisted.basis


def _beside(headline: Played, episodes: Sequence[int], played: Played) -> dict[str, Any]:
    """What a baseline earned on some of the episodes, and the learned policy of Table 1 on the same."""
    both = {LEARNED.name: headline.on(episodes), "other": played}
    return {"num_episodes": len(episodes)} | {who: each.means() for who, each in both.items()}
