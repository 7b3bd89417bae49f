"""One repetition: policies learned from logs of every size and proportion of cuts, and all who play beside them.

*The planner with laws fitted to the same logs* takes long, and so plays few episodes of each repetition: others for
every log, so that means over logs know more than a single log does. What good decisions earn on an episode is known
from all K learned policies of the repetition, which play all of them. With M = mean of what these earned on an episode,
what the learned policy earns over the planner is

    mean (learned − M), on all episodes  +  mean (M − planner), on those that the planner played,

one number a repetition. Its mean is right, whatever M is, as each repetition has fresh episodes; and M, being a mean,
is nearer to the planner than any one policy: by the control variate a planner and M differ by some .25 on an episode,
a policy learned from 25 trajectories and M by .9.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.shapes import Float
from halfseen.study import policies as who
from halfseen.study.experiment import PieceOf, Row
from halfseen.study.pipeline import CUT_KIND, SELECTION, Learned, Played, Source, episodes_in_turn, evidence_in
from halfseen.study.policies import BEST, FITTED_ONE_STEP, FITTED_RULE, HEURISTICS, LEARNED, LINEAR, ONE_STEP, Contender
from halfseen.study.setting import Setting
from halfseen.study.timing import measured_times
from halfseen.tables.laws import fitted_to
from halfseen.tables.learner import LINEAR as LINEAR_BASIS
from halfseen.world.config import WorldConfig

NUM_TIMED_STATES = 60
KEYS = ["num_trajectories", "cut_share"]
Place = tuple[int, float]
"""Size of a log, and the proportion of its trajectories that is cut."""


@dataclass(frozen=True)
class RewardRepetition:
    """The configuration, and what a repetition makes.

    With `laws`, a policy is learned with the help of laws fitted to the same log, and linear eq. 3 without them stands
    beside; else it is the latter. From the same laws are the look one step ahead, the strongest heuristic and a
    planner, too.

    `planners` are simulations a decision, and how many episodes of a repetition a planner of so many plays, as it takes
    its time. The first of them also plans with laws that were fitted to each log, and then plays `fitted_episodes`; for
    Table 1 it plays as many as with the true laws. Planners play in the first `planned_repetitions` alone, as they take
    longer than all else that a repetition plays. The strongest heuristic and planner are chosen on other episodes:
    heuristics on `selection_blocks` times as many as a repetition has, planners on `selection_planned`. Table 1
    compares the policy learned from `table_num_trajectories`, of which `table_cut_share` are cut. What V° is worth as
    tables are set is the mean over `num_starts`.
    """

    num_trajectories: tuple[int, ...] = (25, 50, 100, 200, 400, 800)
    cut_shares: tuple[float, ...] = (0.0, 1 / 6, 1 / 3, 1 / 2)
    episodes_per_scene: int = 10
    planners: tuple[tuple[int, int], ...] = ((128, 25), (512, 20))
    fitted_episodes: int = 8
    planned_repetitions: int = 40
    selection_blocks: int = 4
    selection_planned: int = 30
    table_num_trajectories: int = 800
    table_cut_share: float = 1 / 2
    num_starts: int = 100_000
    laws: bool = True
    most_repetitions: int | None = None

    def __post_init__(self) -> None:
        for name, among in (("table_num_trajectories", "num_trajectories"), ("table_cut_share", "cut_shares")):
            value, values = getattr(self, name), getattr(self, among)
            if value not in values:
                raise ArgumentError(f"{name} is {value}; it is one of {among}, {values}")

    @property
    def contenders(self) -> dict[str, Contender]:
        """All who take part, by name."""
        linear = (LINEAR,) if self.laws else ()
        fitted = self.peer, FITTED_ONE_STEP, FITTED_RULE
        return who.by_name(LEARNED, *linear, *map(who.planner, self._simulations), ONE_STEP, *fitted, *HEURISTICS)

    @property
    def _simulations(self) -> list[int]:
        return [size for size, _ in self.planners]

    @property
    def peer(self) -> Contender:
        """The planner whose laws are fitted to the logs that the policy is learned from."""
        return who.fitted_planner(self._simulations[0])

    @property
    def planner_names(self) -> list[str]:
        """Names of the planners."""
        return [who.planner(size).name for size in self._simulations]

    @property
    def baseline_names(self) -> list[str]:
        """Names of all that the learned policy is compared with."""
        return [name for name in self.contenders if name != LEARNED.name]

    @property
    def beside_names(self) -> list[str]:
        """Names of those that are made of each log and play all episodes, as the learned policy does."""
        return [name for name in (LINEAR.name, FITTED_ONE_STEP.name, FITTED_RULE.name) if name in self.contenders]

    @property
    def level_names(self) -> list[str]:
        """Names of those that learn nothing from logs: they are the same at every size."""
        return [name for name in self.baseline_names if name not in (self.peer.name, *self.beside_names)]

    def prepare(self, setting: Setting) -> PieceOf:
        """Calibrate the cuts, and choose the strongest baselines on episodes of their own."""
        source, num_all = Source.of(setting), self.episodes_per_scene * len(setting.scenes)
        start = source.start_value(self.num_starts)
        rules = [each.policy(setting.world) for each in HEURISTICS]
        blocks = [
            Source.of(setting, k).control_each(rules, range(num_all), start, SELECTION)
            for k in range(self.selection_blocks)
        ]
        earned = {each.name: float(np.mean([block[k].reward for block in blocks])) for k, each in enumerate(HEURISTICS)}
        some = episodes_in_turn(0, self.selection_planned, num_all)
        for each in map(who.planner, self._simulations):
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
        made: dict[tuple[str, Place | None], Any] = {}
        for at, one in learned.items():
            made |= {(LEARNED.name, at): one.policy, (LINEAR.name, at): one.linear}
            made |= {(FITTED_ONE_STEP.name, at): FITTED_ONE_STEP.policy(fitted[at])}
            made |= {(FITTED_RULE.name, at): rule.policy(fitted[at])}
        made = {key: made[key] for key in product((LEARNED.name, *self.beside_names), learned)}
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
            baselines |= self._planned(source, headline, fitted[place], start)
            earned = {where: played[LEARNED.name, where].reward for where in learned}
            peer = self._over_peer(source, fitted, earned, start)

        def row(name: str, at: Place) -> Row:
            return dict(zip(KEYS, at, strict=True)) | played[name, at].means()

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
        logs = [(each, "weighted") for each in cuts]
        found = source.logged(episodes, laws=self.laws).learn(logs, self.num_trajectories)
        learned = dict(zip(places, found, strict=True))
        fitted = {place: one.assisted.laws.config for place, one in learned.items() if one.assisted is not None}
        if not fitted:
            told = {share: evidence_in(each, source.world) for share, each in zip(self.cut_shares, cuts, strict=True)}
            fitted = {(size, share): fitted_to(told[share].first(size), source.world) for size, share in places}
        return learned, fitted

    def _planned(self, source: Source, headline: Played, fitted: WorldConfig, start: float) -> dict[str, Any]:
        """What each planner earned, and the policy of Table 1 on the same episodes."""
        planners = [(who.planner(size), source.world, count) for size, count in self.planners]
        found = {}
        for each, world, num_episodes in (*planners, (self.peer, fitted, self.planners[0][1])):
            some = episodes_in_turn(source.index, num_episodes, len(headline.reward))
            (played,) = source.control_each([each.policy(world)], some, start)
            found[each.name] = _beside(headline, some, played)
        return found

    def _over_peer(
        self, source: Source, fitted: Mapping[Place, WorldConfig], learned: Mapping[Place, Any], start: float
    ) -> list[Row]:
        """Plan with laws fitted to each log: num_trajectories, cut_share and over_peer of each place."""
        rows, mean = [], np.mean(list(learned.values()), axis=0)
        for rank, place in enumerate(learned):
            some = episodes_in_turn(source.index * len(learned) + rank, self.fitted_episodes, len(mean))
            (own,) = source.control_each([self.peer.policy(fitted[place])], some, start)
            gap = over_peer(learned[place], mean, some, own.reward)
            rows.append(dict(zip(KEYS, place, strict=True)) | {"over_peer": gap})
        return rows


def over_peer(
    learned: Float[np.ndarray, " B"], mean: Float[np.ndarray, " B"], some: Sequence[int], own: Float[np.ndarray, " E"]
) -> float:
    """What the learned policy earned over the planner, which earned `own` on `some` of the B episodes."""
    return float((learned - mean).mean() + (mean[list(some)] - own).mean())


def _basis(one: Learned) -> str:
    """What the policy is built on."""
    return LINEAR_BASIS if one.assisted is None else one.assisted.basis


def _beside(headline: Played, episodes: Sequence[int], played: Played) -> dict[str, Any]:
    """What a baseline earned on some of the episodes, and the learned policy of Table 1 on the same."""
    own = headline.on(episodes).means()
    return {"num_episodes": len(episodes), LEARNED.name: own, "other": played.means()}


def strongest(design: RewardRepetition, selection: dict[str, float]) -> dict[str, str]:
    """Role → the policy of a kind that earned most where they were chosen; the first of equals."""
    kinds = [each.name for each in HEURISTICS], [name for name in selection if name in design.planner_names]
    return {role: max(names, key=lambda name: selection[name]) for names, role in zip(kinds, BEST, strict=True)}
