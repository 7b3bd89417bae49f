"""The learner as it is by default, fixed settings of it, and peers, on the same logs: what their policies are worth.

python benchmarks/learners.py [--out runs/benchmarks/learners.json] [--logs 10] [--worlds NAME …] [--sizes N …]
                              [--methods NAME …] [--markdown]

A policy's worth is its exact value as a share of the optimum; on tables of cups, where none is known, its mean reward
on 1,000 fresh episodes. Worlds: the cell and the trial of the examples, ``haze`` (a Q that no polynomial is, cuts by
what is not recorded), ``wide`` (20 covariates, of which 3 matter) and ``cups``. The default was chosen on logs of the
cell and of kin of the trial, how much its products count on three of wide, and that pessimism spares what the log does
on some of every world, all of seeds below 1000; here seeds begin at 1000.

What ``--out`` has already is not done again; ``--logs 0`` only prints it. Two peers need d3rlpy and PyTorch.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from peers.behaviour_cloning import cloned
from peers.fitted_q import iterated
from threadpoolctl import threadpool_limits
from worlds.cups import Cups
from worlds.examples import Cell, Trial
from worlds.haze import Haze
from worlds.wide import Wide
from worlds.world import Chances, World

from halfseen.censoring import Cox
from halfseen.learning import CensoredQLearner, DoublyRobust
from halfseen.logs import Logs
from halfseen.writing import write_file

FIRST_SEED = 1000
DEFAULT, ONE_FIT = "default", "quadratic, imputed"
WORLDS: dict[str, Callable[[], Any]] = {"cell": Cell, "trial": Trial, "haze": Haze, "wide": Wide, "cups": Cups}


class Case(NamedTuple):
    """A world, n, and the share of the trajectories that is cut."""

    world: str
    num_trajectories: int
    share: float


CASES = (
    *(Case("cell", num_trajectories, 0.33) for num_trajectories in (200, 400, 1000, 5000)),
    *(Case("trial", 1000, share) for share in (0.3, 0.5)),
    *(Case(world, num_trajectories, 0.4) for world in ("haze", "wide") for num_trajectories in (300, 1000)),
    *(Case("cups", num_trajectories, 0.5) for num_trajectories in (50, 100, 400, 1600)),
)
IMPUTED = {"stages": "pooled", "censoring": "buckley-james", "pessimism": 0.0}
PAPER = {"q_function": "linear", "stages": "separate", "censoring": "kaplan-meier", "pessimism": 0.0}
BY_COX = DoublyRobust(Cox(ridge=1.0), by="pooled")
FIXED: dict[str, dict[str, Any]] = {
    "paper (linear, separate, Kaplan–Meier)": PAPER,
    "linear, imputed": {**IMPUTED, "q_function": "linear"},
    ONE_FIT: {**IMPUTED, "q_function": "quadratic"},
    "kernel, imputed": {**IMPUTED, "q_function": "kernel"},
    "smooth, Cox, doubly robust": {**IMPUTED, "q_function": "smooth", "censoring": BY_COX},
}
CHANGED: dict[str, dict[str, Any]] = {
    "default, no pessimism": {"pessimism": 0.0},
    "default, cuts ignored": {"censoring": "none", "pessimism": "auto"},
}
OF_CUPS: dict[str, dict[str, Any]] = {
    DEFAULT: {},
    "eq. 3 without laws": {"laws": None},
    "the same, Kaplan–Meier": {"laws": None, "censoring": "kaplan-meier"},
    "the same, cuts ignored": {"laws": None, "censoring": "none"},
}


def ours(world: World, logs: Logs, **parameters: Any) -> Chances:
    """Learn with a setting of our own learner."""
    by_stage = {stage: list(names) for stage, names in world.actions_by_stage.items()}
    fitted = CensoredQLearner(len(by_stage), by_stage, list(world.covariates), **parameters).fit(logs)
    index = pd.Index(world.actions)
    return lambda frame, stage: np.eye(len(index))[index.get_indexer(fitted.decide(frame, stage))]


def uncut_only(world: World, logs: Logs) -> Chances:
    """Learn as by default, but from trajectories that came to their own end."""
    return ours(world, logs.select(logs.trajectory_ids[logs.is_finished]))


def deep_q(kind: str, world: World, logs: Logs) -> Chances:
    """Learn with d3rlpy."""
    from peers.deep_q import trained

    return trained(kind, world, logs)


METHODS: dict[str, Callable[[World, Logs], Chances]] = {
    DEFAULT: ours,
    **{name: partial(ours, **parameters) for name, parameters in (FIXED | CHANGED).items()},
    "default, uncut trajectories only": uncut_only,
    "fitted Q, boosting": partial(iterated, "boosting"),
    "fitted Q, extra trees": partial(iterated, "trees"),
    "d3rlpy CQL": partial(deep_q, "CQL"),
    "d3rlpy double DQN": partial(deep_q, "double DQN"),
    "behaviour cloning": cloned,
    "rule of thumb": lambda world, logs: world.plain,
}


def names_of(case: Case) -> tuple[str, ...]:
    return tuple(OF_CUPS if case.world == "cups" else METHODS)


@cache
def world_of(name: str) -> Any:
    return WORLDS[name]()


def measured(case: Case, seed: int, method: str, logs: Logs) -> dict[str, Any]:
    """Learn once: what the policy is worth, and CPU seconds of the fit."""
    world, begin = world_of(case.world), time.process_time()
    # The matrices are small: more threads than one wait for one another.
    with threadpool_limits(1):
        if case.world == "cups":
            policy = world.learned(logs, **OF_CUPS[method])
            cpu_s = time.process_time() - begin
            score = world.value(policy, seed)
        else:
            chances = METHODS[method](world, logs)
            cpu_s = time.process_time() - begin
            score = world.value(chances) / world.optimum
    return {**case._asdict(), "seed": seed, "method": method, "score": score, "cpu_s": cpu_s}


def wanted(cases: Sequence[Case], num_logs: int, methods: Sequence[str], rows: list[Any]) -> Iterator[Any]:
    """What is to be done and was not yet: log by log, so that a run that is stopped has some of everything."""
    done = {(r["world"], r["num_trajectories"], r["share"], r["seed"], r["method"]) for r in rows}
    for seed in range(FIRST_SEED, FIRST_SEED + num_logs):
        for case in cases:
            left = [name for name in names_of(case) if name in methods and (*case, seed, name) not in done]
            if left:
                yield case, seed, left


def summary(rows: list[dict[str, Any]]) -> pd.DataFrame:
    """A row for each case and method: means, standard errors, and the paired difference from the default.

    CPU seconds are the least of all logs: what is compiled for one of them is there for the next.
    """
    frame, found = pd.DataFrame(rows), []
    for case, of_case in frame.groupby(["world", "num_trajectories", "share"], sort=False):
        scores = of_case.pivot_table(index="seed", columns="method", values="score")
        cpu_s = of_case.groupby("method")["cpu_s"].min()
        for method in (name for name in names_of(Case(*case)) if name in scores):
            of_method = scores[method].dropna()
            less = (of_method - scores[DEFAULT]).dropna() if DEFAULT in scores else of_method[:0]
            found.append(
                {
                    **dict(zip(Case._fields, case, strict=True)),
                    "method": method,
                    "logs": len(of_method),
                    "mean": of_method.mean(),
                    "error": of_method.sem(),
                    "difference": less.mean(),
                    "difference_error": less.sem(),
                    "cpu_s": cpu_s[method],
                    "times": cpu_s[method] / cpu_s.get(ONE_FIT, np.nan),
                }
            )
    return pd.DataFrame(found)


def table(found: pd.DataFrame) -> str:
    """The summary of one case, as Markdown."""
    lines = [
        "| learner | logs | worth | less what the default's is | least CPU s of a fit | of one fixed fit |",
        "|:--|--:|--:|--:|--:|--:|",
    ]
    for _, row in found.iterrows():
        less = "" if row["method"] == DEFAULT else f"{row['difference']:+.3f} ± {row['difference_error']:.3f}"
        times = "" if np.isnan(row["times"]) or row["logs"] == 1 else f"× {row['times']:.1f}"
        lines.append(
            f"| {row['method']} | {row['logs']} | {row['mean']:.3f} ± {row['error']:.3f} | {less} | "
            f"{row['cpu_s']:.1f} | {times} |"
        )
    return "\n".join(lines).replace("-0.", "−0.").replace("nan", "?")


def tables(rows: list[dict[str, Any]]) -> str:
    """All cases, a heading and a table each."""
    parts = []
    for (world, num_trajectories, share), found in summary(rows).groupby(
        ["world", "num_trajectories", "share"], sort=False
    ):
        cut = f"{share:.0%} cut"
        parts.append(f"{world}, n = {num_trajectories:,}, {cut}\n\n{table(found)}")
    return "\n\n".join(parts)


def bars(rows: list[dict[str, Any]]) -> list[str]:
    """What was to be reached, and whether it was."""
    found, lines = summary(rows), []
    by_case = {key: each.set_index("method") for key, each in found.groupby(["world", "num_trajectories", "share"])}
    floors = {("cell", 400, 0.33): 0.908, ("cell", 1000, 0.33): 0.965, ("trial", 1000, 0.3): 0.98}
    floors |= {("trial", 1000, 0.5): 0.975, ("cups", 50, 0.5): 12.53}
    for case, each in by_case.items():
        where, mean = f"{case[0]}, n = {case[1]}, {case[2]:.0%} cut", each["mean"].get(DEFAULT, np.nan)
        if case in floors and DEFAULT in each.index:
            spread = f"± {each['error'][DEFAULT]:.3f} on {each['logs'][DEFAULT]} logs"
            lines.append(f"{_word(mean >= floors[case])}: {where}: {mean:.3f} {spread}, bar {floors[case]}")
        rivals = each[each.index.isin([*FIXED, *OF_CUPS, "d3rlpy CQL"]) & (each.index != DEFAULT)]
        for method, row in rivals.iterrows():
            slack = 0.0 if case[0] == "cups" or method == "d3rlpy CQL" else 0.01
            is_beaten = row["difference"] - 2.0 * row["difference_error"] > slack
            if is_beaten:
                lines.append(
                    f"missed: {where}: {method} is ahead by {row['difference']:.3f} ± {row['difference_error']:.3f}"
                )
        if "d3rlpy CQL" in each.index and each["logs"]["d3rlpy CQL"] > 1:
            row = each.loc["d3rlpy CQL"]
            ahead = row["difference"] + 2.0 * row["difference_error"] < 0
            lines.append(f"{_word(ahead)}: {where}: ahead of d3rlpy's CQL by {-row['difference']:.3f}")
    return lines


def _word(is_held: Any) -> str:
    return "held" if is_held else "missed"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/learners.json"))
    parser.add_argument("--logs", type=int, default=10)
    parser.add_argument("--worlds", nargs="+", choices=tuple(WORLDS), default=tuple(WORLDS))
    parser.add_argument("--sizes", nargs="+", type=int, default=sorted({case.num_trajectories for case in CASES}))
    parser.add_argument("--shares", nargs="+", type=float, default=sorted({case.share for case in CASES}))
    parser.add_argument("--methods", nargs="+", choices=(*METHODS, *OF_CUPS), default=(*METHODS, *OF_CUPS))
    parser.add_argument("--markdown", action="store_true", help="print the tables only")
    options = parser.parse_args()
    rows = json.loads(options.out.read_text(encoding="utf-8"))["rows"] if options.out.exists() else []
    methods = list(options.methods)
    if find_spec("d3rlpy") is None and any(name.startswith("d3rlpy") for name in methods):
        print("d3rlpy is not installed: its learners are left out")
        methods = [name for name in methods if not name.startswith("d3rlpy")]
    cases = [
        c
        for c in CASES
        if c.world in options.worlds and c.num_trajectories in options.sizes and c.share in options.shares
    ]
    for case, seed, names in wanted(cases, options.logs, methods, rows):
        logs = world_of(case.world).log(case.num_trajectories, seed, case.share)
        for method in names:
            rows.append(measured(case, seed, method, logs))
            row = rows[-1]
            if not options.markdown:
                print(*case, seed, f"{row['score']:8.4f} {row['cpu_s']:7.1f} s  {method}", flush=True)
            write_file(options.out, json.dumps({"rows": rows}, indent=1) + "\n")
    if rows:
        print(f"\n{tables(rows)}\n\n" + "\n".join(bars(rows)))


if __name__ == "__main__":
    main()
