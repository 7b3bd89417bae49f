"""A policy against the rule of today in the bin cell: trajectories until it is promoted, and how often that is wrong.

python benchmarks/against.py [--out runs/benchmarks/against.json] [--lifetimes 200] [--nulls 2000]
                             [--most-loss 20]

Lifetimes are drawn from trajectories of the cell's rule and of its optimum, with no cuts and with the rates at which
half of the rule's are cut. First the outcome is success or not, trajectories are dealt by a fair coin, and peers are
asked the same: a test of fixed size with a power of 0.8, which looks once; and STEP, Lai and SAVI of
sequentialized-barnard-tests (arXiv 2503.10966), if that is installed, which look after each pair and leave out what was
cut. Its licence is not commercial, so it is no dependency. Then the reward is the cell's, and trajectories are dealt as
`halfseen serve --against` does. Last, arms succeed equally often, but cuts hide the slow successes of the rule.
"""

import argparse
import importlib
import json
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
import pandas as pd
from timings import Row, write
from worlds.examples import Bin

from halfseen.monitoring.comparison import Courses, beats_at, counted
from halfseen.monitoring.dealing import PROMOTES, Standing, Terms, standing

NUM_DRAWN, LONGEST, LOOK_EVERY = 4000, 300, 3
SHARES = {"none cut": 0.0, "half cut": 0.5}
FEWEST_PAIRS = 200


