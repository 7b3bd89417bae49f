"""Reward of the learned policy, by size of the log and proportion of cut trajectories: Figure 1, Tables 1 and 2.

*The planner with laws fitted to the same logs* is slow, and so plays few episodes of each repetition: different ones
for every log, so that means over logs are more precise than those of a single log. The control variate for an episode
is the mean M of the rewards of all K learned policies of the repetition, which play all episodes. The difference
between the learned policy and the planner is

    mean (learned − M), on all episodes  +  mean (M − planner), on those that the planner played,

one number per repetition. It is unbiased for any M, as each repetition has fresh episodes. M, being a mean, is closer
to the planner than any one policy: by some 0.25 on an episode, where one learned from 25 trajectories is 0.9 from M.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, ClassVar, TypeAlias

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from halfseen.errors import ArgumentError
from halfseen.study import compare
from halfseen.study import policies as who
from halfseen.study.compare import MEAN, Frame, Row, four, grouped, means, records, row_of, where, wide
from halfseen.study.experiment import Experiment, Piece, Pieces, Tables
from halfseen.study.figures import draw_named_bars
from halfseen.study.pipeline import CUT_KIND, SELECTION, Learned, Played, Source, episodes_in_turn, log_of
from halfseen.study.policies import BEST, FITTED_ONE_STEP, FITTED_RULE, HEURISTICS, LEARNED, LINEAR, ONE_STEP, Entrant
from halfseen.study.setting import Setting
from halfseen.tables.evidence import evidence_of
from halfseen.tables.laws import fitted_to
from halfseen.tables.learner import MODEL
from halfseen.wording import significant
from halfseen.world.config import WorldConfig

NUM_TIMED_STATES = 60
KEYS = ["num_trajectories", "cut_share"]
MEASURES = ("reward", "robot_s", "decision_ms")
"""Decision times are reported and not tested, as they depend on the machine."""
PLAIN = ["greedy", "history"]  # rules of thumb that ignore the cost of a wrong WASH
Place: TypeAlias = tuple[int, float]  # size of a log, and the proportion of its trajectories that is cut


@dataclass(frozen=True)
class Reward(Experiment):
    """Rewards by size of the log and proportion of cuts, beside heuristics and planners.

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
    name: ClassVar[str] = "reward"

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

    def prepare(self, setting: Setting) -> Piece:
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

    def measure(self, setting: Setting) -> Piece:
        """Decision times of all contenders [ms]."""
        times = Source.of(setting).decision_times_ms(self.contenders.values(), NUM_TIMED_STATES, self.laws)
        return {"decision_ms": times}

    def repeat(self, setting: Setting, prepared: Piece, index: int) -> Piece:
        """Learn from a fresh log at every size and proportion of cuts, and play all on the same fresh episodes.

        Its ``rows`` are rewards and robot times of policies that use a log, its ``baselines`` those of others beside
        the learned policy of Table 1 on the same episodes, and ``peer`` is the gain over planning with fitted laws.
        """
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
        logs, others = list(product((LEARNED.name, *self.beside_names), learned)), (ONE_STEP, *HEURISTICS)
        policies = [of_logs[name][at] for name, at in logs] + [each.policy(source.world) for each in others]
        each = source.control_each(policies, range(num_all), start)
        played = dict(zip(logs, each[: len(logs)], strict=True))
        place = self.table_num_trajectories, self.table_cut_share
        headline = played[LEARNED.name, place]
        rows = [{"policy": name} | dict(zip(KEYS, at, strict=True)) | one.means() for (name, at), one in played.items()]
        for row, one in zip(rows, learned.values(), strict=False):
            row |= one.weights | {"basis": one.basis}
        beside = {name: played[name, place] for name in self.beside_names}
        beside |= {other.name: one for other, one in zip(others, each[len(logs) :], strict=True)}
        baselines = [_beside(name, headline, range(num_all), one) for name, one in beside.items()]
        peer = []
        if index < self.planned_repetitions:
            baselines += self._planned(source, headline, fitted[place], start)
            earned = {at: played[LEARNED.name, at].reward for at in learned}
            peer = self._over_peer(source, fitted, earned, start)
        return {"rows": rows, "baselines": baselines, "peer": peer}

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

    def _planned(self, source: Source, headline: Played, fitted: WorldConfig, start: float) -> list[Row]:
        """Rewards of each planner, and of the policy of Table 1 on the same episodes."""
        planners = [(who.planner(size), source.world, count) for size, count in self.planners]
        found = []
        for each, world, num_episodes in (*planners, (self.peer, fitted, self.planners[0][1])):
            some = episodes_in_turn(source.index, num_episodes, len(headline.reward))
            (played,) = source.control_each([each.policy(world)], some, start)
            found.append(_beside(each.name, headline, some, played))
        return found

    def _over_peer(
        self, source: Source, fitted: Mapping[Place, WorldConfig], learned: Mapping[Place, Any], start: float
    ) -> list[Row]:
        """Plan with laws fitted to each log: num_trajectories, cut_share and over_peer of each place."""
        rows, mean = [], np.mean(list(learned.values()), axis=0)
        for rank, place in enumerate(learned):
            some = episodes_in_turn(source.index * len(learned) + rank, self.fitted_episodes, len(mean))
            (own,) = source.control_each([self.peer.policy(fitted[place])], some, start)
            gap = compare.over_peer(learned[place], mean, some, own.reward)
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
        rows, baselines = pieces.rows, pieces.table("baselines")
        weights = where(rows, policy=LEARNED.name)
        weights = weights.assign(by_laws=(weights["basis"] == MODEL).astype(float)).groupby(KEYS, sort=False)
        over = _with_means(wide(pieces.table("peer"), KEYS, "over_peer"))
        tests = [
            dict(zip(KEYS, place, strict=True))
            | compare.signed_rank_test(gain.dropna().to_numpy(), "two-sided").columns
            for place, gain in over.iterrows()
        ]
        chosen = strongest(self, pieces.prepared["selection"])
        return {
            "figure1": self._figure1(wide(rows, ["policy", *KEYS], "reward"), baselines, over, chosen),
            "table1": self._table1(setting, baselines, pieces.measured["decision_ms"]),
            "weights": weights[["effective_sample_size", "largest_weight", "by_laws"]].mean().reset_index(),
            "peer": compare.adjusted(tests, setting.alpha).astype({"cut_share": "Float64"}),
        }

    def _figure1(self, of_logs: Frame, baselines: Frame, over: Frame, chosen: Mapping[str, str]) -> Frame:
        own, other = (wide(baselines, ["policy"], name) for name in ("own_reward", "reward"))
        rule, peer = chosen[BEST[0]], self.peer.name
        # The strongest heuristic plays all episodes, as does the policy of Table 1.
        levels = own.loc[rule] - (own - other)
        levels.index = pd.MultiIndex.from_product([levels.index, [np.nan], [np.nan]], names=["policy", *KEYS])
        alone = [name for name in self.baseline_names if name not in (peer, *self.beside_names)]
        cells = {LEARNED.name: of_logs.loc[LEARNED.name]} | {name: levels.loc[name] for name in alone}
        cells[peer] = _with_means(of_logs.loc[LEARNED.name]).reindex(over.index) - over
        cells |= {name: _with_means(of_logs.loc[name]) for name in self.beside_names}
        rewards = pd.concat(cells, names=["policy"])
        num, gain = rewards.notna().sum(axis=1).rename("repetitions"), means(rewards - other.loc[rule], four("gain"))
        table: Frame = pd.concat([num, means(rewards), gain], axis=1).reset_index()
        roles = {name: role for role, name in chosen.items()}
        table.insert(list(table).index("gain"), "role", table["policy"].map(roles))
        return table.astype({"num_trajectories": "Int64", "cut_share": "Float64"})

    def _table1(self, setting: Setting, baselines: Frame, times_ms: Mapping[str, float]) -> Frame:
        rows = []
        for name, measure in product(self.baseline_names, MEASURES):
            row: Row = {"baseline": name, "measure": measure}
            played = where(baselines, policy=name)
            if measure == "decision_ms":
                own, other = times_ms[LEARNED.name], times_ms[name]
                test = {"p_value": np.nan, "effect": own - other}
            else:
                own, other = played[f"own_{measure}"].to_numpy(), played[measure].to_numpy()
                test = compare.better(own, other, measure).columns
            row |= {LEARNED.name: float(np.mean(own)), "other": float(np.mean(other))} | test
            rows.append(row | {"num_episodes": played["num_episodes"].sum()})
        table = compare.adjusted(rows, setting.alpha)
        return table.assign(num_episodes=table.pop("num_episodes"))

    def facts(self, setting: Setting, tables: Tables) -> dict[str, Any]:
        """Sizes of logs that suffice, verdicts, the best of a kind, times as written, and ways to clear a table."""
        figure1, table1, peer = tables["figure1"], tables["table1"], tables["peer"]
        times = {row["baseline"]: row["other"] for row in records(table1, measure="decision_ms")}
        times[LEARNED.name] = row_of(table1, measure="decision_ms")[LEARNED.name]
        return {
            "best_rule": row_of(figure1, role=BEST[0])["policy"],
            "best_planner": row_of(figure1, role=BEST[1])["policy"],
            "enough": grouped(self.cut_shares, lambda cut_share: sufficient(figure1, cut_share)),
            "verdicts": {name: grouped(records(table1, measure=name), compare.verdict_of) for name in MEASURES[:2]},
            "by_means": compare.by_verdict(records(peer, cut_share=None)),
            "by_proportions": compare.by_verdict(records(peer[peer["cut_share"].notna()])),
            "ms": {name: f"  ({significant(value, 2)} ms)" for name, value in times.items()},
            "ways": self._ways(setting, figure1),
        }

    def _ways(self, setting: Setting, figure1: Frame) -> Frame:
        """Reward of each way of clearing a table, relative to leaving it as it is.

        That costs, in expectation, the dirty objects left by FINISH at once.
        """
        world, at = setting.world, {"num_trajectories": self.table_num_trajectories}
        num_objects = float(np.mean([scene.num_objects for scene in setting.scenes]))
        plain = max(records(figure1, policy=PLAIN), key=lambda row: row["mean_reward"])
        wanted = [
            {"role": BEST[0]},
            {"policy": LEARNED.name, "cut_share": self.table_cut_share} | at,
            {"policy": self.peer.name, "cut_share": None} | at,
            {"role": BEST[1]},
        ]
        ways = pd.DataFrame([plain, *(row_of(figure1, **each) for each in wanted)])
        ways.index = pd.Index(["plain", "rule", "learned", "peer", "planner"])
        nothing = float(world.reward_dirty_left) * float(world.dirty_share) * num_objects
        points = [MEAN[0], *MEAN[2:]]
        return ways[["policy"]].join(ways[points].astype(float) - nothing)

    def draw_opening(self, known: dict[str, Any], title: str) -> Figure:
        """Draw the ways as bars."""
        ways = known["ways"].rename(index=known["names"]["ways"])
        colours = [known["looks"][name]["color"] for name in ways.pop("policy")]
        return draw_named_bars(ways, colours, known["names"]["points"], title)


