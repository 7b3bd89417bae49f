"""Rewards by repetition, and their tables: policies learned from logs of every size and proportion of cuts, and others.

*The planner with laws fitted to the same logs* is slow, and so plays few episodes of each repetition: different ones
for every log, so that means over logs are more precise than those of a single log. The control variate for an episode
is the mean M of the rewards of all K learned policies of the repetition, which play all episodes. The difference
between the learned policy and the planner is

    mean (learned − M), on all episodes  +  mean (M − planner), on those that the planner played,

one number per repetition. It is unbiased for any M, as each repetition has fresh episodes. M, being a mean, is closer
to the planner than any one policy: on an episode a planner and M differ by some 0.25, and a policy learned from 25
trajectories and M by 0.9.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError
from halfseen.shapes import Float
from halfseen.study import policies as who
from halfseen.study.compare import adjusted, better, four, mean_columns, signed_rank_test, stacked
from halfseen.study.experiment import PieceOf, Pieces, Row, Tables
from halfseen.study.pipeline import CUT_KIND, SELECTION, Learned, Played, Source, episodes_in_turn, log_of
from halfseen.study.policies import BEST, FITTED_ONE_STEP, FITTED_RULE, HEURISTICS, LEARNED, LINEAR, ONE_STEP, Entrant
from halfseen.study.setting import Setting
from halfseen.tables.evidence import evidence_of
from halfseen.tables.laws import fitted_to
from halfseen.tables.learner import MODEL
from halfseen.world.config import WorldConfig

NUM_TIMED_STATES = 60
KEYS = ["num_trajectories", "cut_share"]
MEASURES = {
    "reward": "reward of a trajectory",
    "robot_s": "robot time until a trajectory ends [s]",
    "decision_ms": "time of one decision [ms], measured on this machine",
}
"""Measure → its name in text; decision times are reported and not tested, as they depend on the machine."""
Rewards = Float[np.ndarray, " R"]
Place = tuple[int, float]  # size of a log, and the proportion of its trajectories that is cut


@dataclass(frozen=True)
class RewardRepetition:
    """The configuration, and the results of a repetition.

    With `laws`, a policy is learned with laws fitted to the same log, and linear eq. 3 without laws is reported for
    comparison; otherwise the policy is linear eq. 3. The one-step look-ahead, the strongest heuristic and a planner use
    the same fitted laws, too.

    `planners` maps the simulations per decision of a planner to the number of episodes that it plays in a repetition,
    as planners are slow. The first of them also plans with laws fitted to each log, and then plays `fitted_episodes`;
    for Table 1 it plays as many as with the true laws. Planners play in the first `planned_repetitions` only, as they
    take longer than everything else in a repetition. The strongest heuristic and planner are chosen on other episodes:
    heuristics on `selection_blocks` times as many as a repetition has, planners on `selection_planned`. Table 1
    compares the policy learned from `table_num_trajectories`, of which `table_cut_share` are cut. The mean of V° over
    initial tables is estimated from `num_starts`.
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
                raise ArgumentError(f"{name} is {value}; give one of {among}, {values}")

    @property
    def contenders(self) -> dict[str, Entrant]:
        """All contenders, by name."""
        linear = (LINEAR,) if self.laws else ()
        planners = [who.planner(size) for size, _ in self.planners]
        return who.by_name(LEARNED, *linear, *planners, ONE_STEP, self.peer, FITTED_ONE_STEP, FITTED_RULE, *HEURISTICS)

    @property
    def peer(self) -> Entrant:
        """The planner whose laws are fitted to the logs that the policy is learned from."""
        return who.fitted_planner(self.planners[0][0])

    @property
    def planner_names(self) -> list[str]:
        """Names of the planners."""
        return [who.planner(size).name for size, _ in self.planners]

    @property
    def baseline_names(self) -> list[str]:
        """Names of the baselines of the learned policy."""
        return [name for name in self.contenders if name != LEARNED.name]

    @property
    def beside_names(self) -> list[str]:
        """Names of the contenders that use each log and play all episodes, like the learned policy."""
        return [*([LINEAR.name] if self.laws else []), FITTED_ONE_STEP.name, FITTED_RULE.name]

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
        for name in self.planner_names:
            (played,) = source.control_each([self.contenders[name].policy(setting.world)], some, start, SELECTION)
            earned[name] = played.means()["reward"]
        rates = [source.cut_rate(share, CUT_KIND) for share in self.cut_shares]
        return {"rates": rates, "selection": earned, "start": start}

    def measure(self, setting: Setting) -> PieceOf:
        """Decision times of all contenders [ms]."""
        times = Source.of(setting).decision_times_ms(self.contenders.values(), NUM_TIMED_STATES, self.laws)
        return {"decision_ms": times}

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Learn from a fresh log at every size and proportion of cuts, and play all on the same fresh episodes."""
        source, start = Source.of(setting, index), float(prepared["start"])
        num_all = self.episodes_per_scene * len(setting.scenes)
        learned, fitted = self._learned(source, prepared["rates"])
        rule = self.contenders[strongest(self, prepared["selection"])[BEST[0]]]
        of_logs = {
            LEARNED.name: {at: one.policy for at, one in learned.items()},
            LINEAR.name: {at: one.linear for at, one in learned.items()},
            FITTED_ONE_STEP.name: {at: FITTED_ONE_STEP.policy(world) for at, world in fitted.items()},
            FITTED_RULE.name: {at: rule.policy(world) for at, world in fitted.items()},
        }
        made: dict[tuple[str, Place | None], Any] = {
            (name, at): of_logs[name][at] for name, at in product((LEARNED.name, *self.beside_names), learned)
        }
        made |= {(each.name, None): each.policy(source.world) for each in (*HEURISTICS, ONE_STEP)}
        played = dict(zip(made, source.control_each(list(made.values()), range(num_all), start), strict=True))
        place = self.table_num_trajectories, self.table_cut_share
        headline = played[LEARNED.name, place]
        at_place = {name: played[name, place] for name in self.beside_names}
        at_place |= {each.name: played[each.name, None] for each in (ONE_STEP, *HEURISTICS)}
        baselines = {name: _beside(headline, range(num_all), other) for name, other in at_place.items()}
        peer = []
        if index < self.planned_repetitions:
            baselines |= self._planned(source, headline, fitted[place], start)
            earned = {at: played[LEARNED.name, at].reward for at in learned}
            peer = self._over_peer(source, fitted, earned, start)

        def row(name: str, at: Place) -> Row:
            return dict(zip(KEYS, at, strict=True)) | played[name, at].means()

        return {
            "index": index,
            "learned": [row(LEARNED.name, at) | one.weights | {"basis": one.basis} for at, one in learned.items()],
            "beside": {name: [row(name, at) for at in learned] for name in self.beside_names},
            "baselines": baselines,
            "peer": peer,
        }

    def _learned(self, source: Source, rates: Sequence[float]) -> tuple[dict[Place, Learned], dict[Place, WorldConfig]]:
        """The policies learned from each log, and the world with laws fitted to it, but true prices and times."""
        episodes = source.play(max(self.num_trajectories))
        cuts = [source.cut(episodes, rate, CUT_KIND) for rate in rates]
        places = list(product(self.num_trajectories, self.cut_shares))
        logs = [(each, "weighted") for each in cuts]
        found = source.logged(episodes, laws=self.laws).learn(logs, self.num_trajectories)
        learned = dict(zip(places, found, strict=True))
        fitted = {place: one.assisted.laws.config for place, one in learned.items() if one.assisted is not None}
        if not fitted:
            found = [evidence_of(log_of(each, source.world), source.world) for each in cuts]
            evidence = dict(zip(self.cut_shares, found, strict=True))
            fitted = {(size, share): fitted_to(evidence[share].first(size), source.world) for size, share in places}
        return learned, fitted

    def _planned(self, source: Source, headline: Played, fitted: WorldConfig, start: float) -> dict[str, Any]:
        """Rewards of each planner, and of the policy of Table 1 on the same episodes."""
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

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make all tables.

        Returns
        -------
        dict of pandas.DataFrame
            ``figure1``: policy, num_trajectories, cut_share, repetitions, mean_reward, se, low, high; role, which marks
            the heuristic and the planner that were the strongest on other episodes; and gain, gain_se, gain_low,
            gain_high, the paired difference from that heuristic. All rewards are by the control variate. A planner
            plays only some of the episodes: its mean is that of the policy of Table 1 on all, less the paired
            difference on those. A contender that uses logs has a row for each log; and, except for the learned policy,
            one for each size with the mean over all proportions of cut trajectories, where cut_share is null. The
            reward of a planner with fitted laws is the learned policy's, less their difference. Repetitions are those
            in which a policy played.
            ``table1``: baseline, measure, censored_q, other, p_value, p_holm, effect, supported, effect_low,
            effect_high, num_episodes: one-sided paired tests that the learned policy is better (more reward, less
            time), on the episodes that both played; the effect is censored_q − other.
            ``peer``: num_trajectories, cut_share (null: the mean over all), p_value, p_holm, effect, supported,
            effect_low, effect_high: two-sided tests of the learned policy's gain over the planner with laws fitted
            to the same log; supported if they differ.
            ``weights``: num_trajectories, cut_share, effective_sample_size, largest_weight: means over repetitions; and
            by_laws, the share of logs that did not contradict the laws fitted to them, so that the policy is built on
            these.
        """
        weights = pd.DataFrame([row for piece in pieces.repetitions for row in piece["learned"]])
        weights = weights.assign(by_laws=(weights["basis"] == MODEL).astype(float))
        tests = [
            {name: row[name] for name in KEYS} | signed_rank_test(row["over"], "two-sided").columns
            for row in _against_peer(_where_played(pieces, self.peer.name))
        ]
        return {
            "figure1": _figure1(self, pieces, strongest(self, pieces.prepared["selection"])),
            "table1": _table1(self, setting, pieces),
            "weights": weights.groupby(KEYS, sort=False)[["effective_sample_size", "largest_weight", "by_laws"]]
            .mean()
            .reset_index(),
            "peer": adjusted(pd.DataFrame(tests), setting.alpha).astype({"cut_share": "Float64"}),
        }


