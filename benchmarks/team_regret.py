"""What each policy of a team earns less than the exact optimum: two robots, three objects, no simulation noise.

python benchmarks/team_regret.py [--out runs/benchmarks/team_regret.json] [--horizon 2] [--prices 0 -0.1] [--futures 64]

Both values are exact expectations in the model of `halfseen.team.optimum_model`. Robot 0 reaches objects 0 and 1, robot
1 objects 1 and 2; each has so many decisions. A policy that samples is valued for the draws of one key.
"""

import argparse
import json
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from halfseen.planners.heuristics import GreedyPolicy
from halfseen.team.config import TeamConfig
from halfseen.team.optimum import TeamOptimum, team_policy_value
from halfseen.team.optimum_model import GridGrasping, SmallTeam
from halfseen.team.policy import TeamOfRules, TeamPolicy
from halfseen.team.rollout import RolloutTeam
from halfseen.team.rules import OneAtATime, ReservingTeam, RoundRobin
from halfseen.world import WorldConfig

HIDES = np.array([[0.0, 0.5, 0.2], [0.0, 0.0, 0.4], [0.0, 0.0, 0.0]])
REACH = np.array([[True, True, False], [False, True, True]])
PRICES = (0.0, -0.1)


def team_of(horizon: int, reward_per_s: float) -> SmallTeam:
    """The team at its table."""
    world = WorldConfig(horizon=horizon, grasping=GridGrasping())
    config = TeamConfig(world, (1.0, 1.0), reward_per_s=reward_per_s)
    return SmallTeam(config, HIDES, REACH, np.eye(len(HIDES), dtype=bool))


def policies_of(config: TeamConfig, num_futures: int) -> Mapping[str, TeamPolicy]:
    """Everyone, by the name that is printed."""
    history = GreedyPolicy(config.world, uses_history=True, counts_penalty=True)
    reserving = ReservingTeam(config, history)
    return {
        "greedy": TeamOfRules(GreedyPolicy(config.world)),
        "history": TeamOfRules(GreedyPolicy(config.world, uses_history=True)),
        "history, counts what is left": TeamOfRules(history),
        "and the price of time": reserving,
        "round robin": RoundRobin(history),
        "one at a time": OneAtATime(history),
        f"rollout, {num_futures} futures": RolloutTeam(config, reserving, num_futures),
        f"rollout, {num_futures} futures, bold": RolloutTeam(config, reserving, num_futures, caution=0.0),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/team_regret.json"))
    parser.add_argument("--horizon", type=int, default=2, help="decisions of each robot")
    parser.add_argument("--prices", type=float, nargs="+", default=PRICES, help="of a second")
    parser.add_argument("--futures", type=int, default=64, help="of each action, in a rollout")
    args = parser.parse_args()
    rows = []
    for price in args.prices:
        team, begin_s = team_of(args.horizon, price), time.perf_counter()
        optimum = TeamOptimum(team)
        print(f"\n{price} per second: optimum {optimum.value:.4f}, {optimum.num_states:,} states", end="")
        print(f", {time.perf_counter() - begin_s:.0f} s\n{'policy':34}{'value':>9}{'regret':>9}")
        for name, policy in policies_of(team.config, args.futures).items():
            value = team_policy_value(team, policy)
            print(f"{name:34}{value:9.4f}{optimum.value - value:9.4f}", flush=True)
            rows.append({"reward_per_s": price, "policy": name, "value": value, "regret": optimum.value - value})
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(rows, indent=2), encoding="utf-8")
    print(f"Results: {args.out}")


if __name__ == "__main__":
    main()
