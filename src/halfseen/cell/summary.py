"""Summary of a policy's runs in physics: rewards, cups and failures, and the prediction of the simulated world."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import pandas as pd

from halfseen.arrays import Rows
from halfseen.cell.episode import TeamRun
from halfseen.cell.rewards import Run
from halfseen.censoring import censoring_weights
from halfseen.evaluation.estimate import Estimate, estimate_of
from halfseen.logs import Logs
from halfseen.planners.pomdp import POMDPPolicy
from halfseen.world import random
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy
from halfseen.world.rollout import evaluate
from halfseen.world.scene import Scene
from halfseen.world.state import pad_scenes

LEVEL = 0.95
EPISODES_PER_TABLE, EPISODES_OF_A_PLANNER = 200, 4
"""Simulated episodes per table for the prediction. Physics has one per table. A planner's episodes take a thousand
times as long, so it plays only as many as add a quarter to the variance of that one."""
_LEAST = 1e-12
_FEWEST_FINISHED = 2
_COUNTS = ("num_cups", "num_racked", "num_toppled", "num_fallen", "num_dirty", "num_washed")
_OF_TEAM = ("num_collisions", "num_waits", "waited_s", "num_deadlocks", "num_gave_way")


@dataclass(frozen=True)
class Summary:
    """Summary of a policy's runs.

    Parameters
    ----------
    reward
        Mean reward per table, with finished tables weighted to represent cut ones; None if fewer than two finished.
    predicted
        Mean reward of the simulated world on the same tables, as seen in their first look; None for several arms.
    luck
        Part of the reward due to which cups were dirty; near 0 if P(DIRTY) is calibrated. None as for `reward`.
    without_luck
        Reward minus luck, which has a smaller variance; None as for `reward`.
    gap, gap_without_luck
        Mean difference per table of the reward, and of the reward without luck, from the prediction; None as for
        `reward`. If P(DIRTY) is not calibrated, the second omits the cost of that.
    seconds
        Mean duration on the cell's clock [s].
    counts
        Number of cups and their outcomes, over all tables.
    verbs, failures, causes
        Counts of verbs, of reasons for failed attempts, and of causes of cuts.
    together
        Conflicts between several arms over all tables, as in `TeamRun`; None for one arm.
    """

    reward: Estimate | None
    luck: Estimate | None
    without_luck: Estimate | None
    predicted: Estimate | None
    gap: Estimate | None
    gap_without_luck: Estimate | None
    seconds: float
    counts: Mapping[str, int]
    verbs: Mapping[str, int]
    failures: Mapping[str, int]
    causes: Mapping[str, int]
    together: Mapping[str, int | float] | None = None


def summarised(runs: Sequence[Run], logs: Logs, policy: Policy, config: WorldConfig, seed: int) -> Summary:
    """Summarise the runs of a policy.

    Parameters
    ----------
    logs
        Log of the runs, in the same order, without those that were cut before any decision.
    """
    seen = [run for run in runs if run.is_seen]
    rewards, luck = (np.array([getattr(run, name) for run in seen]) for name in ("reward", "luck"))
    weights = _weights(seen)
    teams = [run for run in runs if isinstance(run, TeamRun)]
    expected = None if teams else predicted(scenes_of(logs), cast(Policy, policy), config, seed)
    return Summary(
        reward=_mean(rewards, weights),
        luck=_mean(luck, weights),
        without_luck=_mean(rewards - luck, weights),
        predicted=None if expected is None else estimate_of(expected, len(expected), LEVEL),
        gap=None if expected is None else _mean(rewards - expected, weights),
        gap_without_luck=None if expected is None else _mean(rewards - luck - expected, weights),
        seconds=float(np.mean([run.seconds for run in runs])),
        counts={name: sum(getattr(run, name) for run in runs) for name in _COUNTS},
        verbs=_added(run.verbs for run in runs),
        failures=_added(run.failures for run in runs),
        causes=_added({run.cause: 1} for run in runs if run.cause is not None),
        together={name: sum(getattr(run, name) for run in teams) for name in _OF_TEAM} if teams else None,
    )


def predicted(scenes: Sequence[Scene], policy: Policy, config: WorldConfig, seed: int) -> Rows:
    """Mean reward of each table in a simulated world."""
    per_table = EPISODES_OF_A_PLANNER if isinstance(policy, POMDPPolicy) else EPISODES_PER_TABLE
    totals = evaluate(config, pad_scenes(scenes), policy, random.key_of(seed), per_table * len(scenes))
    rewards = np.asarray(totals.reward, dtype=np.float64)
    # Episodes cycle through the tables.
    return rewards.reshape(per_table, len(scenes)).mean(axis=0)


def _weights(runs: Sequence[Run]) -> Rows:
    """Censoring weights of the tables, 0 for cut ones; their mean is 1."""
    is_finished = np.array([run.cause is None for run in runs])
    weights = censoring_weights(np.array([run.seconds for run in runs]), is_finished)
    return weights / max(float(weights.mean()), _LEAST)


def _mean(values: Rows, weights: Rows) -> Estimate | None:
    if np.count_nonzero(weights) < _FEWEST_FINISHED:
        return None
    centre = float(np.average(values, weights=weights))
    size = weights.sum() ** 2 / (weights**2).sum()
    return estimate_of(centre + weights * (values - centre), float(size), LEVEL)


def scenes_of(logs: Logs) -> list[Scene]:
    """Tables as seen in their first look, in the order of the log."""
    assert logs.objects is not None, "tables have objects"
    first = pd.DataFrame(logs.objects[logs.objects["stage"] == 1])
    return [
        Scene(
            np.array(rows["hidden_by"].tolist(), dtype=np.float64), str(trajectory), np.array(rows["grip"], np.float64)
        )
        for trajectory, rows in first.groupby("trajectory", sort=True)
    ]


def _added(each: Iterable[Mapping[str, int]]) -> dict[str, int]:
    return dict(sum(map(Counter, each), Counter()).most_common())
