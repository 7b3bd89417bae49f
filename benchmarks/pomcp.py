"""Ours and pomdp-py's POMCP at equal wall-clock budgets, in turn, on a table of six objects and on the tiger.

python benchmarks/pomcp.py [--out runs/benchmarks/pomcp.json] [--episodes 40] [--long] [--tune]

Both meet the same tables, hidden parts and chances of the world, and draw from the exact posterior at every decision,
so that planning alone is compared. Bars: ours earns at least as much, and simulates at least 30 times as fast. The
peer has lean models (`peers`), the settings below, which were the best at each budget of those tried, and
no garbage collection, which would cost it two simulations of three; its belief is drawn, and let go, off the clock.
``--long`` adds one second. The peer is optional: pip install pomdp-py; without it, ours runs alone.
"""

import argparse
import gc
import json
import random
import sys
import time
from collections.abc import Callable, Mapping
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from halfseen.planners import TableProblem, plan
from halfseen.world import Scene, TableState, WorldConfig
from halfseen.world.dynamics import start, step
from halfseen.world.state import HiddenState, pad_scenes

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
from tiger import LISTEN, OPEN_LEFT, TigerProblem  # pyright: ignore[reportMissingImports]

try:
    from peers import table as peer_table
    from peers import tiger as peer_tiger

    HAS_PEER = True
except ImportError:
    HAS_PEER = False

BUDGETS_S, LONG_S = (0.001, 0.01, 0.1), 1.0
SHARE = {0.001: 4.0, 0.01: 4.0, 0.1: 1.0, LONG_S: 0.25}
"""Of the episodes, by budget: a short decision may be asked for more often."""
RATIO_BAR = 30.0
WARM_UP, TUNING = 20_000, 10_000
"""Episodes that are not compared: the first, and where the peer's settings are tried from."""

CONFIG = WorldConfig()
NUM_OBJECTS, NUM_TABLES = 6, 5
TABLE_SETTINGS = {
    0.001: {"rollouts": "heuristic", "exploration": 3.0, "visits": 10},
    0.01: {"rollouts": "heuristic", "exploration": 30.0, "visits": 0},
    0.1: {"rollouts": "heuristic", "exploration": 30.0, "visits": 0},
}
TABLE_SETTINGS[LONG_S] = TABLE_SETTINGS[0.1]
TABLE_GRID = {"rollouts": ("random", "heuristic"), "exploration": (3.0, 10.0, 30.0), "visits": (0, 1, 10)}

HORIZON, DISCOUNT, RIGHT, TIGER_OPTIMUM = 3, 0.95, 0.85, 2.3098
TIGER_SETTINGS = {budget_s: {"rollouts": "listening", "exploration": 100.0} for budget_s in (*BUDGETS_S, LONG_S)}
TIGER_GRID = {"rollouts": ("random", "listening"), "exploration": (3.0, 10.0, 30.0, 100.0, 300.0)}


class Decision(NamedTuple):
    action: int
    num_simulations: int
    elapsed_s: float


Played = tuple[float, list[Decision]]
"""Reward of an episode, and how its decisions were made."""


def our_decision(
    problem: TableProblem | TigerProblem, budget_s: float, key: jax.Array, exploration: float = 1.0
) -> Decision:
    if budget_s > 0.0:
        found = plan(problem, key, budget_s=budget_s, exploration=exploration)
    else:
        # Asked for nothing, the planner takes what its rule says.
        found = plan(problem, key, num_simulations=0)
    return Decision(found.action, found.num_simulations, found.elapsed_s)


# The table


@cache
def hides(table: int) -> np.ndarray:
    rng = np.random.default_rng(table)
    shape = (NUM_OBJECTS, NUM_OBJECTS)
    return rng.uniform(0.0, 0.5, shape) * (rng.random(shape) < 0.4) * ~np.eye(NUM_OBJECTS, dtype=bool)


@cache
def peer_model(table: int):
    return peer_table.TableModel(CONFIG, hides(table))


_start, _step = jax.jit(start), jax.jit(step)


@partial(jax.jit, static_argnames="num_draws")
def posterior_draws(seen: TableState, key: jax.Array, num_draws: int) -> HiddenState:
    problem = TableProblem(CONFIG, seen)
    return jax.vmap(lambda key: problem.initial_state(key).hidden)(jax.random.split(key, num_draws))


