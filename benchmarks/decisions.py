"""One decision of each policy of the study: compiled, one table of six objects, one core, in turn; medians and JSON.

python benchmarks/decisions.py [--out runs/benchmarks/decisions.json] [--states 40]

Bar: the learned policy is no slower than the heuristic that looks at the history. What it has learned does not matter
to the time that it takes, so its coefficients are zeros here.
"""

import argparse
from pathlib import Path

import numpy as np
from timings import Row, write

from halfseen.arrays import mapped
from halfseen.study.policies import HEURISTICS, decision_times_ms, horizon_planner
from halfseen.tables.features import NUM_FEATURES
from halfseen.tables.policy import LinearTablePolicy
from halfseen.world import Scene, TableState, UniformPolicy, WorldConfig, random
from halfseen.world.actions import Verb
from halfseen.world.rollout import play
from halfseen.world.state import pad_scenes

NUM_OBJECTS = 6
LEARNED, HISTORY = "learned", "history"


def states_along_the_way(world: WorldConfig, num_states: int) -> list[TableState]:
    """One state of each of many random tables, early and late ones in turn."""
    rng, shape = np.random.default_rng(0), (NUM_OBJECTS, NUM_OBJECTS)
    scenes = [
        Scene(rng.uniform(0.0, 0.5, shape) * (rng.random(shape) < 0.4) * ~np.eye(NUM_OBJECTS, dtype=bool))
        for _ in range(num_states)
    ]
    episodes = play(world, pad_scenes(scenes), UniformPolicy(), random.key_of(0), num_states)
    lengths = np.asarray(episodes.is_taken.sum(axis=1))
    return [mapped(lambda leaf, k=k: leaf[k, k % lengths[k]], episodes.states) for k in range(num_states)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/decisions.json"))
    parser.add_argument("--states", type=int, default=40)
    args = parser.parse_args()
    world = WorldConfig()
    unlearned = LinearTablePolicy(np.zeros((world.horizon, len(Verb), NUM_FEATURES + 1)))
    others = (*HEURISTICS, *(horizon_planner(h, 128) for h in range(1, 7)))
    policies = {LEARNED: unlearned} | {each.name: each.policy(world) for each in others}
    times_ms = decision_times_ms(policies, states_along_the_way(world, args.states))

    medians_ms = {name: float(np.median(of)) for name, of in times_ms.items()}
    for name, median_ms in medians_ms.items():
        # The median of the states' own ratios: what slows the machine for a while slows both alike.
        # A slow policy decides on the first states only.
        ratio = np.median(times_ms[name] / times_ms[HISTORY][: len(times_ms[name])])
        print(f"{name:16s} {median_ms:8.3f} ms  {ratio:7.2f} times {HISTORY}")
    ratio = float(np.median(times_ms[LEARNED] / times_ms[HISTORY]))
    holds = "holds" if ratio <= 1.0 else "does not hold"
    print(f"bar: the learned policy is no slower than the {HISTORY} heuristic: {holds} ({ratio:.2f} times)")
    results = {"median_ms": medians_ms, "learned_to_history": ratio, "bar_holds": ratio <= 1.0}
    write(
        args.out,
        results,
        [Row("a decision of the learned policy", medians_ms[LEARNED], "ms", HISTORY, medians_ms[HISTORY], bar=0.1)],
    )
    print(f"Results: {args.out}")


if __name__ == "__main__":
    main()
