"""How much sooner do two arms clear a table than one? The same fresh tables in physics, with one arm and with two.

python benchmarks/two_arms.py [--tables 40] [--seed 1609] [--rule everything] [--out FILE]

One arm stands behind the table, as `halfseen cell run` has it; two arms stand at its two ends. By default every cup is
to go into a rack, whatever it is believed to be: the one that is hidden least and failed least comes first, and is
given up after three failures. With the name of a heuristic, the cups that it finds worth it under the calibrated law.
Two arms follow the same rule, one arm at a time (`TeamOfRules`). They also clear the tables *in turn*, each standing at
home while the other works: that tells what working at once buys, and what is due to where they stand.

It prints cups in the rack, the time of a table, and its ratio to that of one arm on the same tables, with 95 %
intervals from resampled tables; collisions of arms or of what they hold, waits for space, and deadlocks. Tables that
were cut are printed, and are in no time and no ratio. What --out holds of the same tables is kept: who has cleared as
many of them does not clear them again (remove the file to measure again), and a run that was stopped goes on where it
was.
"""

import argparse
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from rules.of_arms import InTurn, WashEverything
from tqdm import tqdm

from halfseen.cell.calibration.law import read_law, shipped_law
from halfseen.cell.campaign import Campaign, Conditions, working_folder
from halfseen.cell.model import PAIR
from halfseen.cell.table_state import Belief
from halfseen.planners import HEURISTICS
from halfseen.planners.heuristics import GreedyPolicy, TeamOfRules
from halfseen.workers import Workers
from halfseen.world.policy import Policy
from halfseen.writing import write_file

EVERYTHING = "everything"
ONE, TWO, IN_TURN = "one arm", "two arms", "two arms in turn"
MOST_DECISIONS = 25
NUM_RESAMPLED, LEVEL = 10_000, 0.95
Runs: TypeAlias = Sequence[Mapping[str, Any]]
"""What came of each table, as `Run` or `TeamRun` has it."""


def plans_of(rule: GreedyPolicy) -> dict[str, tuple[Policy | Policy, Conditions]]:
    """Who clears the tables, and in which cell."""
    one, two = Conditions(stops=None), Conditions(stops=None, stations=PAIR)
    team = TeamOfRules(rule)
    return {ONE: (rule, one), TWO: (team, two), IN_TURN: (InTurn(team), two)}


def summary_of(runs: Runs, base: Runs | None) -> dict[str, Any]:
    """What came of some tables, beside what came of them with one arm."""
    counted = {name: sum(run[name] for run in runs) for name in runs[0] if name.startswith("num_")}
    seconds = np.array([run["seconds"] for run in runs if run["cause"] is None] or [np.nan])
    result: dict[str, Any] = {
        "tables": len(runs),
        **counted,
        "cut": dict(Counter(run["cause"] for run in runs if run["cause"] is not None)),
        "waited_s": sum(run.get("waited_s", 0.0) for run in runs),
        "reward": float(np.mean([run["reward"] for run in runs])),
        "reward_without_luck": float(np.mean([run["reward"] - run["luck"] for run in runs])),
        "seconds": {"mean": float(seconds.mean()), "median": float(np.median(seconds))},
        "runs": list(runs),
    }
    return result if base is None else result | {"ratio": ratio(runs, base)}


def ratio(runs: Runs, base: Runs) -> dict[str, float] | None:
    """Ratio of the times of the tables that both have cleared, with an interval from resampled ones; and of each."""
    # Either may have cleared more of them: table k is the same for both.
    both = [
        (run["seconds"], of_one["seconds"])
        for run, of_one in zip(runs, base, strict=False)
        if run["cause"] is None and of_one["cause"] is None
    ]
    if not both:
        return None
    seconds, of_one = np.array(both).T
    drawn = np.random.default_rng(0).integers(len(seconds), size=(NUM_RESAMPLED, len(seconds)))
    ratios = seconds[drawn].sum(axis=1) / of_one[drawn].sum(axis=1)
    low, high = np.quantile(ratios, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2]).tolist()
    each = seconds / of_one
    return {
        "tables": len(each),
        "value": float(seconds.sum() / of_one.sum()),
        "low": low,
        "high": high,
        "median": float(np.median(each)),
        "largest": float(each.max()),
    }


