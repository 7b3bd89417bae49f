"""What the learned policy earns, by size of the log and proportion of cut trajectories: Figure 1, Tables 1 and 2."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from halfseen.shapes import Float
from halfseen.study.compare import adjusted, better, four, mean_columns, signed_rank_test, stacked
from halfseen.study.experiment import Pieces, Row, Section, Tables
from halfseen.study.experiments.reward_repetition import KEYS, RewardRepetition, strongest
from halfseen.study.experiments.reward_words import MEASURES, section_of
from halfseen.study.policies import BEST, LEARNED
from halfseen.study.setting import Setting
from halfseen.tables.learner import MODEL

WORTH = ["effective_sample_size", "largest_weight", "by_laws"]
Rewards = Float[np.ndarray, " R"]


@dataclass(frozen=True)
class Reward(RewardRepetition):
    """The experiment; its parameters are those of `RewardRepetition`."""

    name: ClassVar[str] = "reward"

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make all tables.

        Returns
        -------
        dict of pandas.DataFrame
            ``figure1``: policy, num_trajectories, cut_share, repetitions, mean_reward, se, low, high; role, which marks
            the heuristic and the planner that were the strongest on other episodes; and gain, gain_se, gain_low,
            gain_high, the paired difference from that heuristic. All rewards are by the control variate. A planner
            plays only some of the episodes: its mean is what the policy of Table 1 earned on all, less the paired
            difference on those. Of what is made of logs there is a row for each log; and, but for the learned policy,
            one for each size with the mean over all proportions of cut trajectories, where cut_share is null. What a
            planner with fitted laws earns is what the learned policy did, less what that earned over it. Repetitions
            are those in which a policy played.
            ``table1``: baseline, measure, censored_q, other, p_value, p_holm, effect, supported, effect_low,
            effect_high, num_episodes: one-sided paired tests that the learned policy is better (more reward, less
            time), on the episodes that both played; the effect is censored_q − other.
            ``peer``: num_trajectories, cut_share (null: the mean over all), p_value, p_holm, effect, supported,
            effect_low, effect_high: two-sided tests of what the learned policy earns over the planner with laws fitted
            to the same log; supported where they differ.
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
            "weights": weights.groupby(KEYS, sort=False)[WORTH].mean().reset_index(),
            "peer": adjusted(pd.DataFrame(tests), setting.alpha).astype({"cut_share": "Float64"}),
        }

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Say whether learning earns more, and how few logged trajectories suffice."""
        return section_of(self, setting, tables)


def _figure1(design: Reward, pieces: Pieces, chosen: dict[str, str]) -> pd.DataFrame:
    rule = chosen[BEST[0]]
    of_rule = _both(pieces, rule, "reward")[1]
    rows = _rows_of(LEARNED.name, stacked(pieces.repetitions, "learned", "reward"), of_rule)
    roles = {name: role for role, name in chosen.items()}
    for name in design.level_names:
        played = _where_played(pieces, name)
        own, other = _both(played, name, "reward")
        # The strongest heuristic plays all episodes, and the policy of Table 1 beside it.
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
    """What is learned or fitted from logs, in Figure 1: a row for each, beside the strongest heuristic."""
    return [{"policy": name} | {key: row[key] for key in KEYS} | _reckoned(row["reward"], rule) for row in logs]


def _reckoned(rewards: Rewards, rule: Rewards) -> Row:
    return {"repetitions": len(rewards)} | mean_columns(rewards) | mean_columns(rewards - rule, four("gain"))


def _where_played(pieces: Pieces, name: str) -> Pieces:
    """Keep the repetitions in which a baseline played."""
    return pieces._replace(repetitions=[piece for piece in pieces.repetitions if name in piece["baselines"]])


def _against_peer(pieces: Pieces) -> list[Row]:
    """By repetition: what learning earns over planning with laws fitted to the same log, and what that planning earns.

    A row for each log, and for each size the mean over all proportions of cut trajectories.
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


def _table1(design: Reward, setting: Setting, pieces: Pieces) -> pd.DataFrame:
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
    """The learned policy of Table 1 and a baseline, on the episodes that both played; measured times but once."""
    if measure == "decision_ms":
        own, other = (np.array([pieces.measured[measure][one]]) for one in (LEARNED.name, name))
        return own, other
    rows = [piece["baselines"][name] for piece in pieces.repetitions]
    own, other = (np.array([row[one][measure] for row in rows]) for one in (LEARNED.name, "other"))
    return own, other
