"""From the pieces of the experiment to its tables."""

from typing import Any

import numpy as np
import pandas as pd

from halfseen.shapes import Float
from halfseen.study.experiment import Pieces, Setting, Tables
from halfseen.study.experiments.reward.design import RewardDesign
from halfseen.study.frames import stacked
from halfseen.study.policies import HEURISTICS, LEARNED
from halfseen.study.statistics import adjusted, mean_columns, paired_test, signed_rank_test, tested_columns
from halfseen.study.wording import is_reward
from halfseen.tables.learner import MODEL

MEASURES = {
    "reward": "reward of a trajectory",
    "robot_s": "robot time until a trajectory ends [s]",
    "decision_ms": "time of one decision [ms], measured on this machine",
}
"""Measure → name for people; times of decisions are told and not tested, as they depend on the machine."""
BEST = ("best_heuristic", "best_planner")
KEYS, WORTH = ["num_trajectories", "cut_share"], ["effective_sample_size", "largest_weight", "by_laws"]


def tables_of(design: RewardDesign, setting: Setting, pieces: Pieces) -> Tables:
    """Make all tables.

    Returns
    -------
    dict of pandas.DataFrame
        ``figure1``: policy, num_trajectories, cut_share, repetitions, mean_reward, se, low, high; role, which marks the
        heuristic and the planner that were the strongest on other episodes; and gain, gain_se, gain_low, gain_high,
        the paired difference from that heuristic. All rewards are by the control variate. A planner plays only some of
        the episodes: its mean is what the policy of Table 1 earned on all, less the paired difference on those. Of what
        is made of logs there is a row for each log; and, but for the learned policy, one for each size with the mean
        over all proportions of cut trajectories, where cut_share is null. What a planner with fitted laws earns is what
        the learned policy did, less what that earned over it. Repetitions are those in which a policy played.
        ``table1``: baseline, measure, censored_q, other, p_value, p_holm, effect, supported, effect_low, effect_high,
        num_episodes: one-sided paired tests that the learned policy is better (more reward, less time), on the episodes
        that both played; the effect is censored_q − other. ``peer``: num_trajectories, cut_share (null: the mean over
        all), p_value, p_holm, effect, supported, effect_low, effect_high: two-sided tests of what the learned policy
        earns over the planner with laws fitted to the same log, as `peer` reckons it; supported where they differ.
        ``weights``: num_trajectories, cut_share, effective_sample_size, largest_weight: means over repetitions; and
        by_laws, the share of logs that did not contradict the laws fitted to them, so that the policy is built on
        these.
    """
    weights = pd.DataFrame([row for piece in pieces.repetitions for row in piece["learned"]])
    weights = weights.assign(by_laws=(weights["basis"] == MODEL).astype(float))
    return {
        "figure1": _figure1(design, pieces, strongest(design, pieces.prepared["selection"])),
        "table1": _table1(design, setting, pieces),
        "weights": weights.groupby(KEYS, sort=False)[WORTH].mean().reset_index(),
        "peer": _peer(setting, _where_played(pieces, design.peer.name)),
    }


def strongest(design: RewardDesign, selection: dict[str, float]) -> dict[str, str]:
    """Role → the policy of a kind that earned most where they were chosen; the first of equals."""
    kinds = [each.name for each in HEURISTICS], [name for name in selection if name in design.planner_names]
    return {role: max(names, key=lambda name: selection[name]) for names, role in zip(kinds, BEST, strict=True)}


def _figure1(design: RewardDesign, pieces: Pieces, chosen: dict[str, str]) -> pd.DataFrame:
    rule = chosen[BEST[0]]
    learned = stacked(pieces.repetitions, "learned", "reward")
    rows = _rows_of(LEARNED.name, learned, _both(pieces, rule, "reward")[1])
    roles = {name: role for role, name in chosen.items()}
    for name in design.level_names:
        played = _where_played(pieces, name)
        own, other = _both(played, name, "reward")
        # The strongest heuristic plays all episodes, and the policy of Table 1 beside it.
        headline, of_rule = _both(played, rule, "reward")
        earned = headline - (own - other)
        rows.append({"policy": name, "role": roles.get(name)} | _mean_of(earned) | _gain_of(earned - of_rule))
    planned = _where_played(pieces, design.peer.name)
    rows += _rows_of(design.peer.name, _against_peer(planned), _both(planned, rule, "reward")[1])
    for name in design.beside_names:
        logs = stacked([piece["beside"] for piece in pieces.repetitions], name, "reward")
        rows += _rows_of(name, [*logs, *_means_by_size(logs)], _both(pieces, rule, "reward")[1])
    first = ["policy", *KEYS, "repetitions", "mean_reward", "se", "low", "high", "role"]
    table = pd.DataFrame(rows)
    return table.loc[:, [*first, *table.columns.drop(first)]].astype(
        {"num_trajectories": "Int64", "cut_share": "Float64"}
    )