def over_peer(
    learned: Float[np.ndarray, " B"], mean: Float[np.ndarray, " B"], some: Sequence[int], own: Float[np.ndarray, " E"]
) -> float:
    """Gain of the learned policy over the planner, which earned `own` on `some` of the B episodes."""
    return float((learned - mean).mean() + (mean[list(some)] - own).mean())


def _beside(headline: Played, episodes: Sequence[int], played: Played) -> dict[str, Any]:
    """Rewards of a baseline on some of the episodes, and of the learned policy of Table 1 on the same."""
    own = headline.on(episodes).means()
    return {"num_episodes": len(episodes), LEARNED.name: own, "other": played.means()}


def strongest(design: RewardRepetition, selection: dict[str, float]) -> dict[str, str]:
    """Role → the policy of a kind with the largest selection reward; the first of those tied."""
    kinds = [each.name for each in HEURISTICS], [name for name in selection if name in design.planner_names]
    return {role: max(names, key=lambda name: selection[name]) for names, role in zip(kinds, BEST, strict=True)}


def _figure1(design: RewardRepetition, pieces: Pieces, chosen: dict[str, str]) -> pd.DataFrame:
    rule = chosen[BEST[0]]
    of_rule = _both(pieces, rule, "reward")[1]
    rows = _rows_of(LEARNED.name, stacked(pieces.repetitions, "learned", "reward"), of_rule)
    roles = {name: role for role, name in chosen.items()}
    for name in [each for each in design.baseline_names if each not in (design.peer.name, *design.beside_names)]:
        played = _where_played(pieces, name)
        own, other = _both(played, name, "reward")
        # The strongest heuristic plays all episodes, as does the policy of Table 1.
        headline, beside = _both(played, rule, "reward")
        rows.append({"policy": name, "role": roles.get(name)} | _reckoned(headline - (own - other), beside))
    planned = _where_played(pieces, design.peer.name)
    rows += _rows_of(design.peer.name, _against_peer(planned), _both(planned, rule, "reward")[1])
    for name in design.beside_names:
        logs = stacked([piece["beside"] for piece in pieces.repetitions], name, "reward")
        of_size = {size: [row["reward"] for row in logs if row[KEYS[0]] == size] for size in design.num_trajectories}
        logs += [{KEYS[0]: size, KEYS[1]: None, "reward": np.mean(of, axis=0)} for size, of in of_size.items()]
        rows += _rows_of(name, logs, of_rule)
    first = ["policy", *KEYS, "repetitions", "mean_reward", "se", "low", "high", "role"]
    table = pd.DataFrame(rows)
    table = table.loc[:, [*first, *table.columns.drop(first)]]
    return table.astype({"num_trajectories": "Int64", "cut_share": "Float64"})


