"""How much everyone earns less than the best there is, on small tables that are solved exactly."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError
from halfseen.planners.futures import as_expected, future
from halfseen.team.config import TeamConfig
from halfseen.team.dynamics import TEAM
from halfseen.team.planners.grid_optimum import TeamOptimum, solve_team
from halfseen.team.policy import TeamPolicy
from halfseen.team.state import TeamLayout, Workspace
from halfseen.world.scene import Scene
from halfseen.world.state import pad_scenes

NUM_PLAYED = 400
BATCH = 4
"""Tables that are played side by side: a planner holds its futures of each."""


@dataclass(frozen=True)
class SmallTable:
    """A table that is small enough to be solved, and who reaches what of it."""

    scene: Scene
    workspace: Workspace


@dataclass(frozen=True, eq=False)
class Contender:
    """A policy whose regret is wanted.

    Parameters
    ----------
    policy
        Any policy of a team.
    is_played
        Whether tables are played, in place of asking the policy in every state that it can reach: for a policy that
        takes its time.
    """

    policy: TeamPolicy
    is_played: bool = False


def regret_table(
    tables: Sequence[SmallTable],
    config: TeamConfig,
    contenders: Mapping[str, Contender],
    key: jax.Array,
    num_played: int = NUM_PLAYED,
) -> pd.DataFrame:
    """Tell what each policy earns on small tables, and how much less than the best one.

    Parameters
    ----------
    tables
        Small tables.
    config
        The team; its world's law of grasping is a `GridGrasping`.
    contenders
        Policies by name. The first is not played: those that are, are compared with it over the same draws, and its
        exact value takes most of their noise out.
    key
        What is drawn from.
    num_played
        Times that each table is played, ≥ 2, where one is.

    Returns
    -------
    pd.DataFrame
        A row for each table and policy, columns table, policy, optimum, value, regret, error (standard error of both; 0
        where the policy was asked in every state) and seconds.

    Raises
    ------
    ArgumentError
        There is no table or no contender, the first contender is to be played, or `num_played` is below 2.
    """
    _check(tables, contenders, num_played)
    rows = []
    for number, table in enumerate(tables):
        optimum = solve_team(table.scene, config, table.workspace)
        at = jax.random.fold_in(key, number)
        first = _asked(optimum, next(iter(contenders.values())).policy, at)
        for name, contender in contenders.items():
            begin_s = time.perf_counter()
            if contender.is_played:
                base = next(iter(contenders.values())).policy
                gain = _played(config, table, contender.policy, at, num_played)
                gain = gain - _played(config, table, base, at, num_played)
                value, error = first + gain.mean(), gain.std(ddof=1) / np.sqrt(num_played)
            else:
                value, error = _asked(optimum, contender.policy, at), 0.0
            rows.append(
                {
                    "table": table.scene.name,
                    "policy": name,
                    "optimum": optimum.value,
                    "value": value,
                    "regret": optimum.value - value,
                    "error": error,
                    "seconds": time.perf_counter() - begin_s,
                }
            )
    return pd.DataFrame(rows)


def _check(tables: Sequence[SmallTable], contenders: Mapping[str, Contender], num_played: int) -> None:
    if not tables or not contenders:
        raise ArgumentError(f"{len(tables)} tables and {len(contenders)} contenders; give at least one of each")
    first = next(iter(contenders))
    if contenders[first].is_played:
        raise ArgumentError(f"{first} comes first and is to be played; let one come first whose value is exact")
    if num_played < 2:
        raise ArgumentError(f"num_played is {num_played}; a standard error needs at least 2")


def _asked(optimum: TeamOptimum, policy: TeamPolicy, key: jax.Array) -> float:
    return optimum.policy_value(policy, key)


def _played(config: TeamConfig, table: SmallTable, policy: TeamPolicy, key: jax.Array, num_played: int) -> np.ndarray:
    """What a policy earns each time, what is drawn of being dirty integrated out."""
    layout = TeamLayout(jax.tree.map(lambda leaf: leaf[0], pad_scenes([table.scene])), table.workspace)
    return np.asarray(_earned(config, layout, policy, jax.random.split(key, num_played)), dtype=np.float64)


@jax.jit
def _earned(config: TeamConfig, layout: TeamLayout, policy: TeamPolicy, keys: jax.Array) -> jax.Array:
    def one(key: jax.Array) -> jax.Array:
        start_key, first_key, play_key = jax.random.split(key, 3)
        state, hidden = TEAM.start(config, layout, start_key)
        action = policy.decide(state, first_key).action.astype(jnp.int32)
        told = future(TEAM, config, (state, hidden), action, policy, play_key)
        is_there = state.table.is_on_table
        return as_expected(config.world, told.reward, is_there, told.state.table, told.hidden.table)

    return jax.lax.map(one, keys, batch_size=BATCH)
