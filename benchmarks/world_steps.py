"""Steps of the table world a CPU second, in turn with Gymnasium's CartPole; medians, their ratios, and JSON.

python benchmarks/world_steps.py [--out runs/benchmarks/world_steps.json] [--steps 20] [--runs 7] [--jax]

Bar: one million steps a CPU second with 4,096 tables of six objects. Every table acts at every step, by a draw from its
possible actions, and a table that is over is set again in the same step, so all steps count; setting tables and drawing
actions are inside the time. With --jax the same functions run under `jax.jit`, too, where the extra is installed; its
compilation is timed on its own.

CartPole is a far smaller world (four numbers, no chance within an episode). Its vectorised form spends a step on each
reset, and those are not counted; drawing its actions is inside its time too.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from timings import Row, write

from halfseen.arrays import chosen, known_to_jax, mapped
from halfseen.world import Scene, TableState, UniformPolicy, WorldConfig, random
from halfseen.world.random import Key
from halfseen.world.state import HiddenState, Layout, pad_scenes
from halfseen.world.transition import start, step

NUM_OBJECTS, NUM_TABLES, NUM_SYNC = 6, 4096, 64
BAR = 1e6
OURS, OURS_JAX, VECTORISED, ONE_BY_ONE = "halfseen", "halfseen, JAX", "CartPole, vectorised", "CartPole, one by one"
Tables = tuple[TableState, HiddenState]


def random_layouts() -> Layout:
    """One table of its own for each member of the batch."""
    rng, shape = np.random.default_rng(0), (NUM_OBJECTS, NUM_OBJECTS)
    is_other = ~np.eye(NUM_OBJECTS, dtype=bool)
    return pad_scenes(
        [Scene(rng.uniform(0.0, 0.5, shape) * (rng.random(shape) < 0.4) * is_other) for _ in range(NUM_TABLES)]
    )


def step_or_set(config: WorldConfig, layouts: Layout, tables: Tables, key: Key, is_sparse: bool) -> tuple[Tables, Any]:
    """One random step of every table, set again where that ended it; and the rewards.

    Of NumPy's arrays only tables that are over are set; under `jax.jit` all are, as shapes are fixed there.
    """
    state, hidden = tables
    action_key, step_key, start_key = random.split(key, 3)
    action = UniformPolicy().decide(state, action_key).action
    state, hidden, outcome = step(config, state, hidden, action, step_key)
    if is_sparse:
        return _set_again(config, layouts, (state, hidden), start_key, np.flatnonzero(outcome.is_over)), outcome.reward
    return chosen(outcome.is_over, start(config, layouts, start_key), (state, hidden)), outcome.reward


def _set_again(config: WorldConfig, layouts: Layout, tables: Tables, key: Key, over: np.ndarray) -> Tables:
    fresh = start(config, mapped(lambda leaf: leaf[over], layouts), key[over])
    return mapped(lambda leaf, new: _put(leaf, over, new), tables, fresh)


def _put(values: np.ndarray, rows: np.ndarray, new: np.ndarray) -> np.ndarray:
    values = np.copy(values)
    values[rows] = new
    return values


def ours(num_steps: int) -> Callable[[], int]:
    """A run of the world in NumPy that answers how many steps it took."""
    config, layouts, keys = WorldConfig(), random_layouts(), random.keys_of(random.key_of(0), NUM_TABLES)

    def run() -> int:
        tables = start(config, layouts, keys)
        for t in range(num_steps):
            tables, _ = step_or_set(config, layouts, tables, random.fold_in(keys, t), is_sparse=True)
        return num_steps * NUM_TABLES

    return run


def ours_by_jax(num_steps: int) -> Callable[[], int]:
    """A run of the same functions under `jax.jit`, of all steps in one call."""
    jax = known_to_jax()
    config, layouts = WorldConfig(), random_layouts()
    keys = jax.numpy.asarray(random.keys_of(random.key_of(0), NUM_TABLES))

    @jax.jit
    def walk(layouts: Layout, keys: Key) -> tuple[Tables, Any]:
        def advance(tables: Tables, t: Any) -> tuple[Tables, Any]:
            return step_or_set(config, layouts, tables, random.fold_in(keys, t), is_sparse=False)

        # The tables are given back whole, or the compiler would leave out the labels and histories that nothing reads.
        return jax.lax.scan(advance, start(config, layouts, keys), jax.numpy.arange(num_steps))

    def run() -> int:
        jax.block_until_ready(walk(layouts, keys))
        return num_steps * NUM_TABLES

    return run


def cart_pole(num_envs: int, mode: str, num_steps: int) -> Callable[[], int]:
    """A run of CartPole with random actions that answers how many steps it took, resets not counted."""
    envs = gymnasium.make_vec("CartPole-v1", num_envs=num_envs, vectorization_mode=mode)
    rng = np.random.default_rng(0)

    def run() -> int:
        envs.reset(seed=0)
        is_reset, num_counted = np.zeros(num_envs, dtype=bool), 0
        for _ in range(num_steps):
            _, _, terminated, truncated, _ = envs.step(rng.integers(2, size=num_envs))
            num_counted += num_envs - int(is_reset.sum())
            is_reset = terminated | truncated
        return num_counted

    return run


def steps_per_s(run: Callable[[], int]) -> float:
    """Of the whole process, all its threads."""
    begin = time.process_time()
    num_steps = run()
    return num_steps / (time.process_time() - begin)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/world_steps.json"))
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--jax", action="store_true", help="also under jax.jit, where JAX is installed")
    return parser.parse_args()


def main() -> None:
    args = _arguments()
    worlds = {OURS: ours(args.steps)} | ({OURS_JAX: ours_by_jax(args.steps)} if args.jax else {})
    peers = {
        VECTORISED: cart_pole(NUM_TABLES, "vector_entry_point", args.steps),
        ONE_BY_ONE: cart_pole(NUM_SYNC, "sync", args.steps),
    }
    # Of JAX's the first call compiles.
    first_s = {name: args.steps * NUM_TABLES / steps_per_s(run) for name, run in worlds.items()}
    rates = {name: [] for name in (*worlds, *peers)}
    for _ in range(args.runs):
        for name, run in (worlds | peers).items():
            rates[name].append(steps_per_s(run))

    medians = {name: float(np.median(of)) for name, of in rates.items()}
    for name, median in medians.items():
        # The median of each run's own ratio: what slows the machine for a while slows all alike.
        ratio = np.median(np.divide(rates[name], rates[VECTORISED]))
        first = f", first call {first_s[name]:.1f} s" if name in first_s else ""
        print(f"{name:24s} {median / 1e6:7.2f} million steps/s, {ratio:6.3f} times {VECTORISED}{first}")
    holds = "holds" if medians[OURS] >= BAR else "does not hold"
    print(f"bar: {BAR:.0e} steps a CPU second with {NUM_TABLES} tables of {NUM_OBJECTS}: {holds}")
    results = {
        "steps_per_s": medians,
        "worst_steps_per_s": {name: min(of) for name, of in rates.items()},
        "ratio_to_cart_pole": float(np.median(np.divide(rates[OURS], rates[VECTORISED]))),
        "first_call_s": first_s,
        "num_tables": NUM_TABLES,
        "bar_holds": medians[OURS] >= BAR,
    }
    what = f"steps of {NUM_TABLES:,} tables of {NUM_OBJECTS}"
    write(args.out, results, [Row(what, medians[OURS], "steps/s", VECTORISED, medians[VECTORISED], BAR)])
    print(f"Results: {args.out}")


if __name__ == "__main__":
    main()