class Arm(Bin):
    """The cell, run by one of its policies; cuts are as frequent as where the rule runs."""

    def __init__(self, policy: str) -> None:
        self.policy = policy

    def logging(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        return getattr(super(), self.policy)(frame, stage)

    @cached_property
    def rule(self) -> "Arm":
        return self if self.policy == "plain" else Arm("plain")

    def _rate(self, share: float) -> float:
        return Bin._rate(self.rule, share)

    def courses(self, share: float, seed: int, *, is_success: bool) -> Courses:
        """Draw trajectories; of success, the reward is 1 where the part was fetched."""
        logs = self.log(NUM_DRAWN, seed, share)
        stages, trajectories = logs.stages, logs.trajectories
        reward = stages["reward"].to_numpy()
        none = np.zeros(len(trajectories))
        return Courses(
            none.astype(bool),
            none,
            trajectories["end_s"].to_numpy(),
            logs.is_finished,
            np.searchsorted(trajectories["trajectory"], stages["trajectory"]),
            stages[list(self.covariates)].to_numpy(dtype=np.float64),
            np.where(np.isnan(reward), np.nan, reward > 0.5) if is_success else reward,
            stages["elapsed_s"].to_numpy(),
        )


def dealt(rule: Courses, policy: Courses, num: int, chance: float, rng: np.random.Generator) -> Courses:
    """Deal trajectories to either."""
    is_policy = rng.random(num) < chance
    each = rng.integers(NUM_DRAWN, size=num).tolist()
    parts = [(policy if one else rule).part(k, k + 1) for one, k in zip(is_policy, each, strict=True)]
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    trajectory = np.repeat(np.arange(num), [len(part.reward) for part in parts])
    return Courses(*columns)._replace(is_policy=is_policy, chance=np.full(num, chance), trajectory=trajectory)


def promoted_at(courses: Courses, alpha: float) -> float:
    """Number of trajectories until promotion; ∞ if none of them is enough."""
    of = counted(courses)
    found = beats_at(of, 0.0, alpha)
    return np.inf if found is None else found + courses.num - of.excess.size


def held(rule: Courses, policy: Courses, terms: Terms, rng: np.random.Generator) -> Standing:
    """Hold a comparison as `serve` does, a few trajectories at a time."""
    so_far, found = None, None
    while found is None or (found.verdict == "going on" and found.num < LONGEST):
        new = dealt(rule, policy, LOOK_EVERY, terms.share if found is None else found.share, rng)
        if so_far is not None:
            new = new._replace(trajectory=new.trajectory + so_far.num)
            new = Courses(*(np.concatenate(each) for each in zip(so_far, new, strict=True)))
        so_far, found = new, standing(new, terms)
    return found


def fixed_size(rule: Courses, policy: Courses, alpha: float, power: float = 0.8) -> float:
    """Trajectories of a test that looks once, of whose effect it knows beforehand; it leaves out what was cut."""
    seen = [each.totals()[each.is_finished] for each in (rule, policy)]
    need = NormalDist().inv_cdf(1.0 - alpha) + NormalDist().inv_cdf(power)
    variance = sum(each.var() / each_of.is_finished.mean() for each, each_of in zip(seen, (rule, policy), strict=True))
    return 2.0 * float(variance * (need / (seen[1].mean() - seen[0].mean())) ** 2)


def peers() -> dict[str, tuple[float, Callable[[], Any]]]:
    """Their tests by name, each with its level."""
    try:
        theirs = importlib.import_module("sequentialized_barnard_tests")
    except ImportError:
        print("peers are left out: pip install sequentialized-barnard-tests (CC BY-NC)")
        return {}
    better = theirs.Hypothesis.P0LessThanP1
    return {
        "SAVI": (PROMOTES, lambda: theirs.SaviTest(better, PROMOTES)),
        "Lai, 200 pairs": (PROMOTES, lambda: theirs.LaiTest(better, FEWEST_PAIRS, PROMOTES)),
        "STEP, 200 pairs": (0.05, lambda: theirs.StepTest(better, FEWEST_PAIRS, 0.05)),
    }


def peer_at(test: Any, courses: Courses) -> float:
    """Number of trajectories until the peer says better, of pairs of those that were not cut."""
    test.reset()
    waiting: list[list[int]] = [[], []]
    totals = courses.totals()
    for k in np.flatnonzero(courses.is_finished):
        waiting[int(courses.is_policy[k])].append(int(totals[k]))
        if all(waiting):
            found = test.step(*(each.pop(0) for each in waiting))
            if found.decision.name == "AcceptAlternative":
                return float(k + 1)
            if found.decision.name == "AcceptNull":
                break
    return np.inf


def by_success(num: int, cuts: str) -> dict[str, Any]:
    """Median number until "better", of a fair coin."""
    arms = [Arm(name).courses(SHARES[cuts], seed, is_success=True) for seed, name in enumerate(("plain", "best"))]
    rng = np.random.default_rng(1)
    lifetimes = [dealt(arms[0], arms[1], LONGEST, 0.5, rng) for _ in range(num)]
    found: dict[str, Any] = {"fixed size, 0.025": fixed_size(arms[0], arms[1], PROMOTES)}
    for alpha in (PROMOTES, 0.05):
        found[f"ours, {alpha}"] = float(np.median([promoted_at(each, alpha) for each in lifetimes]))
    for name, (alpha, make) in peers().items():
        test = make()
        found[f"{name}, {alpha}"] = float(np.median([peer_at(test, each) for each in lifetimes[: min(num, 100)]]))
    return found


def by_reward(num: int, num_nulls: int, most_loss: float, cuts: str) -> dict[str, Any]:
    """The whole procedure: until promotion, wrong promotions, and what a worse policy loses."""
    rule, policy = (
        Arm(name).courses(SHARES[cuts], seed, is_success=False) for seed, name in enumerate(("plain", "best"))
    )
    gain = Arm("best").value(Arm("best").logging) - Arm("plain").value(Arm("plain").logging)
    rng = np.random.default_rng(2)
    good = [held(rule, policy, Terms(0.2, most_loss), rng) for _ in range(num)]
    bad = [held(policy, rule, Terms(0.2, most_loss), rng) for _ in range(num)]
    ends = [each.num if each.verdict == "promoted" else np.inf for each in good]
    false = {
        chance: float(
            np.mean([promoted_at(dealt(rule, rule, LONGEST, chance, rng), PROMOTES) < np.inf for _ in range(num_nulls)])
        )
        for chance in (0.2, 0.5)
    }
    return {
        "gain": gain,
        "median until promotion": float(np.median(ends)),
        "of these the policy's": float(np.median([each.num_policy for each in good])),
        "promoted": float(np.mean(np.isfinite(ends))),
        "worse promoted": float(np.mean([each.verdict == "promoted" for each in bad])),
        "worse stopped": float(np.mean([each.verdict == "stopped" for each in bad])),
        "loss within bound": float(np.mean([each.num_policy * gain <= most_loss for each in bad])),
        "median loss": float(np.median([each.num_policy * gain for each in bad])),
        "false promotions by share": false,
    }


def slow_successes(num: int, rate: float, rng: np.random.Generator) -> Courses:
    """Draw trajectories of arms that succeed equally often; the rule's successes take long, so that cuts hide them."""
    is_policy, is_success = rng.random((2, num)) < 0.5
    slow, fast, failing = rng.gamma(4.0, 2.0, num), rng.gamma(2.0, 0.5, num), rng.gamma(2.0, 1.0, num)
    needed_s = np.where(is_success, np.where(is_policy, fast, slow), failing)
    end_s = np.minimum(needed_s, rng.exponential(1.0 / rate, num))
    is_finished = needed_s == end_s
    reward, clock_s = (np.where(is_finished, each, np.nan) for each in (is_success, needed_s))
    none = np.zeros((num, 0))
    return Courses(is_policy, np.full(num, 0.5), end_s, is_finished, np.arange(num), none, reward, clock_s)


def where_cuts_hide(num_nulls: int) -> dict[str, float]:
    """Wrong promotions where cuts hide the rule's slow successes, by the rate of cuts [1/s]."""
    rng = np.random.default_rng(3)
    return {
        f"{rate}": float(
            np.mean([promoted_at(slow_successes(LONGEST, rate, rng), PROMOTES) < np.inf for _ in range(num_nulls)])
        )
        for rate in (0.05, 0.1, 0.2)
    }


def measured(num: int, num_nulls: int, most_loss: float) -> dict[str, Any]:
    """All of it."""
    found = {}
    for cuts in SHARES:
        found[cuts] = {"success": by_success(num, cuts)}
        print(cuts, json.dumps(found[cuts], indent=1), flush=True)
        found[cuts]["reward"] = by_reward(num, num_nulls, most_loss, cuts)
        print(cuts, json.dumps(found[cuts]["reward"], indent=1), flush=True)
    return found


def rows(found: dict[str, Any]) -> list[Row]:
    """Ours beside each peer."""
    made = []
    for cuts, each in found.items():
        for peer, theirs in each["success"].items():
            if not peer.startswith("ours"):
                ours = each["success"][f"ours, {peer.rpartition(', ')[2]}"]
                made.append(Row(f"until better, {cuts}, beside {peer}", ours, "trajectories", peer, theirs))
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/against.json"))
    parser.add_argument("--lifetimes", type=int, default=200)
    parser.add_argument("--nulls", type=int, default=2000)
    parser.add_argument("--most-loss", type=float, default=20.0)
    given = parser.parse_args()
    found = measured(given.lifetimes, given.nulls, given.most_loss)
    hidden = where_cuts_hide(given.nulls)
    print("false promotions where cuts hide the rule's slow successes, by rate", json.dumps(hidden), flush=True)
    write(given.out, {**found, "cuts hide slow successes": hidden}, rows(found))


if __name__ == "__main__":
    main()
