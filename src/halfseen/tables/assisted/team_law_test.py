"""Does the log of a team contradict the laws that were fitted to it? By what ended in each stage, on the weighted log.

The value that a team's myopic look puts on what follows is no exact expectation, so that R + V(S') − Q(S, A) does not
have mean 0 under true laws, as it has for one robot (`law_test`). What laws say of a single step is exact:

=======  ============================================================================================================
grasps   1{an attempt held} − P(it holds | what is known as it begins)
dirt     1{an object that left the table was dirty} − P(DIRTY) just before
labels   what a look moved P(DIRTY), summed over the objects that stay
=======  ============================================================================================================

Each has mean 0, weighted by δ / Ĝ(U⁻) of the stage in which it shows, times whatever is known before. Sums over
trajectories are tested together by Hotelling's T². The last two are about the log-odds that the policy goes by.
"""

from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import expit, mapped
from halfseen.learning.rows import stage_places
from halfseen.logs import Logs
from halfseen.planners.belief import belief_of
from halfseen.planners.one_step import HELD, outlook_of, setting_of, table_of
from halfseen.shapes import Bool, Float, Int
from halfseen.tables.assisted.law_test import LawTest, hotelling
from halfseen.tables.grasp.attempts import attempts
from halfseen.tables.laws.team_evidence import NUM_LEFT, Brought, beside_prices
from halfseen.world.config import WorldConfig
from halfseen.world.log_rows import begun_objects
from halfseen.world.state import TableState

FEWEST = 80
"""Trajectories below which nothing is tested: misses are rare, and T² of sums with such tails rejects too often."""


class Foretold(NamedTuple):
    """What was other than foretold, in R places."""

    trajectory: Int[np.ndarray, " R"]
    residual: Float[np.ndarray, " R"]
    """Weighted."""
    described: Float[np.ndarray, "R k"]
    """What is known before; 1 first."""

    def sums(self, num_trajectories: int) -> Float[np.ndarray, "n k"]:
        """Σ of the residuals times what is known, of each trajectory."""
        each = self.residual[:, None] * self.described
        found = np.zeros((num_trajectories, each.shape[1]))
        np.add.at(found, self.trajectory, each)
        return found


def tested_on_team(
    config: WorldConfig, logs: Logs, states: TableState, brought: Brought, weight: Float[np.ndarray, "n T"]
) -> LawTest:
    """Test the laws.

    Parameters
    ----------
    config
        The team with its fitted laws.
    logs, states, brought
        The log, its states and what its stages brought.
    weight
        δ / Ĝ(U⁻) of each stage; 0 where it was not completed.
    """
    groups = {
        "grasps": _grasps(config, logs, states, weight),
        "dirt": _dirt(config, states, brought, weight),
        "labels": _labels(states, brought, weight),
    }
    sums = {name: found.sums(logs.num_trajectories) for name, found in groups.items()}
    z = {name: _z(each[:, 0]) for name, each in sums.items()}
    if logs.num_trajectories < FEWEST:
        return LawTest(0.0, 1.0, z)
    return LawTest(*hotelling(np.concatenate([*sums.values()], axis=1)), z)


def _z(each: Float[np.ndarray, " n"]) -> float:
    return float(each.sum() / max(np.sqrt((each**2).sum()), 1e-12))


def _grasps(config: WorldConfig, logs: Logs, states: TableState, weight: Float[np.ndarray, "n T"]) -> Foretold:
    """Of attempts whose end was seen; each counts by the weight of the stage in which it ended."""
    tried: Any = attempts(logs)
    tried = tried[tried["is_finished"].to_numpy(dtype=bool)]
    row = logs.stages.set_index(["trajectory", "stage"]).index.get_indexer(
        tried.set_index(["trajectory", "stage"]).index
    )
    trajectory, stage, target = stage_places(logs)[0][row], tried["stage"].to_numpy() - 1, begun_objects(logs)[row]
    there = mapped(lambda leaf: leaf[trajectory, stage], states)
    robot, number = tried["robot"].to_numpy(), np.arange(len(row))
    expected = np.zeros(len(row))
    for k in range(config.num_robots):
        table = table_of(belief_of(config, there))
        world = config.as_robot(k)
        look = outlook_of(world, table, setting_of((world,), table))
        expected = np.where(robot == k, look.expected[0][HELD][target, number], expected)
        if not config.has_own_laws:
            expected = look.expected[0][HELD][target, number]
            break
    is_held = tried["succeeded"].to_numpy(dtype=bool)
    columns = (tried["occlusion"].to_numpy(dtype=np.float64), tried["failures"].to_numpy(dtype=np.float64))
    of_end = weight[trajectory, _ended_in(states, weight, trajectory, stage, robot)]
    return Foretold(trajectory, of_end * (is_held - expected), np.column_stack([np.ones(len(row)), *columns]))


def _ended_in(
    states: TableState,
    weight: Float[np.ndarray, "n T"],
    trajectory: Int[np.ndarray, " R"],
    stage: Int[np.ndarray, " R"],
    robot: Int[np.ndarray, " R"],
) -> Int[np.ndarray, " R"]:
    """The stage in which what a robot began came to its end: the last one before that in which it is free again."""
    assert states.robots is not None
    horizon = weight.shape[1]
    number = np.arange(horizon)
    is_stage = np.any(states.is_on_table, axis=-1)[trajectory]
    is_free = ~states.robots.is_busy[trajectory, :, robot] & is_stage & (number > stage[:, None])
    first = np.where(is_free.any(axis=1), is_free.argmax(axis=1), is_stage.sum(axis=1))
    return np.clip(first - 1, 0, horizon - 1)


def _dirt(config: WorldConfig, states: TableState, brought: Brought, weight: Float[np.ndarray, "n T"]) -> Foretold:
    """Of objects that left the table alone."""
    at = np.nonzero(brought.goes_on & (brought.outcome[..., NUM_LEFT] == 1) & (weight > 0.0))
    target = brought.has_left[at].argmax(axis=-1)
    p = expit(states.log_odds[(*at, target)].astype(np.float64))
    paid = beside_prices(brought, config)[at]
    is_dirty = np.abs(paid - config.reward_wash_dirty) < np.abs(paid - config.reward_wash_clean)
    seen = states.seen[(*at, target)].astype(np.float64)
    return Foretold(at[0], weight[at] * (is_dirty - p), np.column_stack([np.ones(len(p)), p, seen]))


def _labels(states: TableState, brought: Brought, weight: Float[np.ndarray, "n T"]) -> Foretold:
    """Of what stays on the table from one stage to the next."""
    p = np.where(states.is_on_table, expit(states.log_odds.astype(np.float64)), 0.0)
    stays: Bool[np.ndarray, "n T N"] = states.is_on_table & np.roll(states.is_on_table, -1, axis=1)
    moved = np.where(stays & brought.goes_on[..., None], np.roll(p, -1, axis=1) - p, 0.0)
    at = np.nonzero(brought.goes_on & (weight > 0.0))
    whole, likely = moved.sum(axis=-1)[at], (moved * (p > 0.5)).sum(axis=-1)[at]
    return Foretold(at[0], weight[at], np.column_stack([whole, likely]))