def _rows_of(name: str, logs: Iterable[Row], rule: Rewards) -> list[Row]:
    """Policies learned or fitted from logs, in Figure 1: a row for each, compared with the strongest heuristic."""
    return [{"policy": name} | {key: row[key] for key in KEYS} | _reckoned(row["reward"], rule) for row in logs]


def _reckoned(rewards: Rewards, rule: Rewards) -> Row:
    return {"repetitions": len(rewards)} | mean_columns(rewards) | mean_columns(rewards - rule, four("gain"))


def _where_played(pieces: Pieces, name: str) -> Pieces:
    """Keep the repetitions in which a baseline played."""
    return pieces._replace(repetitions=[piece for piece in pieces.repetitions if name in piece["baselines"]])


def _against_peer(pieces: Pieces) -> list[Row]:
    """By repetition: gain of learning over planning with laws fitted to the same log, and the reward of that planning.

    There is a row for each log, and for each size one with the mean over all proportions of cut trajectories.
    """
    met, learned = ([piece[name] for piece in pieces.repetitions] for name in ("peer", "learned"))
    over = np.array([[row["over_peer"] for row in rows] for rows in met])
    reward = np.array([[row["reward"] for row in rows] for rows in learned]) - over
    sizes = np.array([row["num_trajectories"] for row in met[0]])
    logs: list[tuple[Any, ...]] = [(row["num_trajectories"], row["cut_share"], [k]) for k, row in enumerate(met[0])]
    logs += [(size, None, sizes == size) for size in dict.fromkeys(sizes.tolist())]
    names = (*KEYS, "over", "reward")
    return [
        dict(zip(names, (*place, over[:, which].mean(axis=1), reward[:, which].mean(axis=1)), strict=True))
        for *place, which in logs
    ]