def _with_means(cells: Frame) -> Frame:
    """Cells by size of log and proportion cut, and the means over all proportions, where that is null."""
    mean = cells.groupby("num_trajectories", sort=False).mean()
    mean.index = pd.MultiIndex.from_product([mean.index, [np.nan]], names=KEYS)
    return pd.concat([cells, mean])


def sufficient(figure1: Frame, cut_share: float) -> int | None:
    """The smallest log from which on the learned policy earns more than the strongest heuristic.

    At this size and at every larger one the 95 % interval of the paired difference lies above 0; None if even the
    largest log does not suffice.
    """
    rows = where(figure1, policy=LEARNED.name, cut_share=cut_share).sort_values("num_trajectories")
    too_few = np.flatnonzero(~(rows["gain_low"] > 0))
    enough = rows["num_trajectories"].iloc[too_few[-1] + 1 if len(too_few) else 0 :]
    return None if enough.empty else int(enough.iloc[0])


def _beside(name: str, headline: Played, episodes: Sequence[int], played: Played) -> Row:
    """Rewards and times of a baseline on some of the episodes, and of the learned policy of Table 1 on the same."""
    own = {f"own_{measure}": mean for measure, mean in headline.on(episodes).means().items()}
    return {"policy": name, "num_episodes": len(episodes)} | played.means() | own


def strongest(design: Reward, selection: dict[str, float]) -> dict[str, str]:
    """Role → the policy of a kind with the largest selection reward; the first of those tied."""
    kinds = [each.name for each in HEURISTICS], [name for name in selection if name in design.planner_names]
    return {role: max(names, key=lambda name: selection[name]) for names, role in zip(kinds, BEST, strict=True)}
