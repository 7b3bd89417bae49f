"""From the pieces of the experiment to its tables."""

from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from halfseen.study.experiment import Pieces, Setting, Tables
from halfseen.study.experiments.reward.design import RewardDesign
from halfseen.study.frames import where
from halfseen.study.policies import HEURISTICS, LEARNED
from halfseen.study.statistics import adjusted, columns, mean_columns, over_repetitions, paired_test, tested_columns

MEASURES = {
    "reward": "reward of a path",
    "robot_s": "robot time until a path ends [s]",
    "decision_ms": "time of one decision [ms], measured on this machine",
}
"""Measure → name for people; times of decisions are told and not tested, as they depend on the machine."""
BEST = ("best_heuristic", "best_planner")


def tables_of(design: RewardDesign, setting: Setting, pieces: Pieces) -> Tables:
    """Make all tables.

    Returns
    -------
    dict of pandas.DataFrame
        ``figure1``: policy, num_paths, cut_share, repetitions, mean_reward, se, low, high; role, which marks the
        heuristic and the planner that were the strongest on other episodes; and gain, gain_se, gain_low, gain_high,
        the paired difference from that heuristic. A planner plays only some of the episodes: its mean is what the
        policy of Table 1 earned on all, less the paired difference on those.
        ``table1``: baseline, measure, censored_q, other, p_value, p_holm, effect, supported, effect_low, effect_high,
        num_episodes: one-sided paired tests that the learned policy is better (more reward, less time), on the
        episodes that both played; the effect is censored_q − other.
        ``weights``: num_paths, cut_share, effective_sample_size, largest_weight: means over repetitions.
    """
    learned = pd.DataFrame(
        [{"index": piece["index"]} | row for piece in pieces.repetitions for row in piece["learned"]]
    )
    chosen = strongest(design, pieces.prepared["selection"])
    worth = ["effective_sample_size", "largest_weight"]
    return {
        "figure1": _figure1(design, pieces, learned, chosen),
        "table1": _table1(design, setting, pieces, learned),
        "weights": learned.groupby(["num_paths", "cut_share"], sort=False)[worth].mean().reset_index(),
    }


def strongest(design: RewardDesign, selection: dict[str, float]) -> dict[str, str]:
    """Policy → its role: of each kind the one that earned most where they were chosen; the first of equals."""
    kinds = [each.name for each in HEURISTICS], [name for name in selection if name in design.planner_names]
    return {max(names, key=lambda name: selection[name]): role for names, role in zip(kinds, BEST, strict=True)}


def _figure1(design: RewardDesign, pieces: Pieces, learned: pd.DataFrame, chosen: dict[str, str]) -> pd.DataFrame:
    (best_rule,) = (name for name, role in chosen.items() if role == BEST[0])
    rule = _heuristic(pieces, best_rule, "reward")
    rows: list[dict[str, Any]] = []
    for key, group in learned.groupby(["cut_share", "num_paths"], sort=False):
        share, size = float(key[0]), int(key[1])  # pyright: ignore
        own = group["reward"].to_numpy(dtype=float)
        gain = columns(over_repetitions(own - rule), "gain", "gain_se", "gain_low", "gain_high")
        rows.append({"policy": LEARNED.name, "num_paths": size, "cut_share": share} | mean_columns(own) | gain)
    headline = _headline(design, learned)["reward"].to_numpy(dtype=float)
    for name in design.contenders:
        if name in design.planner_names:
            own, other = _planned(pieces, name, "reward")
            values = headline - (own - other)
        elif name == LEARNED.name:
            continue
        else:
            values = _heuristic(pieces, name, "reward")
        rows.append({"policy": name, "role": chosen.get(name)} | mean_columns(values))
    first = ["policy", "num_paths", "cut_share", "repetitions", "mean_reward", "se", "low", "high", "role"]
    table = pd.DataFrame(rows).assign(repetitions=len(pieces.repetitions))
    return table.loc[:, [*first, *table.columns.drop(first)]].astype({"num_paths": "Int64", "cut_share": "Float64"})


def _table1(design: RewardDesign, setting: Setting, pieces: Pieces, learned: pd.DataFrame) -> pd.DataFrame:
    headline = _headline(design, learned)
    rows = []
    for name in design.baseline_names:
        for measure in MEASURES:
            if measure == "decision_ms":
                own, other = (np.array([pieces.measured["decision_ms"][each]]) for each in (LEARNED.name, name))
                test = {"p_value": np.nan, "effect": float((own - other)[0])}
            else:
                own, other = (
                    _planned(pieces, name, measure)
                    if name in design.planner_names
                    else (headline[measure].to_numpy(dtype=float), _heuristic(pieces, name, measure))
                )
                test = tested_columns(paired_test(own, other, is_more_better=measure == "reward"))
            means = {LEARNED.name: float(own.mean()), "other": float(other.mean())}
            rows.append({"baseline": name, "measure": measure} | means | test)
    table = adjusted(pd.DataFrame(rows), setting.alpha)
    first = pieces.repetitions[0]
    block = design.episodes_per_scene * len(setting.scenes)
    played = {name: row["num_episodes"] for name, row in first["planners"].items()}
    count = table["baseline"].map(lambda name: played.get(name, block) * len(pieces.repetitions))
    return table.assign(num_episodes=count)


def _headline(design: RewardDesign, learned: pd.DataFrame) -> pd.DataFrame:
    return where(learned, num_paths=design.table_num_paths, cut_share=design.table_cut_share)


def _heuristic(pieces: Pieces, name: str, measure: str) -> Float[np.ndarray, " R"]:
    return np.array([piece["heuristics"][name][measure] for piece in pieces.repetitions])


def _planned(pieces: Pieces, name: str, measure: str) -> tuple[Float[np.ndarray, " R"], Float[np.ndarray, " R"]]:
    """The learned policy and a planner, on the episodes that the planner played."""
    rows = [piece["planners"][name] for piece in pieces.repetitions]
    return np.array([row[LEARNED.name][measure] for row in rows]), np.array([row[measure] for row in rows])
