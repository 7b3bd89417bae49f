"""What each policy of a team earns less than the exact optimum: two robots, three objects.

python benchmarks/team_regret.py [--out runs/benchmarks/team_regret.json] [--horizon 2] [--prices 0 -0.1] [--futures 32]
                                 [--keys 4]

Robot 0 reaches objects 0 and 1, robot 1 objects 1 and 2; each has so many decisions, under the law of grasping
`GridGrasping`. Both values are exact expectations. A rollout is asked once in every state for each of
some keys, from which its futures are drawn; its interval is over them.
"""

import argparse
import json
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from halfseen.planners.exact import TeamOptimum, solve_team
from halfseen.planners.exact_table import GridGrasping
from halfseen.planners.futures import RolloutPolicy
from halfseen.planners.heuristics import GreedyPolicy, OneAtATime, ReservingPolicy, RoundRobin, TeamOfRules
from halfseen.planners.myopic import MyopicPolicy
from halfseen.tables.policy import IndependentPolicies
from halfseen.world import WorldConfig, random
from halfseen.world.policy import Policy, UniformPolicy
from halfseen.world.state import Workspace

HIDES = np.array([[0.0, 0.5, 0.2], [0.0, 0.0, 0.4], [0.0, 0.0, 0.0]])
REACH = np.array([[True, True, False], [False, True, True]])
PRICES = (0.0, -0.1)


def config_of(horizon: int, reward_per_s: float) -> WorldConfig:
    """The team in its world."""
    return WorldConfig(horizon=horizon, grasping=GridGrasping(), speed=(1.0, 1.0), reward_per_s=reward_per_s)


def policies_of(config: WorldConfig) -> Mapping[str, Policy]:
    """Everyone who draws nothing, by the name that is printed."""
    greedy = GreedyPolicy(config, counts_penalty=True)
    history = GreedyPolicy(config, uses_history=True, counts_penalty=True)
    return {
        "one step ahead": MyopicPolicy(config),
        "history, reserving": ReservingPolicy(config, history),
        "greedy, reserving": ReservingPolicy(config, greedy),
        "history, at no price": TeamOfRules(history),
        "history, round robin": RoundRobin(history),
        "history, one at a time": OneAtATime(history),
        "history, each alone": IndependentPolicies((history,) * config.num_robots),
    }


def drawing_of(config: WorldConfig, num_futures: int) -> Mapping[str, Policy]:
    """Everyone who draws."""
    history = GreedyPolicy(config, uses_history=True, counts_penalty=True)
    return {
        "rollout over one step ahead": RolloutPolicy(config, MyopicPolicy(config), num_futures),
        "rollout over history, reserving": RolloutPolicy(config, ReservingPolicy(config, history), num_futures),
        "uniformly at random": UniformPolicy(),
    }


def regrets(optimum: TeamOptimum, policy: Policy, num_keys: int) -> tuple[float, float]:
    """Mean regret over keys, and its standard error; not a number for one key."""
    found = [optimum.regret(policy, random.key_of(k)) for k in range(num_keys)]
    return float(np.mean(found)), float(np.std(found, ddof=1) / num_keys**0.5) if num_keys > 1 else float("nan")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/team_regret.json"))
    parser.add_argument("--horizon", type=int, default=2, help="decisions of each robot")
    parser.add_argument("--prices", type=float, nargs="+", default=PRICES, help="of a second")
    parser.add_argument("--futures", type=int, default=32, help="of each action, in a rollout")
    parser.add_argument("--keys", type=int, default=4, help="with which a policy that draws is asked")
    args = parser.parse_args()
    workspace, rows = Workspace(REACH, np.eye(len(HIDES), dtype=bool)), []
    for price in args.prices:
        config, begin_s = config_of(args.horizon, price), time.perf_counter()
        optimum = solve_team(HIDES, config, workspace)
        print(f"\n{price} per second: optimum {optimum.value:.4f}, {optimum.num_states:,} states", end="")
        print(f", {time.perf_counter() - begin_s:.0f} s\n{'policy':34}{'value':>9}{'regret':>9}")
        result = [(name, policy, 1) for name, policy in policies_of(config).items()]
        result += [(name, policy, args.keys) for name, policy in drawing_of(config, args.futures).items()]
        for name, policy, num_keys in result:
            regret, error = regrets(optimum, policy, num_keys)
            interval = "" if np.isnan(error) else f" ± {error:.4f}"
            print(f"{name:34}{optimum.value - regret:9.4f}{regret:9.4f}{interval}", flush=True)
            rows.append({"reward_per_s": price, "policy": name, "value": optimum.value - regret, "regret": regret})
            rows[-1] |= {"error": error if num_keys > 1 else 0.0}
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(rows, indent=2), encoding="utf-8")
    print(f"Results: {args.out}")


if __name__ == "__main__":
    main()
