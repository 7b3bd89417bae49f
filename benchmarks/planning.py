"""Ours and pomdp-py's POMCP at equal wall-clock budgets, in turn, on tables of six objects.

python benchmarks/planning.py [--out runs/benchmarks/planning.json] [--episodes 40] [--long] [--tune]

Both meet the same tables, hidden parts and draws of the world, and know the exact posterior at every decision, so that
planning alone is compared. Bar: ours earns at least as much, and more beyond noise at 1 and at 10 ms. The peer has a
lean model (`peers`), the settings below, which were the best at each budget of those tried, and no garbage collection,
which would cost it two simulations of three; its belief is drawn, and let go, off the clock. Where the machine is busy,
a budget of 1 ms is hardly kept by either: the ratio of the times taken is printed. ``--long`` adds one second. The peer
is optional: pip install pomdp-py; without it, ours runs alone.
"""

import argparse
import gc
import json
import random
from collections.abc import Callable, Mapping
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from halfseen.arrays import mapped
from halfseen.planners import plan
from halfseen.world import Scene, TableState, WorldConfig
from halfseen.world.random import fold_in, key_of, split
from halfseen.world.state import Layout, pad_scenes
from halfseen.world.transition import start, step

try:
    from peers import table as peer

    HAS_PEER = True
except ImportError:
    HAS_PEER = False

BUDGETS_S, LONG_S = (0.001, 0.01, 0.1), 1.0
SHARE = {0.001: 4.0, 0.01: 4.0, 0.1: 1.0, LONG_S: 0.25}
"""Of the episodes, by budget: a short decision may be asked for more often."""
BEYOND_NOISE = (0.001, 0.01)
WARM_UP, TUNING = 20_000, 10_000
"""Episodes that are not compared: the first, and where the peer's settings are tried from."""

CONFIG = WorldConfig()
NUM_OBJECTS, NUM_TABLES = 6, 5
SETTINGS = {
    0.001: {"rollouts": "heuristic", "exploration": 3.0, "visits": 10},
    0.01: {"rollouts": "heuristic", "exploration": 30.0, "visits": 0},
    0.1: {"rollouts": "heuristic", "exploration": 30.0, "visits": 0},
}
SETTINGS[LONG_S] = SETTINGS[0.1]
GRID = {"rollouts": ("random", "heuristic"), "exploration": (3.0, 10.0, 30.0), "visits": (0, 1, 10)}


class Decision(NamedTuple):
    action: int
    num_simulations: int
    elapsed_s: float


Decide = Callable[[TableState, int, float, int], Decision]
"""Decides at a state of a numbered table, within a budget, by a seed."""
Played = tuple[float, list[Decision]]
"""Reward of an episode, and how its decisions were made."""


@cache
def hides(table: int) -> np.ndarray:
    rng = np.random.default_rng(table)
    shape = (NUM_OBJECTS, NUM_OBJECTS)
    return rng.uniform(0.0, 0.5, shape) * (rng.random(shape) < 0.4) * ~np.eye(NUM_OBJECTS, dtype=bool)


def layout_of(table: int) -> Layout:
    return mapped(lambda leaf: leaf[0], pad_scenes([Scene(hides(table))]))


@cache
def peer_model(table: int):
    return peer.TableModel(CONFIG, hides(table))


def ours(seen: TableState, table: int, budget_s: float, seed: int) -> Decision:
    found = plan(CONFIG, seen, key_of(seed), seconds=budget_s)
    return Decision(found.action, int(found.num_rollouts.sum()), found.elapsed_s)


def theirs(seen: TableState, table: int, budget_s: float, seed: int, settings: Mapping) -> Decision:
    model = peer_model(table)
    states = model.states(seen, np.random.default_rng(seed), 500 + int(50_000 * budget_s))
    random.seed(seed)
    return Decision(*peer.decided(model, states, budget_s=budget_s, **settings[budget_s]))


def episode_of(decide: Decide, budget_s: float, episode: int) -> Played:
    start_key, world_key = split(key_of(episode))
    table, reward, decisions = episode % NUM_TABLES, 0.0, []
    seen, hidden = start(CONFIG, layout_of(table), start_key)
    for t in range(CONFIG.horizon):
        decisions.append(decide(seen, table, budget_s, CONFIG.horizon * episode + t))
        seen, hidden, outcome = step(CONFIG, seen, hidden, np.asarray(decisions[-1].action), fold_in(world_key, t))
        reward += float(outcome.reward)
        if outcome.is_over:
            break
    return reward, decisions