def print_summary(name: str, result: Mapping[str, Any]) -> None:
    """Print a line or two of who cleared the tables."""
    cut = ", ".join(f"{num} by {cause}" for cause, num in result["cut"].items())
    print(
        f"{name:<18}{result['num_racked']:>4} of {result['num_cups']} cups in the rack, "
        f"{result['num_toppled']} toppled, "
        f"{result['num_fallen']} fell; {result['seconds']['mean']:.1f} s a table, "
        f"median {result['seconds']['median']:.1f}; "
        f"reward {result['reward']:+.2f}; {result['tables']} tables, {f'cut {cut}' if cut else 'none cut'}"
    )
    if result.get("ratio") is not None:
        of_one = result["ratio"]
        print(
            f"{'':<18}{of_one['value']:.3f} of one arm's time ({of_one['low']:.3f} to {of_one['high']:.3f}), median "
            f"{of_one['median']:.3f}, largest {of_one['largest']:.3f}, on {of_one['tables']} tables"
        )
    if "num_collisions" in result:
        print(
            f"{'':<18}{result['num_collisions']} collisions, {result['num_waits']} waits of "
            f"{result['waited_s'] / max(result['num_waits'], 1):.1f} s, {result['num_deadlocks']} deadlocks, "
            f"{result['num_gave_way']} gave way"
        )


def runs_in(file: Path, of: Mapping[str, Any]) -> dict[str, Runs]:
    """What earlier calls have found of the same tables, by who cleared them."""
    if not file.exists():
        return {}
    found = json.loads(file.read_text(encoding="utf-8"))
    was = {name: found.get(name) for name in of}
    if was != of:
        raise SystemExit(f"{file}: it holds tables of {was}, and these are of {dict(of)}; choose another --out")
    return {name: result["runs"] for name, result in found["plans"].items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1609)
    parser.add_argument("--rule", choices=[EVERYTHING, *HEURISTICS], default=EVERYTHING)
    parser.add_argument("--only", nargs="*", choices=[ONE, TWO, IN_TURN], help="who clears the tables")
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/two_arms.json"))
    options = parser.parse_args()
    law = read_law(shipped_law()).law
    config, rule = law.config(), None
    if options.rule == EVERYTHING:
        config = replace(config, horizon=MOST_DECISIONS)
        rule = WashEverything(config)
    else:
        rule = GreedyPolicy(config, *HEURISTICS[options.rule])
    belief, of = Belief(config, law.grip), {"seed": options.seed, "rule": options.rule}
    runs = runs_in(options.out, of)
    for name, (policy, conditions) in plans_of(rule).items():
        if options.only and name not in options.only:
            continue
        if len(runs.get(name, ())) != options.tables:
            place = options.out.with_name(f"{options.out.stem}-{name.replace(' ', '-')}")
            campaign = Campaign(policy, belief, conditions, options.seed)
            what = f"{name}, {options.rule}, seed {options.seed}"
            with working_folder(place, what) as folder, Workers(options.workers).ready() as pool:
                done = campaign.runs(range(options.tables), folder, pool)
                runs[name] = [asdict(run) for _, run in tqdm(done, name, options.tables, leave=False, disable=None)]
        plans = {name: summary_of(each, None if name == ONE else runs.get(ONE)) for name, each in runs.items()}
        print_summary(name, plans[name])
        # What has been driven for so long is kept, whatever comes of the next.
        options.out.parent.mkdir(parents=True, exist_ok=True)
        write_file(options.out, json.dumps({**of, "plans": plans}, indent=1) + "\n")


if __name__ == "__main__":
    main()