def our_table(seen: TableState, table: int, budget_s: float, key: jax.Array) -> Decision:
    return our_decision(TableProblem(CONFIG, seen), budget_s, key)


def peers_table(seen: TableState, table: int, budget_s: float, key: jax.Array, settings: Mapping) -> Decision:
    model = peer_model(table)
    states = model.states(seen, posterior_draws(seen, key, 500 + int(50_000 * budget_s)))
    return Decision(*peer_table.decided(model, states, budget_s=budget_s, **settings[budget_s]))


def table_episode(decide: Callable[..., Decision], budget_s: float, episode: int) -> Played:
    start_key, world_key, plan_key = jax.random.split(jax.random.key(episode), 3)
    table, reward, decisions = episode % NUM_TABLES, 0.0, []
    layout = jax.tree.map(lambda leaf: leaf[0], pad_scenes([Scene(hides(table))]))
    seen, hidden = _start(CONFIG, layout, start_key)
    for t in range(CONFIG.horizon):
        decisions.append(decide(seen, table, budget_s, jax.random.fold_in(plan_key, t)))
        seen, hidden, outcome = _step(CONFIG, seen, hidden, decisions[-1].action, jax.random.fold_in(world_key, t))
        reward += float(outcome.reward)
        if outcome.is_over:
            break
    return reward, decisions


# The tiger


def our_tiger(left_chance: float, steps_to_go: int, budget_s: float, seed: int) -> Decision:
    problem = TigerProblem(left_chance, horizon=steps_to_go)
    return our_decision(problem, budget_s, jax.random.key(seed), exploration=100.0)


def peers_tiger(left_chance: float, steps_to_go: int, budget_s: float, seed: int, settings: Mapping) -> Decision:
    return Decision(*peer_tiger.decided(left_chance, steps_to_go, budget_s=budget_s, **settings[budget_s]))


def tiger_episode(decide: Callable[..., Decision], budget_s: float, episode: int) -> Played:
    rng = np.random.default_rng(episode)
    tiger, left_chance, reward, decisions = rng.integers(2), 0.5, 0.0, []
    for t in range(HORIZON):
        decisions.append(decide(left_chance, HORIZON - t, budget_s, 100 * episode + t))
        action, draw, tiger_anew = decisions[-1].action, rng.random(), rng.integers(2)
        if action == LISTEN:
            reward -= DISCOUNT**t
            heard = tiger if draw < RIGHT else 1 - tiger
            odds = left_chance / (1.0 - left_chance) * (RIGHT / (1.0 - RIGHT)) ** (1 - 2 * heard)
            left_chance = odds / (1.0 + odds)
        else:
            reward += DISCOUNT**t * (-100.0 if action == OPEN_LEFT + tiger else 10.0)
            tiger, left_chance = tiger_anew, 0.5
    return reward, decisions


# The comparison


def mean_and_error(values: list[float]) -> tuple[float, float]:
    return float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(len(values)))


def row(played: list[Played]) -> dict[str, float]:
    reward, error = mean_and_error([reward for reward, _ in played])
    decisions = [decision for _, decisions in played for decision in decisions]
    return {
        "reward": reward,
        "standard_error": error,
        "simulations_per_s": float(np.median([of.num_simulations / of.elapsed_s for of in decisions])),
        "simulations": float(np.median([of.num_simulations for of in decisions])),
        "decision_s": float(np.median([of.elapsed_s for of in decisions])),
    }


def verdict(played: Mapping[str, list[Played]], rows: Mapping[str, Mapping[str, float]]) -> dict[str, object]:
    pairs = zip(played["halfseen"], played["pomdp-py"], strict=True)
    difference, error = mean_and_error([ours[0] - theirs[0] for ours, theirs in pairs])
    ratio = rows["halfseen"]["simulations_per_s"] / rows["pomdp-py"]["simulations_per_s"]
    return {
        "difference": difference,
        "difference_error": error,
        "ratio": ratio,
        "reward_bar_holds": difference >= 0.0,
        "ratio_bar_holds": ratio >= RATIO_BAR,
    }


