"""Who earns most in the physical cell? All policies on the same tables, beside what the calibrated world foretold.

python benchmarks/closed_loop.py [--logs FOLDER] [--law FOLDER] [--tables 200] [--seed 2026] [--out FILE]
python benchmarks/closed_loop.py --from FILE [FILE …]

From the logs, which a cell recorded and cut, `halfseen learn` as it is called by default learns a policy, from the
first `FEW` of them another one, and a planner believes in the laws that were fitted. They, the heuristics and the
planner that knows the law that is believed in clear the same tables, of which nothing is cut. It prints the reward of
each in physics, how much of it was the luck of which cups were dirty (near 0 where P(DIRTY) is calibrated), what the
world under the law foretells for the same tables, the gap, and by how much the learned policy is ahead, table by table:
two-sided signed-rank tests, by Holm's procedure. Whether P(DIRTY) is calibrated is printed, too: of all objects as they
looked at first and at last, and of those that were to be washed, how many were said to be dirty, and how many were. A
run that was stopped goes on where it was, if it is called again. With --from, nothing is driven: what runs have
written, of some policies each, or on other tables, is compared together.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import expit
from tqdm import tqdm

from halfseen.cell.calibration.law import read_law, shipped_law
from halfseen.cell.campaign import Campaign, Conditions, logs_of, working_folder
from halfseen.cell.summary import Summary, summarised
from halfseen.cell.table_state import Belief
from halfseen.logs import Logs, read_logs
from halfseen.planners import HEURISTICS, named_policy
from halfseen.planners.pomdp import POMDPPolicy
from halfseen.policies.learner_choice import learner_for
from halfseen.study.compare import holm, signed_rank_test
from halfseen.workers import Workers
from halfseen.world.actions import Verb
from halfseen.world.config import WorldConfig
from halfseen.world.log_checks import TABLE
from halfseen.world.policy import Policy
from halfseen.writing import write_file

LEARNED, FEW = "learned", 100
FITTED, PLANNER = "planner, fitted laws", "planner, calibrated law"
LOGS = Path(__file__).parents[1] / "examples" / "physical_cell" / "logs"


def policies_of(logs: Logs, config: WorldConfig, seed: int) -> dict[str, Policy]:
    """All who take part."""
    learned, of_few = (
        learner_for(some, censoring="auto", random_state=seed).learner.fit(some)
        for some in (logs, logs.select(logs.trajectory_ids[:FEW]))
    )
    # With objects in the log it is the learner of tables.
    laws = getattr(learned, "assisted_").laws.config  # noqa: B009
    return {
        LEARNED: learned.policy_,
        f"learned from {FEW}": of_few.policy_,
        **{name: named_policy(name, config) for name in HEURISTICS},
        FITTED: POMDPPolicy(laws, planning_horizon=config.horizon),
        PLANNER: POMDPPolicy(config, planning_horizon=config.horizon),
    }


def line_of(name: str, summary: Summary) -> str:
    """One line of the table."""
    estimates = (summary.reward, summary.predicted, summary.gap, summary.luck, summary.gap_without_luck)
    cells = ("–" if each is None else f"{each.value:+7.2f} ± {each.standard_error:.2f}" for each in estimates)
    cups = summary.counts
    washed = f"{cups['num_washed']}/{cups['num_dirty']} dirty, {cups['num_racked'] - cups['num_washed']} clean"
    return f"{name:<26}" + "".join(f"{cell:>17}" for cell in cells) + f"{washed:>24}{summary.seconds:>7.0f}"


def calibration(logs: Logs) -> dict[str, dict[str, float]]:
    """P(DIRTY) beside the truth: the mean of what was said, the share that was found, and the z of their difference."""
    objects, stages = pd.DataFrame(logs.objects), pd.DataFrame(logs.stages)
    seen = objects.assign(said=expit(objects["log_odds"].astype(float)), found=objects["is_dirty"])
    seen = pd.DataFrame(seen[seen["location"] == TABLE])
    by_object = seen.sort_values("stage").groupby(["trajectory", "object"])
    washed = pd.DataFrame(stages[stages["action"] == Verb.WASH.name])[["trajectory", "stage", "object"]]
    meant = washed.merge(seen, on=["trajectory", "stage", "object"]).groupby(["trajectory", "object"]).tail(1)
    groups = {"at first": by_object.head(1), "at last": by_object.tail(1), "to be washed": meant}
    return {name: _beside_truth(rows["said"].to_numpy(), rows["found"].to_numpy()) for name, rows in groups.items()}


def _beside_truth(said: np.ndarray, found: np.ndarray) -> dict[str, float]:
    z = (found - said).sum() / np.sqrt((said * (1.0 - said)).sum())
    return {"objects": len(said), "said": float(said.mean()), "found": float(found.mean()), "z": float(z)}


def ahead(policies: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, np.ndarray]]:
    """By how much the learned policy is ahead of each other one, table by table, in physics and without luck."""
    rewards = {name: np.array(found["rewards"]) for name, found in policies.items()}
    without_luck = {name: rewards[name] - np.array(found["lucks"]) for name, found in policies.items()}
    others = [name for name in policies if name != LEARNED and LEARNED in policies]
    return {
        # Anyone who has cleared fewer tables has cleared the first ones.
        measure: {other: values[LEARNED][: len(values[other])] - values[other] for other in others}
        for measure, values in (("in physics", rewards), ("without luck", without_luck))
    }


def compared(differences: Mapping[str, np.ndarray]) -> dict[str, dict[str, float]]:
    """Test each of the differences, by name of the other policy."""
    if not differences:
        return {}
    tests = {other: signed_rank_test(each, "two-sided") for other, each in differences.items()}
    adjusted = holm(np.array([test.p_value for test in tests.values()]))
    return {
        f"{LEARNED} – {other}": {
            **{name: getattr(test.effect, name) for name in ("value", "low", "high", "standard_error")},
            "p_holm": float(p),
            "tables": len(differences[other]),
        }
        for (other, test), p in zip(tests.items(), adjusted, strict=True)
    }


def from_files(paths: Sequence[Path]) -> dict[str, dict[str, dict[str, float]]]:
    """Compare what runs have written: of the same tables together, of others one after the other."""
    by_tables: dict[tuple[int, str], dict[str, Any]] = {}
    for path in paths:
        found = json.loads(path.read_text())
        by_tables.setdefault((found["seed"], found["logs"]), {}).update(found["policies"])
    for (seed, _), policies in by_tables.items():
        if LEARNED not in policies:
            raise SystemExit(f"nothing learned has cleared the tables of seed {seed}; give its file, too")
    parts = [ahead(policies) for policies in by_tables.values()]
    return {
        measure: compared(
            {
                other: np.concatenate([part[measure][other] for part in parts if other in part[measure]])
                for other in dict.fromkeys(name for part in parts for name in part[measure])
            }
        )
        for measure in ("in physics", "without luck")
    }


def print_differences(differences: Mapping[str, Mapping[str, Mapping[str, float]]]) -> None:
    """Tell by how much the learned policy is ahead."""
    for measure, rows in differences.items():
        head = f"\n{f'table by table, {measure}':<50}"
        print(f"{head}{'tables':>8}{'mean':>9}{'95 % interval':>20}{'p (Holm)':>10}")
        for name, row in rows.items():
            within = f"{row['low']:+.2f} to {row['high']:+.2f}"
            print(f"{name:<50}{row['tables']:>8}{row['value']:>+9.2f}{within:>20}{row['p_holm']:>10.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=Path, default=LOGS)
    parser.add_argument("--law", type=Path, default=shipped_law())
    parser.add_argument("--tables", type=int, default=200)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--only", nargs="*", help="names of policies")
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/closed_loop.json"))
    parser.add_argument("--from", type=Path, nargs="+", dest="written", help="files that earlier runs have written")
    options = parser.parse_args()
    if options.written:
        print_differences(from_files(options.written))
        return
    law, logs = read_law(options.law).law, read_logs(options.logs)
    belief = Belief(law.config(), law.grip)
    results: dict[str, Any] = {"seed": options.seed, "logs": str(logs.summary()), "policies": {}, "differences": {}}
    print(f"learned from {logs.summary()}")
    heads = ("in physics", "predicted", "gap", "by luck", "gap without it")
    print(f"{'':<26}{''.join(f'{head:>17}' for head in heads)}{'washed':>24}{'robot':>7}")
    for name, policy in policies_of(logs, belief.config, options.seed).items():
        if options.only and name not in options.only:
            continue
        tables = range(options.tables)
        campaign = Campaign(policy, belief, Conditions(stops=None), options.seed, tells_truth=True)
        what = f"{name}, seed {options.seed}, with the truth, {logs.summary()}"
        place = options.out.with_name(f"closed-loop-{name.replace(', ', '-')}")
        with working_folder(place, what) as folder, Workers(options.workers).ready() as pool:
            done = campaign.runs(tables, folder, pool)
            runs = [run for _, run in tqdm(done, name, options.tables, leave=False, disable=None)]
            driven = logs_of(folder, tables)
            summary, dirty = summarised(runs, driven, policy, belief.config, options.seed), calibration(driven)
        print(line_of(name, summary), flush=True)
        for which, row in dirty.items():
            print(
                f"  dirty {which + ',':<14}{row['objects']:>5.0f} objects: said {row['said']:.3f}, found "
                f"{row['found']:.3f} (z {row['z']:+.1f})"
            )
        results["policies"][name] = asdict(summary) | {
            "rewards": [float(run.reward) for run in runs],
            "lucks": [float(run.luck) for run in runs],
            "calibration": dirty,
        }
        each = ahead(results["policies"])
        results["differences"] = {measure: compared(differences) for measure, differences in each.items()}
        # What has been driven for so long is kept, whatever comes of the next.
        options.out.parent.mkdir(parents=True, exist_ok=True)
        write_file(options.out, json.dumps(results, indent=1) + "\n")
    print_differences(results["differences"])


if __name__ == "__main__":
    main()
