"""The search and pomdp-py's POMCP on the tiger, at equal wall-clock budgets in turn: reward, simulations a second.

python benchmarks/pomcp.py [--out runs/benchmarks/pomcp.json] [--episodes 60]

Both play the same tigers for three actions, with the exact posterior as belief, and are asked anew at each. Ours is
given a rough value of each action (`rule_values`), the peer random roll-outs and the exploration of its example.
Ours is then asked for one decision at a random table of six objects, for which the peer has no models. The peer is
optional: `pip install pomdp-py`; without it, ours is run alone.
"""

import argparse
import json
import random
import sys
import time
from pathlib import Path

import jax
import numpy as np

from halfseen.planners import TableProblem, plan
from halfseen.world import Scene, WorldConfig
from halfseen.world.dynamics import start
from halfseen.world.state import pad_scenes

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
from tiger import LISTEN, OPEN_LEFT, TigerProblem

try:
    import pomdp_py
    from pomdp_py.problems.tiger import tiger_problem as peer
except ImportError:
    pomdp_py = peer = None

BUDGETS_S = (0.001, 0.01, 0.1)
HORIZON, DISCOUNT, RIGHT, OPTIMUM = 3, 0.95, 0.85, 2.3098


def ours(left_chance: float, steps_to_go: int, budget_s: float, seed: int) -> tuple[int, float]:
    problem = TigerProblem(left_chance, horizon=steps_to_go)
    found = plan(problem, jax.random.key(seed), budget_s=budget_s, exploration=100.0)
    return found.action, found.num_simulations / found.elapsed_s


def theirs(left_chance: float, steps_to_go: int, budget_s: float, seed: int) -> tuple[int, float]:
    random.seed(seed)
    lefts = round(1000 * left_chance)
    states = [peer.TigerState("tiger-left")] * lefts + [peer.TigerState("tiger-right")] * (1000 - lefts)
    agent = pomdp_py.Agent(
        pomdp_py.Particles(states),
        peer.PolicyModel(),
        peer.TransitionModel(),
        peer.ObservationModel(1.0 - RIGHT),
        peer.RewardModel(),
    )
    planner = pomdp_py.POMCP(
        max_depth=steps_to_go,
        discount_factor=DISCOUNT,
        planning_time=budget_s,
        exploration_const=110,
        rollout_policy=agent.policy_model,
    )
    action = planner.plan(agent)
    names = {"listen": LISTEN, "open-left": OPEN_LEFT, "open-right": OPEN_LEFT + 1}
    return names[action.name], planner.last_num_sims / max(planner.last_planning_time, 1e-9)


def played(decide, budget_s: float, seed: int) -> tuple[float, float]:
    """Discounted reward of one episode, and simulations a second."""
    rng = np.random.default_rng(seed)
    tiger, left_chance, reward, rates = rng.integers(2), 0.5, 0.0, []
    for step in range(HORIZON):
        action, rate = decide(left_chance, HORIZON - step, budget_s, 100 * seed + step)
        draw, tiger_anew = rng.random(), rng.integers(2)
        rates.append(rate)
        if action == LISTEN:
            reward -= DISCOUNT**step
            heard = tiger if draw < RIGHT else 1 - tiger
            odds = left_chance / (1.0 - left_chance) * (RIGHT / (1.0 - RIGHT)) ** (1 - 2 * heard)
            left_chance = odds / (1.0 + odds)
        else:
            reward += DISCOUNT**step * (-100.0 if action == OPEN_LEFT + tiger else 10.0)
            tiger, left_chance = tiger_anew, 0.5
    return reward, float(np.mean(rates))


def compared(num_episodes: int) -> dict:
    planners = {"halfseen": ours} | ({} if peer is None else {"pomdp-py": theirs})
    for decide in planners.values():
        for steps_to_go in range(1, HORIZON + 1):
            decide(0.5, steps_to_go, 0.01, 0)
    results = {}
    for budget_s in BUDGETS_S:
        rows = {name: [] for name in planners}
        for seed in range(num_episodes):
            for name, decide in planners.items():
                rows[name].append(played(decide, budget_s, seed))
        results[str(budget_s)] = {}
        for name, values in rows.items():
            rewards, rates = np.array(values).T
            results[str(budget_s)][name] = {
                "reward": rewards.mean(),
                "standard_error": rewards.std() / np.sqrt(num_episodes),
                "simulations_per_s": float(np.median(rates)),
            }
            error = rewards.std() / np.sqrt(num_episodes)
            print(
                f"{budget_s:5.3f} s {name:9s} reward {rewards.mean():7.2f} ± {error:5.2f}"
                f" (optimum {OPTIMUM:.2f})  {np.median(rates):9.0f} simulations/s"
            )
        if peer is not None:
            rates = [results[str(budget_s)][name]["simulations_per_s"] for name in ("halfseen", "pomdp-py")]
            print(f"{budget_s:5.3f} s ratio of simulations/s, ours to theirs: {rates[0] / rates[1]:.2f}")
    return results


def table_decision() -> dict:
    """Simulations a second at a table of six objects."""
    rng, config = np.random.default_rng(0), WorldConfig()
    hides = rng.uniform(0.0, 0.5, (6, 6)) * (rng.random((6, 6)) < 0.4) * ~np.eye(6, dtype=bool)
    layout = jax.tree.map(lambda leaf: leaf[0], pad_scenes([Scene(hides)]))
    problem = TableProblem(config, start(config, layout, jax.random.key(0))[0])
    begin = time.perf_counter()
    plan(problem, jax.random.key(0), num_simulations=1)
    print(f"table: compiled in {time.perf_counter() - begin:.1f} s")
    plan(problem, jax.random.key(0), budget_s=0.01)
    rows = {}
    for budget_s in (*BUDGETS_S, 1.0):
        found = plan(problem, jax.random.key(0), budget_s=budget_s)
        rows[str(budget_s)] = {"simulations": found.num_simulations, "elapsed_s": found.elapsed_s}
        print(
            f"table {budget_s:5.3f} s: {found.num_simulations:6d} simulations, depth {found.depth}, "
            f"took {found.elapsed_s:.4f} s, {'searched' if found.was_searched else 'not searched'}"
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/pomcp.json"))
    parser.add_argument("--episodes", type=int, default=60)
    args = parser.parse_args()
    if peer is None:
        print("pomdp-py is not installed (pip install pomdp-py): ours is run alone")
    results = {"tiger": compared(args.episodes), "table": table_decision()}
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(results, indent=2), encoding="utf-8")
    print(f"Results: {args.out}")


if __name__ == "__main__":
    main()