def _table1(design: RewardRepetition, setting: Setting, pieces: Pieces) -> pd.DataFrame:
    rows, counts = [], []
    for name in design.baseline_names:
        played = _where_played(pieces, name)
        for measure in MEASURES:
            own, other = _both(played, name, measure)
            row: Row = {"baseline": name, "measure": measure, LEARNED.name: float(own.mean())}
            row["other"] = float(other.mean())
            if measure == "decision_ms":
                row |= {"p_value": np.nan, "effect": float((own - other)[0])}
            else:
                row |= better(own, other, measure).columns
            rows.append(row)
            counts.append(sum(piece["baselines"][name]["num_episodes"] for piece in played.repetitions))
    return adjusted(pd.DataFrame(rows), setting.alpha).assign(num_episodes=counts)


def _both(pieces: Pieces, name: str, measure: str) -> tuple[Rewards, Rewards]:
    """The learned policy of Table 1 and a baseline, on the episodes that both played; one value of measured times."""
    if measure == "decision_ms":
        own, other = (np.array([pieces.measured[measure][one]]) for one in (LEARNED.name, name))
        return own, other
    rows = [piece["baselines"][name] for piece in pieces.repetitions]
    own, other = (np.array([row[one][measure] for row in rows]) for one in (LEARNED.name, "other"))
    return own, other