def _means_by_size(logs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """For each size the mean over all proportions of cut trajectories."""
    of_size = {
        size: [row for row in logs if row["num_trajectories"] == size]
        for size in (row["num_trajectories"] for row in logs)
    }
    return [
        {"num_trajectories": size, "cut_share": None, "reward": np.mean([row["reward"] for row in rows], axis=0)}
        for size, rows in of_size.items()
    ]


def _rows_of(name: str, logs: list[dict[str, Any]], rule: Float[np.ndarray, " R"]) -> list[dict[str, Any]]:
    """What is learned or fitted from logs, in Figure 1: a row for each, beside the strongest heuristic."""
    return [
        {"policy": name} | {key: row[key] for key in KEYS} | _mean_of(row["reward"]) | _gain_of(row["reward"] - rule)
        for row in logs
    ]


def _mean_of(rewards: Float[np.ndarray, " R"]) -> dict[str, Any]:
    return {"repetitions": len(rewards)} | mean_columns(rewards)


def _gain_of(more: Float[np.ndarray, " R"]) -> dict[str, Any]:
    return mean_columns(more, "gain", "gain_se", "gain_low", "gain_high")


def _where_played(pieces: Pieces, name: str) -> Pieces:
    """Keep the repetitions in which a baseline played."""
    return pieces._replace(repetitions=[piece for piece in pieces.repetitions if name in piece["baselines"]])


def _against_peer(pieces: Pieces) -> list[dict[str, Any]]:
    """By repetition: what learning earns over planning with laws fitted to the same log, and what that planning earns.

    A row for each log, and for each size the mean over all proportions of cut trajectories.
    """
    met, learned = ([piece[name] for piece in pieces.repetitions] for name in ("peer", "learned"))
    over = np.array([[row["over_peer"] for row in rows] for rows in met])
    reward = np.array([[row["reward"] for row in rows] for rows in learned]) - over
    sizes = np.array([row["num_trajectories"] for row in met[0]])
    logs: list[tuple[int, float | None, Any]] = [
        (row["num_trajectories"], row["cut_share"], [k]) for k, row in enumerate(met[0])
    ]
    logs += [(size, None, sizes == size) for size in dict.fromkeys(sizes.tolist())]
    return [
        {
            "num_trajectories": size,
            "cut_share": share,
            "over": over[:, which].mean(axis=1),
            "reward": reward[:, which].mean(axis=1),
        }
        for size, share, which in logs
    ]


def _peer(setting: Setting, pieces: Pieces) -> pd.DataFrame:
    rows = [
        {name: row[name] for name in KEYS} | tested_columns(signed_rank_test(row["over"], "two-sided"))
        for row in _against_peer(pieces)
    ]
    return adjusted(pd.DataFrame(rows), setting.alpha).astype({"cut_share": "Float64"})


def _table1(design: RewardDesign, setting: Setting, pieces: Pieces) -> pd.DataFrame:
    rows, counts = [], []
    for name in design.baseline_names:
        played = _where_played(pieces, name)
        for measure in MEASURES:
            own, other = _both(played, name, measure)
            means = {LEARNED.name: float(own.mean()), "other": float(other.mean())}
            if measure == "decision_ms":
                test = {"p_value": np.nan, "effect": float((own - other)[0])}
            else:
                test = tested_columns(paired_test(own, other, is_more_better=is_reward(measure)))
            rows.append({"baseline": name, "measure": measure} | means | test)
            counts.append(sum(piece["baselines"][name]["num_episodes"] for piece in played.repetitions))
    return adjusted(pd.DataFrame(rows), setting.alpha).assign(num_episodes=counts)


def _both(pieces: Pieces, name: str, measure: str) -> tuple[Float[np.ndarray, " R"], Float[np.ndarray, " R"]]:
    """The learned policy of Table 1 and a baseline, on the episodes that both played; measured times but once."""
    if measure == "decision_ms":
        own, other = (np.array([pieces.measured[measure][who]]) for who in (LEARNED.name, name))
    else:
        rows = [piece["baselines"][name] for piece in pieces.repetitions]
        own, other = (np.array([row[who][measure] for row in rows]) for who in (LEARNED.name, "other"))
    return own, other
