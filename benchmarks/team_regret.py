"""What two robots earn on tables of three objects, and how much less than the best there is.

Run it with ``python benchmarks/team_regret.py [--tables 4] [--decisions 2] [--played 400] [--price 0.0]``.
"""

import argparse

import jax
import jax.numpy as jnp
import numpy as np

from halfseen.planners.heuristics import GreedyPolicy
from halfseen.study.experiments.clutter.places import random_tables
from halfseen.team.config import TeamConfig
from halfseen.team.planners.grid_grasping import GridGrasping
from halfseen.team.planners.myopic import MyopicTeam
from halfseen.team.planners.regret import Contender, SmallTable, regret_table
from halfseen.team.planners.reservation import ReservingTeam
from halfseen.team.planners.rollout import TeamRollout
from halfseen.team.planners.round_robin import RoundRobin
from halfseen.team.policy import TeamOfRules, UniformTeam
from halfseen.team.state import Workspace
from halfseen.world import WorldConfig

NUM_OBJECTS = 3


def main() -> None:
    """Print a line for each policy."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tables", type=int, default=4)
    parser.add_argument("--decisions", type=int, default=2, help="of each robot")
    parser.add_argument("--played", type=int, default=400, help="times that a planner plays each table")
    parser.add_argument("--price", type=float, default=0.0, help="reward of each second, 0 or below")
    parser.add_argument("--seed", type=int, default=0)
    told = parser.parse_args()
    world = WorldConfig(horizon=told.decisions, grasping=GridGrasping())
    config = TeamConfig(world, (1.0, 1.0), told.price)
    scenes = random_tables(NUM_OBJECTS, 0.3, told.tables, np.random.default_rng(told.seed))
    tables = [SmallTable(scene, half_shared()) for scene in scenes]
    found = regret_table(tables, config, contenders(config), jax.random.key(told.seed), told.played)
    by_policy = found.groupby("policy", sort=False)
    print(f"{told.tables} tables of {NUM_OBJECTS}, 2 robots, {told.decisions} decisions each, price {told.price}")
    print(f"optimum {found.groupby('table')['optimum'].first().mean():.4f}")
    for name, rows in by_policy:
        error = np.sqrt((rows["error"] ** 2).sum()) / len(rows)
        print(
            f"{name:28s} value {rows['value'].mean():8.4f}  regret {rows['regret'].mean():7.4f} ± {error:.4f}  "
            f"{rows['seconds'].mean():6.1f} s a table"
        )


def half_shared() -> Workspace:
    """Object 0 is in reach of robot 0 alone, object 2 of robot 1 alone, object 1 of both."""
    reach = np.array([[True, True, False], [False, True, True]])
    return Workspace(jnp.asarray(reach), jnp.eye(NUM_OBJECTS, dtype=bool))


def contenders(config: TeamConfig) -> dict[str, Contender]:
    """All who are compared, the reference first."""
    world, price = config.world, config.reward_per_s
    greedy, history = (GreedyPolicy(world, uses_history, counts_penalty=True) for uses_history in (False, True))
    myopic = MyopicTeam(world, price)
    return {
        "look-ahead of one step": Contender(myopic),
        "history, reserving": Contender(ReservingTeam(history, price)),
        "greedy, reserving": Contender(ReservingTeam(greedy, price)),
        "history, first beginning": Contender(TeamOfRules(history)),
        "history, dealt in turn": Contender(RoundRobin(history, price)),
        "uniformly at random": Contender(UniformTeam()),
        "rollout under the look-ahead": Contender(TeamRollout(config, myopic), is_played=True),
    }


if __name__ == "__main__":
    main()
