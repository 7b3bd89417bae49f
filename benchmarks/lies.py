"""How many lies of a log are found, and how many honest logs are doubted?

python benchmarks/lies.py [--logs 20] [--trajectories 400] [--share 0.333] [--out FILE]

Logs of the worlds of `worlds` are recorded otherwise than they were made, each lie in each of them. What is printed is
the share of logs in which `inspect` finds it, and, of the same logs untouched, the share that raises any
doubt by which no verdict rests on them, or that a trajectory, a clock, a unit or a text is not what it should be.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits
from tqdm import tqdm
from worlds.examples import Cell, Trial
from worlds.haze import Haze
from worlds.wide import Wide
from worlds.world import World

from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.logs.data_quality import data_warnings

WORLDS: dict[str, Callable[[], World]] = {"cell": Cell, "trial": Trial, "haze": Haze, "wide": Wide}
Tables = tuple[Any, Any]
"""Stages and trajectories."""


def constant_probability(stages: Any, trajectories: Any, rng: np.random.Generator) -> Tables:
    """The likeliest action's own chance, whatever was taken."""
    return stages.assign(probability=stages["probability"].max()), trajectories


def outcome_as_covariate(stages: Any, trajectories: Any, rng: np.random.Generator) -> Tables:
    """What a sensor says after the action, with noise."""
    reward = stages["reward"].fillna(stages["reward"].mean())
    return stages.assign(reading=reward + 0.3 * reward.std() * rng.standard_normal(len(stages))), trajectories


def cuts_as_ends(stages: Any, trajectories: Any, rng: np.random.Generator) -> Tables:
    """Trajectories that were cut are finished with reward 0."""
    end_s = stages["trajectory"].map(trajectories.set_index("trajectory")["end_s"])
    result = stages.assign(elapsed_s=stages["elapsed_s"].fillna(end_s), reward=stages["reward"].fillna(0.0))
    return result, trajectories.assign(ending="finished", cause=None)


def milliseconds(stages: Any, trajectories: Any, rng: np.random.Generator) -> Tables:
    """Clocks in ms throughout."""
    return stages.assign(elapsed_s=1000.0 * stages["elapsed_s"]), trajectories.assign(
        end_s=1000.0 * trajectories["end_s"]
    )


def part_number(stages: Any, trajectories: Any, rng: np.random.Generator) -> Tables:
    """The number of the part among the covariates."""
    return stages.assign(part=stages["trajectory"].astype("category").cat.codes.astype(int) + 70_000), trajectories


def wall_clock(stages: Any, trajectories: Any, rng: np.random.Generator) -> Tables:
    """The time of day among the covariates."""
    begun_s = stages.groupby("trajectory")["elapsed_s"].shift(fill_value=0.0)
    return stages.assign(clock=1.7e9 + 60.0 * stages["trajectory"].astype("category").cat.codes + begun_s), trajectories


def decimal_commas(stages: Any, trajectories: Any, rng: np.random.Generator) -> Tables:
    """A reading with a decimal comma."""
    return stages.assign(reading=[f"{x:.1f}".replace(".", ",") for x in rng.random(len(stages))]), trajectories


def one_action(stages: Any, trajectories: Any, rng: np.random.Generator) -> Tables:
    """All stages took the same action."""
    return stages.assign(action=stages["action"].mode().iloc[0]), trajectories


LIES = {
    "untrue-probability": constant_probability,
    "outcome-as-covariate": outcome_as_covariate,
    "cut-called-finished": cuts_as_ends,
    "long-clock": milliseconds,
    "identifier": part_number,
    "clock": wall_clock,
    "number-as-text": decimal_commas,
    "one-action": one_action,
}
KINDS = {name: "identifier" if name == "clock" else name for name in LIES}


def kinds_of(stages: Any, trajectories: Any) -> set[str]:
    """What is found; of a log that is refused, everything."""
    try:
        logs = Logs(stages, trajectories)
    except LogError:
        return set(KINDS.values())
    return {each.kind for each in data_warnings(logs)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=20)
    parser.add_argument("--trajectories", type=int, default=400)
    parser.add_argument("--share", type=float, default=1 / 3)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/lies.json"))
    options = parser.parse_args()
    found: dict[str, dict[str, float]] = {}
    with threadpool_limits(1):
        for name, make in WORLDS.items():
            world, counts = make(), dict.fromkeys(["honest", *LIES], 0)
            for seed in tqdm(range(options.logs), name, disable=None, leave=False):
                logs = world.log(options.trajectories, 5000 + seed, options.share)
                rng = np.random.default_rng(seed)
                counts["honest"] += bool(
                    kinds_of(logs.stages, logs.trajectories) & {*KINDS.values(), "leak", "no-alternative"}
                )
                for lie, tell in LIES.items():
                    counts[lie] += KINDS[lie] in kinds_of(*tell(logs.stages.copy(), logs.trajectories.copy(), rng))
            found[name] = {lie: count / options.logs for lie, count in counts.items()}
    print(f"{'':<24}" + "".join(f"{name:>8}" for name in found))
    for lie in ["honest", *LIES]:
        print(f"{lie:<24}" + "".join(f"{each[lie]:>8.0%}" for each in found.values()))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps({**vars(options), "out": str(options.out), "found": found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
