"""A policy in service: how often is a healthy cell alarmed about, and how soon is a change noticed?

python benchmarks/service.py [--lifetimes 200] [--trajectories 10000] [--changes 200] [--policies 4] [--out FILE]

Policies are learned, as `halfseen learn` does by default, from 400 trajectories each of the bin, the pick cell and the
clinic of `worlds/clinic.py`, a part of which is cut. The clinic was kept aside: nothing was chosen on it, and it has a
hidden state. Each policy then serves lifetimes in which nothing changes, and cells that have changed:

- wear: after 300 trajectories, a grasp fetches less, or a treatment cures less often, at once, and less and less over
  600 more: what the policy earns in the bin falls from .61 to about .32, and on to −.14;
- swapped: from the first on, two covariates change places between the cell and the policy, which decides and records
  so.

It prints the share of lifetimes with an alarm, and of changes how many trajectories it took until the alarm, how many
were noticed within 150, and in how many the alarm named the part or the covariates. Of wear in the bin and in the pick
cell it also prints how many trajectories the likelihood ratio of the outcomes of grasps takes to reach 20, which knows
every chance, the wear and when it begins: nobody can be much faster at one false alarm in twenty.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm
from worlds.clinic import SYMPTOMS, TREATMENTS, Clinic
from worlds.examples import Bin, bin_cell, cell_parts, cell_trajectories

from halfseen.logs import Logs
from halfseen.monitoring import betting
from halfseen.monitoring.answer import Monitored
from halfseen.monitoring.monitor import bets_of, concluded
from halfseen.policies.folder import StoredPolicy, read_policy

NUM_LEARNED, NUM_BEFORE, NUM_CHANGED, WORN_AFTER, BLOCK = 400, 300, 600, 600, 50
SOON = 150
SHARE = 1 / 3
TOGETHER = 4
"""Lifetimes whose bets are settled together."""
Chances = Callable[[pd.DataFrame, int], np.ndarray]


@contextmanager
def patched(module: Any, name: str, value: Any) -> Iterator[None]:
    usual = getattr(module, name)
    setattr(module, name, value)
    try:
        yield
    finally:
        setattr(module, name, usual)


class BinInService:
    """The bin; a worn gripper fetches less often."""

    actions, swapped, part = Bin.actions, ("clutter", "views"), "grasp"
    attempts, paid = ("grasp",), 0.5

    def chance(self, rows: pd.DataFrame, wear: Any) -> np.ndarray:
        return np.clip(bin_cell.reach(rows[list(Bin.covariates)].to_numpy()) - wear, 0.02, 0.95)

    def learned_from(self, num: int, seed: int) -> Logs:
        return Bin().log(num, seed, SHARE)

    def log(self, chances: Chances, num: int, seed: int, wear: float = 0.0) -> Logs:
        cell, usual = Bin(), bin_cell.reach
        rate = cell._rate(SHARE)
        with patched(bin_cell, "reach", lambda state: np.clip(usual(state) - wear, 0.02, 0.95)):
            cell.logging, cell._rate = chances, lambda _: rate
            return cell.log(num, seed, SHARE)


class CellInService:
    """The pick cell; worn grippers pick less often."""

    actions, swapped, part = cell_parts.ACTIONS_ALL, ("shine", "clutter"), None
    attempts, paid = cell_parts.GRIPPERS, 0.3

    def chance(self, rows: pd.DataFrame, wear: Any) -> np.ndarray:
        action = pd.Index(self.actions).get_indexer(rows["action"])
        return cell_parts.chance_of_pick(rows, action) * (1.0 - 1.3 * wear)

    def learned_from(self, num: int, seed: int) -> Logs:
        return cell_trajectories.simulate(num, seed)

    def log(self, chances: Chances, num: int, seed: int, wear: float = 0.0) -> Logs:
        usual = cell_parts.chance_of_pick

        def worn(parts: pd.DataFrame, action: Any) -> np.ndarray:
            return usual(parts, action) * (1.0 - 1.3 * wear)

        with patched(cell_trajectories, "logging_chances", chances), patched(cell_parts, "chance_of_pick", worn):
            return cell_trajectories.simulate(num, seed)


class ClinicInService:
    """The clinic; treatments cure less often."""

    actions, swapped, part, attempts = TREATMENTS, SYMPTOMS[:2], None, None

    def learned_from(self, num: int, seed: int) -> Logs:
        return Clinic().log(num, seed)

    def log(self, chances: Chances, num: int, seed: int, wear: float = 0.0) -> Logs:
        clinic, stages = Clinic(), count(1)
        clinic.cures = clinic.cures * (1.0 - 1.3 * wear)
        clinic.logging = lambda symptoms, _: chances(pd.DataFrame(symptoms, columns=pd.Index(SYMPTOMS)), next(stages))
        return clinic.log(num, seed)


WORLDS: dict[str, Any] = {"bin": BinInService(), "pick cell": CellInService(), "clinic": ClinicInService()}


def chances_of(stored: StoredPolicy, world: Any) -> Chances:
    """Follow the policy."""
    index, one = pd.Index(world.actions), np.eye(len(world.actions))

    def chances(frame: pd.DataFrame, stage: int) -> np.ndarray:
        return one[index.get_indexer(stored.policy.decide(frame, stage))]

    return chances


def joined(parts: list[Logs]) -> Logs:
    begun, tables = 0, []
    for part in parts:
        tables.append(
            [frame.assign(trajectory=frame["trajectory"] + begun) for frame in (part.stages, part.trajectories)]
        )
        begun += part.num_trajectories
    return Logs(*(pd.concat(each, ignore_index=True) for each in zip(*tables, strict=True)))


def wear_after(num: Any) -> Any:
    """Wear, so many trajectories after it begins."""
    return 0.2 + 0.3 * np.minimum(num // BLOCK * BLOCK / WORN_AFTER, 1.0)


def worn(stored: StoredPolicy, world: Any, num: int, seed: int) -> Logs:
    chances = chances_of(stored, world)
    wears = [float(wear_after(begun)) for begun in range(0, num, BLOCK)]
    after = [world.log(chances, BLOCK, 1000 * seed + k, wear) for k, wear in enumerate(wears)]
    return joined([world.log(chances, NUM_BEFORE, seed), *after])


def swapped(stored: StoredPolicy, world: Any, num: int, seed: int) -> Logs:
    one, other = world.swapped
    chances = chances_of(stored, world)

    def turned(frame: pd.DataFrame) -> pd.DataFrame:
        return frame.assign(**{one: frame[other], other: frame[one]})

    logs = world.log(lambda frame, stage: chances(turned(frame), stage), num, seed)
    return Logs(turned(logs.stages), logs.trajectories)


def known_delay(world: Any, logs: Logs) -> float:
    """Trajectories until who knows all is sure of wear, at 1 in 20."""
    rows: Any = logs.stages[logs.stages["reward"].notna() & logs.stages["action"].isin(world.attempts)]
    after = rows["trajectory"].to_numpy() - NUM_BEFORE
    rows, after = rows[after >= 0], after[after >= 0]
    now, usual = world.chance(rows, wear_after(after)), world.chance(rows, 0.0)
    is_paid = rows["reward"].to_numpy() > world.paid
    terms = np.where(is_paid, np.log(now / usual), np.log((1.0 - now) / (1.0 - usual)))
    is_sure = np.cumsum(np.bincount(after, terms)) >= np.log(20.0)
    return float(np.argmax(is_sure)) + 1.0 if is_sure.any() else np.inf


def known_delays(world: Any, policies: list[StoredPolicy], num: int) -> dict[str, Any]:
    each = [worn(policies[k // TOGETHER % len(policies)], world, NUM_CHANGED, k + 100) for k in range(num)]
    at = np.array([known_delay(world, logs) for logs in each])
    low, middle, high = (float(np.quantile(at, q, method="inverted_cdf")) for q in (0.05, 0.5, 0.95))
    return {"changes": num, "median": middle, "from": low, "to": high, f"within {SOON}": float((at <= SOON).mean())}


def watched(stored: StoredPolicy, logs: list[Logs]) -> list[Monitored]:
    """Watch several logs; their bets are settled together, which is faster."""
    bets = [bets_of(stored, each, seed) for seed, each in enumerate(logs)]
    payoffs = [np.concatenate(list(each.payoffs.values()), axis=1) for each in bets]
    wealth = betting.log_wealth(np.concatenate(payoffs, axis=1))
    ends = np.cumsum([each.shape[1] for each in payoffs])
    return [concluded(stored, *each) for each in zip(bets, np.split(wealth, ends[:-1], axis=1), strict=True)]


def learned(world: Any, folder: Path, seed: int) -> StoredPolicy:
    logs = folder / f"logs-{seed}"
    world.learned_from(NUM_LEARNED, seed).write(logs)
    command = [sys.executable, "-m", "halfseen.cli", "learn", str(logs), "--out", str(folder / f"policy-{seed}")]
    subprocess.run(command, check=True, capture_output=True)
    return read_policy(folder / f"policy-{seed}")


def figures(world: Any, policies: list[StoredPolicy], options: Any, what: str) -> dict[str, Any]:
    found: dict[str, Any] = {"promised": [each.record["promise"]["value"]["value"] for each in policies]}
    kinds: dict[str, tuple[int, int, Any]] = {
        "nothing": (options.lifetimes, options.trajectories, None),
        "wear": (options.changes, NUM_CHANGED, worn),
        "swapped": (options.changes, NUM_CHANGED, swapped),
    }
    for kind, (times, num, make) in kinds.items():
        answers: list[Monitored] = []
        for begun in tqdm(range(0, times, TOGETHER), f"{what}, {kind}", leave=False, disable=None):
            stored = policies[begun // TOGETHER % len(policies)]
            seeds = range(begun + 100, min(begun + TOGETHER, times) + 100)
            chances = chances_of(stored, world)
            logs = [world.log(chances, num, s) if make is None else make(stored, world, num, s) for s in seeds]
            answers += watched(stored, logs)
        found[kind] = alarms(answers) if make is None else delays(answers, world, kind)
        print(f"{what:<10}{kind:<9}{found[kind]}", flush=True)
    if world.attempts:
        found["wear, known"] = known_delays(world, policies, options.changes)
        print(f"{what:<10}known    {found['wear, known']}", flush=True)
    return found


def alarms(answers: list[Monitored]) -> dict[str, Any]:
    first = [each.findings[0].family for each in answers if each.findings]
    by = {family: first.count(family) for family in sorted(set(first))}
    return {"lifetimes": len(answers), "alarms": len(first), "share": len(first) / len(answers), "by": by}


def delays(answers: list[Monitored], world: Any, kind: str) -> dict[str, Any]:
    begun = NUM_BEFORE if kind == "wear" else 0
    at = np.array([np.inf if each.alarm_at is None else each.alarm_at - begun for each in answers])
    names = world.swapped if kind == "swapped" else filter(None, [world.part])
    words = [" ".join([*each.causes, *(one.words for one in each.findings)]) for each in answers]
    low, middle, high = (float(np.quantile(at, q, method="inverted_cdf")) for q in (0.05, 0.5, 0.95))
    return {
        "changes": len(answers),
        "too early": float((at <= 0).mean()),
        "median": middle if np.isfinite(middle) else None,
        "from": low if np.isfinite(low) else None,
        "to": high if np.isfinite(high) else None,
        f"within {SOON}": float(((at > 0) & (at <= SOON)).mean()),
        "named": float(np.mean([all(name in each for name in names) for each in words])),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lifetimes", type=int, default=200)
    parser.add_argument("--trajectories", type=int, default=10_000)
    parser.add_argument("--changes", type=int, default=200)
    parser.add_argument("--policies", type=int, default=4)
    parser.add_argument("--only", nargs="*", choices=list(WORLDS), default=list(WORLDS))
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/service.json"))
    options = parser.parse_args()
    results = {}
    with TemporaryDirectory() as folder:
        for name in options.only:
            place = Path(folder) / name
            place.mkdir()
            policies = [learned(WORLDS[name], place, seed) for seed in range(options.policies)]
            results[name] = figures(WORLDS[name], policies, options, name)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