def mean_and_error(values: list[float]) -> tuple[float, float]:
    return float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(len(values)))


def row(played: list[Played]) -> dict[str, float]:
    reward, error = mean_and_error([reward for reward, _ in played])
    decisions = [decision for _, decisions in played for decision in decisions]
    return {
        "reward": reward,
        "standard_error": error,
        "simulations": float(np.median([of.num_simulations for of in decisions])),
        "searched": float(np.mean([of.num_simulations > 0 for of in decisions])),
        "decision_s": float(np.median([of.elapsed_s for of in decisions])),
    }


def verdict(budget_s: float, played: Mapping[str, list[Played]], rows: Mapping[str, Mapping]) -> dict[str, object]:
    pairs = zip(played["halfseen"], played["pomdp-py"], strict=True)
    difference, error = mean_and_error([ours[0] - theirs[0] for ours, theirs in pairs])
    return {
        "difference": difference,
        "difference_error": error,
        "time_ratio": rows["halfseen"]["decision_s"] / rows["pomdp-py"]["decision_s"],
        "bar_holds": difference > (2.0 * error if budget_s in BEYOND_NOISE else 0.0),
    }


def compared(planners: Mapping[str, Decide], episodes: Mapping[float, int]) -> dict[str, object]:
    results: dict[str, object] = {}
    for budget_s, num_episodes in episodes.items():
        for decide in planners.values():
            episode_of(decide, budget_s, WARM_UP)
        played: dict[str, list[Played]] = {name: [] for name in planners}
        for episode in range(num_episodes):
            gc.collect()
            for name, decide in planners.items():
                played[name].append(episode_of(decide, budget_s, episode))
        rows = {name: row(of) for name, of in played.items()}
        for name, of in rows.items():
            print(
                f"{budget_s:5.3f} s {name:9s} reward {of['reward']:6.2f} ± {of['standard_error']:4.2f}, median of "
                f"{of['simulations']:.0f} simulations in {of['decision_s']:.4f} s, {of['searched']:.0%} searched"
            )
        results[str(budget_s)] = rows
        if "pomdp-py" in played:
            bar = verdict(budget_s, played, rows)
            results[str(budget_s)] = rows | bar
            print_bar(budget_s, bar, num_episodes)
    return results


def print_bar(budget_s: float, bar: Mapping, num_episodes: int) -> None:
    wanted = "more beyond noise" if budget_s in BEYOND_NOISE else "at least as much"
    print(
        f"{budget_s:5.3f} s bar, {wanted}: {'holds' if bar['bar_holds'] else 'does not hold'} (difference "
        f"{bar['difference']:.2f} ± {bar['difference_error']:.2f}, {num_episodes} episodes; ours takes "
        f"{bar['time_ratio']:.2f} times the peer's time)",
        flush=True,
    )


def tune(episodes: Mapping[float, int]) -> None:
    """Print the peer's reward on other episodes for each of its settings, the best first."""
    for budget_s, num_episodes in episodes.items():
        tried = []
        for chosen in product(*GRID.values()):
            setting = dict(zip(GRID, chosen, strict=True))
            decide = partial(theirs, settings={budget_s: setting})
            rewards = [episode_of(decide, budget_s, TUNING + episode)[0] for episode in range(num_episodes)]
            tried.append((*mean_and_error(rewards), setting))
            gc.collect()
        for reward, error, setting in sorted(tried, key=lambda one: -one[0]):
            print(f"{budget_s:5.3f} s pomdp-py reward {reward:7.2f} ± {error:5.2f}  {setting}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/planning.json"))
    parser.add_argument("--episodes", type=int, default=40, help="of 0.1 s; four times as many of less")
    parser.add_argument("--long", action="store_true", help="a budget of one second too")
    parser.add_argument("--tune", action="store_true", help="try the peer's settings instead, and print the rewards")
    args = parser.parse_args()
    long = (LONG_S,) if args.long else ()
    episodes = {budget_s: max(2, int(SHARE[budget_s] * args.episodes)) for budget_s in (*BUDGETS_S, *long)}
    gc.disable()
    if args.tune and HAS_PEER:
        tune(episodes)
        return
    planners: dict[str, Decide] = {"halfseen": ours}
    if HAS_PEER:
        planners["pomdp-py"] = partial(theirs, settings=SETTINGS)
    else:
        print("pomdp-py is not installed (pip install pomdp-py): ours runs alone")
    results = compared(planners, episodes)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(results, indent=2), encoding="utf-8")
    print(f"Results: {args.out}")


if __name__ == "__main__":
    main()
