"""Steps of the table world a second, in turn with Gymnasium's CartPole; medians, their ratios, and JSON.

python benchmarks/world_steps.py [--out runs/benchmarks/world_steps.json] [--steps 100] [--runs 7]

Bar: one million steps a second with 4,096 tables of six objects on two cores. Every table acts at every step, by a draw
from its possible actions, and a table that is over is set again in the same step, so all steps count; setting tables
and drawing actions are inside the time. One compiled call takes all steps; compilation is timed on its own. The figure
of the bar is that of JAX's default generator, which makes the logs; `jax.random.key(0, impl=…)` chooses another.

CartPole is a far smaller world (four numbers, no chance within an episode). Its vectorised form spends a step on each
reset, and those are not counted; drawing its actions is inside its time too.
"""

import argparse
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from timings import Row, write

from halfseen.world import Scene, TableState, UniformPolicy, WorldConfig
from halfseen.world.dynamics import start, step
from halfseen.world.state import HiddenState, Layout, pad_scenes

NUM_OBJECTS, NUM_TABLES, NUM_SYNC = 6, 4096, 64
BAR = 1e6
GENERATORS = ("threefry2x32", "rbg")
"""JAX's default first."""


def random_layouts() -> Layout:
    """One table of its own for each member of the batch."""
    rng, shape = np.random.default_rng(0), (NUM_OBJECTS, NUM_OBJECTS)
    is_other = ~np.eye(NUM_OBJECTS, dtype=bool)
    return pad_scenes(
        [Scene(rng.uniform(0.0, 0.5, shape) * (rng.random(shape) < 0.4) * is_other) for _ in range(NUM_TABLES)]
    )


def step_or_set(
    config: WorldConfig, layout: Layout, state: TableState, hidden: HiddenState, key: Array
) -> tuple[TableState, HiddenState, Array, Array]:
    """One random step of one table, which is set again if that ended it; its reward, and whether it did."""
    action_key, step_key, start_key = jax.random.split(key, 3)
    action = UniformPolicy().decide(state, action_key).action
    after, hidden, outcome = step(config, state, hidden, action, step_key)
    fresh = start(config, layout, start_key)
    state, hidden = jax.tree.map(lambda new, old: jnp.where(outcome.is_over, new, old), fresh, (after, hidden))
    return state, hidden, outcome.reward, outcome.is_over


@partial(jax.jit, static_argnames="num_steps")
def walk(config: WorldConfig, layouts: Layout, keys: Array, num_steps: int) -> tuple[tuple, Array, Array]:
    """All steps of all tables; the tables as they are left, each one's reward a step, and its number of paths."""
    tables = jax.vmap(partial(start, config))(layouts, keys)

    def advance(tables: tuple[TableState, HiddenState], t: Array) -> tuple[tuple[TableState, HiddenState], tuple]:
        step_keys = jax.vmap(jax.random.fold_in, in_axes=(0, None))(keys, t)
        state, hidden, reward, is_over = jax.vmap(partial(step_or_set, config))(layouts, *tables, step_keys)
        return (state, hidden), (reward, is_over)

    # The tables are given back whole, or the compiler would leave out the labels and histories that nothing reads.
    tables, (reward, is_over) = jax.lax.scan(advance, tables, jnp.arange(num_steps))
    return tables, jnp.mean(reward, axis=0), jnp.sum(is_over, axis=0)


def ours(generator: str, num_steps: int) -> Callable[[], int]:
    """A run of the world that answers how many steps it took."""
    keys = jax.random.split(jax.random.key(0, impl=generator), NUM_TABLES)
    layouts = random_layouts()

    def run() -> int:
        jax.block_until_ready(walk(WorldConfig(), layouts, keys, num_steps))
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
    begin = time.perf_counter()
    num_steps = run()
    return num_steps / (time.perf_counter() - begin)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/world_steps.json"))
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--runs", type=int, default=7)
    args = parser.parse_args()
    worlds = {f"halfseen, {generator}": ours(generator, args.steps) for generator in GENERATORS}
    default, vectorised = f"halfseen, {GENERATORS[0]}", "CartPole, vectorised"
    peers = {
        vectorised: cart_pole(NUM_TABLES, "vector_entry_point", args.steps),
        "CartPole, one by one": cart_pole(NUM_SYNC, "sync", args.steps),
    }
    # The first call compiles.
    compile_s = {name: args.steps * NUM_TABLES / steps_per_s(run) for name, run in worlds.items()}
    rates = {name: [] for name in (*worlds, *peers)}
    for _ in range(args.runs):
        for name, run in (worlds | peers).items():
            rates[name].append(steps_per_s(run))

    medians = {name: float(np.median(of)) for name, of in rates.items()}
    for name, median in medians.items():
        # The median of each run's own ratio: what slows the machine for a while slows all alike.
        ratio = np.median(np.divide(rates[name], rates[vectorised]))
        first = f", first call {compile_s[name]:.1f} s" if name in compile_s else ""
        print(f"{name:24s} {median / 1e6:7.2f} million steps/s, {ratio:6.3f} times {vectorised}{first}")
    holds = "holds" if medians[default] >= BAR else "does not hold"
    print(f"bar: {BAR:.0e} steps/s with {NUM_TABLES} tables of {NUM_OBJECTS} on {os.cpu_count()} cores: {holds}")
    results = {
        "steps_per_s": medians,
        "worst_steps_per_s": {name: min(of) for name, of in rates.items()},
        "ratio_to_cart_pole": float(np.median(np.divide(rates[default], rates[vectorised]))),
        "first_call_s": compile_s,
        "num_tables": NUM_TABLES,
        "num_cores": os.cpu_count(),
        "bar_holds": medians[default] >= BAR,
    }
    what = f"steps of {NUM_TABLES:,} tables of {NUM_OBJECTS}"
    write(args.out, results, [Row(what, medians[default], "steps/s", vectorised, medians[vectorised], BAR)])
    print(f"Results: {args.out}")


if __name__ == "__main__":
    main()
