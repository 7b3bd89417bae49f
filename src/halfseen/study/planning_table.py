"""From the pieces of the planners to the tables of Figures 2 and 3, and to the planners' rows of Table 1."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy import stats

from halfseen.errors import ArgumentError
from halfseen.study.findings import LEARNED
from halfseen.study.planning import HORIZON_PREFIX, SEARCH_PREFIX
from halfseen.study.policies import HEURISTICS
from halfseen.study.results import MEASURES
from halfseen.study.statistics import mean_and_error, paired_test

LEARNED_KIND, HEURISTIC_KIND, PLANNER_KIND = "learned", "heuristic", "planner"
SLACK = 1.25
"""A decision is within a budget if its median time is within so many times that."""
TABLE1_COLUMNS = ["baseline", "measure", "cql", "other", "p_value", "effect", "effect_low", "effect_high"]


class Block(NamedTuple):
    """What a policy earned on the episodes of one repetition that it played, by number of the episode."""

    reward: dict[int, float]
    robot_s: dict[int, float]


class PlanningFrames(NamedTuple):
    """Blocks of each policy, one for each repetition."""

    blocks: dict[str, list[Block]]

    def means(self, policy: str, measure: str, like: str | None = None) -> Float[np.ndarray, " R"]:
        """Block means of a policy, on the episodes that `like` played as well (all, if None)."""
        own, others = self.blocks[policy], self.blocks[like or policy]
        return np.array(
            [
                np.mean([getattr(block, measure)[i] for i in getattr(other, measure)])
                for block, other in zip(own, others, strict=True)
            ]
        )

    def num_episodes(self, policy: str) -> int:
        """Episodes of a block."""
        return len(self.blocks[policy][0].reward)


def planning_frames(pieces: Sequence[Mapping[str, Any]]) -> PlanningFrames:
    """Sort the pieces of `halfseen.study.planning.run_planning_repetition` by policy.

    Raises
    ------
    ArgumentError
        There are fewer than two: errors are over repetitions.
    """
    if len(pieces) < 2:
        raise ArgumentError(f"{len(pieces)} repetition of the planners; errors need at least 2")
    blocks: dict[str, list[Block]] = {}
    for piece in pieces:
        for row in piece["played"]:
            rewards, times = (dict(zip(row["episodes"], row[name], strict=True)) for name in ("reward", "robot_s"))
            blocks.setdefault(row["policy"], []).append(Block(rewards, times))
    return PlanningFrames(blocks)


def figure2(frames: PlanningFrames, times_ms: Mapping[str, Float[np.ndarray, " S"]]) -> pd.DataFrame:
    """Reward of every policy against the time of its decision.

    Parameters
    ----------
    frames
        Of `planning_frames`.
    times_ms
        Decision times of every policy on some states [ms].

    Returns
    -------
    pandas.DataFrame
        policy, kind, simulations, decision_ms, mean_reward, se, low, high, over_cql, se_over, over_low, over_high,
        repetitions, episodes. decision_ms is the median over states. over_cql is the mean difference from the learned
        policy on the same episodes. Where a policy played only some, mean_reward is what the learned policy earned on
        all of them plus that difference: the luck of the few drops out as far as both share it. Errors are over block
        means of repetitions, intervals of 95 % by the t distribution; episodes are those of one block.
    """
    rows = []
    own = frames.means(LEARNED, "reward")
    for policy in frames.blocks:
        over = frames.means(policy, "reward") - frames.means(LEARNED, "reward", like=policy)
        rows.append(
            {
                "policy": policy,
                "kind": _kind(policy),
                "simulations": _search_simulations(policy),
                "decision_ms": float(np.median(times_ms[policy])),
                **_estimated(own + over, "mean_reward", "se", "low", "high"),
                **_estimated(over, "over_cql", "se_over", "over_low", "over_high"),
                "repetitions": len(over),
                "episodes": frames.num_episodes(policy),
            }
        )
    return pd.DataFrame(rows).astype({"simulations": "Int64"})


def figure3(
    frames: PlanningFrames, times_ms: Mapping[str, Float[np.ndarray, " S"]], num_simulations: int
) -> pd.DataFrame:
    """Reward of the planner by planning horizon.

    Parameters
    ----------
    frames, times_ms
        As for `figure2`.
    num_simulations
        Simulations a decision at each planning horizon beyond 1.

    Returns
    -------
    pandas.DataFrame
        planning_horizon, simulations (null at 1, which needs none), decision_ms, mean_reward, se, low, high;
        over_previous (the paired difference from the next shorter horizon), se_over_previous, over_previous_low,
        over_previous_high; over_first and so on (from the shortest); repetitions, episodes. Null where there is
        nothing shorter.
    """
    horizons = sorted(int(name.removeprefix(HORIZON_PREFIX)) for name in frames.blocks if _looks_ahead(name))
    rewards = [frames.means(f"{HORIZON_PREFIX}{h}", "reward") for h in horizons]
    rows = []
    for k, (horizon, reward) in enumerate(zip(horizons, rewards, strict=True)):
        row: dict[str, Any] = {
            "planning_horizon": horizon,
            "simulations": num_simulations if horizon > 1 else None,
            "decision_ms": float(np.median(times_ms[f"{HORIZON_PREFIX}{horizon}"])),
            **_estimated(reward, "mean_reward", "se", "low", "high"),
        }
        for name, shorter in (("over_previous", rewards[max(k - 1, 0)]), ("over_first", rewards[0])):
            estimated = _estimated(reward - shorter, name, f"se_{name}", f"{name}_low", f"{name}_high")
            row |= estimated if k else dict.fromkeys(estimated, np.nan)
        rows.append(row | {"repetitions": len(reward), "episodes": frames.num_episodes(f"{HORIZON_PREFIX}{horizon}")})
    return pd.DataFrame(rows).astype({"simulations": "Int64"})


def strongest_within(figure2: pd.DataFrame, budget_ms: float) -> str | None:
    """The planner that earns most among those that decide within a budget; None if there is none.

    Parameters
    ----------
    figure2
        The table of `figure2`.
    budget_ms
        Time of a decision [ms]; `SLACK` times that is still within it.
    """
    is_within = (figure2["kind"] == PLANNER_KIND) & (figure2["decision_ms"] <= SLACK * budget_ms)
    rows = pd.DataFrame(figure2[is_within])
    return None if rows.empty else str(rows.loc[rows["mean_reward"].idxmax(), "policy"])


def planner_rows(
    frames: PlanningFrames,
    figure2: pd.DataFrame,
    times_ms: Mapping[str, Float[np.ndarray, " S"]],
    budgets_ms: Mapping[str, float],
) -> pd.DataFrame:
    """Rows of Table 1 that hold the learned policy against the strongest planner within each budget, not adjusted.

    Parameters
    ----------
    frames, figure2, times_ms
        The pieces, the table made of them, and decision times.
    budgets_ms
        Baseline in Table 1 → time of a decision [ms].

    Returns
    -------
    pandas.DataFrame
        `TABLE1_COLUMNS`, a row for each measure and budget. Pairs are block means of repetitions, on the episodes that
        both played; of decision times, the states that both decided.
    """
    rows = []
    for name, budget_ms in budgets_ms.items():
        planner = strongest_within(figure2, budget_ms)
        if planner is None:
            continue
        for measure in MEASURES:
            ours, other = _pairs(frames, times_ms, planner, measure)
            test = paired_test(ours, other, is_more_better=measure == "reward")
            means = float(np.mean(ours)), float(np.mean(other))
            rows.append((name, measure, *means, test.p_value, test.effect, test.effect_low, test.effect_high))
    return pd.DataFrame(rows, columns=pd.Index(TABLE1_COLUMNS))


def _pairs(
    frames: PlanningFrames, times_ms: Mapping[str, Float[np.ndarray, " S"]], planner: str, measure: str
) -> tuple[Float[np.ndarray, " P"], Float[np.ndarray, " P"]]:
    if measure == "decision_ms":
        num_both = min(len(times_ms[LEARNED]), len(times_ms[planner]))
        return np.asarray(times_ms[LEARNED])[:num_both], np.asarray(times_ms[planner])[:num_both]
    return frames.means(LEARNED, measure, like=planner), frames.means(planner, measure)


def _estimated(values: Float[np.ndarray, " R"], *names: str) -> dict[str, float]:
    """Mean, standard error and ends of the 95 % interval, which the t distribution widens where blocks are few."""
    mean, error = mean_and_error(values)
    reach = float(stats.t.ppf(0.975, len(values) - 1)) * error
    return dict(zip(names, (mean, error, mean - reach, mean + reach), strict=True))


def _kind(policy: str) -> str:
    if policy == LEARNED:
        return LEARNED_KIND
    return HEURISTIC_KIND if policy in HEURISTICS else PLANNER_KIND


def _search_simulations(policy: str) -> int | None:
    return int(policy.removeprefix(SEARCH_PREFIX)) if policy.startswith(SEARCH_PREFIX) else None


def _looks_ahead(policy: str) -> bool:
    return policy.startswith(HORIZON_PREFIX)