def compared(
    game: str,
    play: Callable[[Callable[..., Decision], float, int], Played],
    planners: Mapping[str, Callable[..., Decision]],
    episodes: Mapping[float, int],
) -> dict[str, object]:
    rule = [play(planners["halfseen"], 0.0, episode)[0] for episode in range(max(episodes.values()))]
    results: dict[str, object] = {
        "rule_alone": dict(zip(("reward", "standard_error"), mean_and_error(rule), strict=True))
    }
    print("\n{}: our rule without search earns {:.2f} ± {:.2f}".format(game, *mean_and_error(rule)))
    for budget_s, num_episodes in episodes.items():
        begin = time.perf_counter()
        for decide in planners.values():
            play(decide, budget_s, WARM_UP)
        print(f"{game} {budget_s:5.3f} s first episode, compilation included: {time.perf_counter() - begin:.1f} s")
        played: dict[str, list[Played]] = {name: [] for name in planners}
        for episode in range(num_episodes):
            gc.collect()
            for name, decide in planners.items():
                random.seed(episode)
                played[name].append(play(decide, budget_s, episode))
        rows = {name: row(of) for name, of in played.items()}
        for name, of in rows.items():
            print(
                f"{game} {budget_s:5.3f} s {name:9s} reward {of['reward']:7.2f} ± {of['standard_error']:5.2f}"
                f"  {of['simulations_per_s']:9.0f} simulations/s  {of['simulations']:8.0f} in {of['decision_s']:.4f} s"
            )
        results[str(budget_s)] = rows
        if "pomdp-py" in played:
            bars = verdict(played, rows)
            results[str(budget_s)] = rows | bars
            print_bars(f"{game} {budget_s:5.3f} s", bars, num_episodes)
    return results


def print_bars(head: str, bars: Mapping, num_episodes: int) -> None:
    holds = {True: "holds", False: "does not hold"}
    told = "" if abs(bars["difference"]) > 2.0 * bars["difference_error"] else "; not told apart"
    print(
        f"{head} bar: reward at least the peer's: {holds[bars['reward_bar_holds']]} (difference "
        f"{bars['difference']:.2f} ± {bars['difference_error']:.2f}, {num_episodes} episodes{told})\n"
        f"{head} bar: simulations/s at least {RATIO_BAR:.0f} times the peer's: {holds[bars['ratio_bar_holds']]} "
        f"({bars['ratio']:.2f} times)"
    )


def tune(game: str, play: Callable, peers: Callable, grid: Mapping[str, tuple], episodes: Mapping[float, int]) -> None:
    """Print the peer's reward on other episodes for each of its settings, the best first."""
    for budget_s, num_episodes in episodes.items():
        tried = []
        for values in product(*grid.values()):
            setting = dict(zip(grid, values, strict=True))
            decide = partial(peers, settings={budget_s: setting})
            rewards = [play(decide, budget_s, TUNING + episode)[0] for episode in range(num_episodes)]
            tried.append((*mean_and_error(rewards), setting))
            gc.collect()
        for reward, error, setting in sorted(tried, key=lambda one: -one[0]):
            print(f"{game} {budget_s:5.3f} s pomdp-py reward {reward:7.2f} ± {error:5.2f}  {setting}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/pomcp.json"))
    parser.add_argument("--episodes", type=int, default=40, help="of 0.1 s; four times as many of less")
    parser.add_argument("--long", action="store_true", help="a budget of one second too")
    parser.add_argument("--tune", action="store_true", help="try the peer's settings instead, and print the rewards")
    args = parser.parse_args()
    long = (LONG_S,) if args.long else ()
    episodes = {budget_s: max(2, int(SHARE[budget_s] * args.episodes)) for budget_s in (*BUDGETS_S, *long)}
    gc.disable()
    if not HAS_PEER:
        print("pomdp-py is not installed (pip install pomdp-py): ours runs alone")
    elif args.tune:
        tune("tiger", tiger_episode, peers_tiger, TIGER_GRID, episodes)
        tune("table", table_episode, peers_table, TABLE_GRID, episodes)
        return
    tables, tigers = {"halfseen": our_table}, {"halfseen": our_tiger}
    if HAS_PEER:
        tables["pomdp-py"] = partial(peers_table, settings=TABLE_SETTINGS)
        tigers["pomdp-py"] = partial(peers_tiger, settings=TIGER_SETTINGS)
    results = {
        "tiger": compared("tiger", tiger_episode, tigers, episodes),
        "table": compared("table", table_episode, tables, episodes),
    }
    print(f"\nThe optimum of the tiger is {TIGER_OPTIMUM:.2f}.")
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(results, indent=2), encoding="utf-8")
    print(f"Results: {args.out}")


if __name__ == "__main__":
    main()
