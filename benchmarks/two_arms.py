"""How much sooner do two arms clear a table than one? The same fresh tables in physics, with one arm and with two.

python benchmarks/two_arms.py [--tables 40] [--seed 1609] [--rule everything] [--out FILE]

One arm stands behind the table, as `halfseen cell run` has it; two arms stand at its two ends. By default every cup is
to go into a rack, whatever it is believed to be: the one that is hidden least and failed least comes first, and is
given up after three failures. With the name of a heuristic, the cups that it finds worth it under the calibrated law.
Two arms follow the same rule, one arm at a time (`TeamOfRules`). They also clear the tables *in turn*, each standing at
home while the other works: that tells what working at once buys, and what is due to where they stand.

It prints cups in the rack, the time of a table, and its ratio to that of one arm, with 95 % intervals from resampled
tables; collisions of arms or of what they hold, waits for space, and deadlocks. A run that was stopped goes on where it
was, if it is called again.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from tqdm import tqdm

from halfseen.cell.account import Run
from halfseen.cell.calibration.law_folder import read_law
from halfseen.cell.calibration.shipped import shipped_law
from halfseen.cell.campaign import Campaign, Conditions, working_folder
from halfseen.cell.several.pair import PAIR
from halfseen.cell.table_state import Belief
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.planners.named import HEURISTICS
from halfseen.team.actions import possible_actions, wait_of
from halfseen.team.policy import TeamOfRules, TeamPolicy
from halfseen.team.state import TeamState
from halfseen.workers import Workers
from halfseen.world.policy import Decision, Policy, surely
from halfseen.world.state import TableState, attempt_counts, occlusion
from halfseen.writing import write_file

EVERYTHING = "everything"
ONE, TWO, IN_TURN = "one arm", "two arms", "two arms in turn"
MOST_FAILURES = 3
MOST_DECISIONS = 25
NUM_RESAMPLED, LEVEL = 10_000, 0.95


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class WashEverything(GreedyPolicy):
    """Washes the cup that failed least and is hidden least, dirty or not."""

    def worth(self, state: TableState) -> Float[Array, " N"]:
        """Above 0 as long as it is worth another try."""
        _, failures = attempt_counts(state)
        is_worth_it = state.is_on_table & (failures < MOST_FAILURES)
        return jnp.where(is_worth_it, MOST_FAILURES - failures - 0.9 * occlusion(state), -jnp.inf)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class InTurn:
    """A team of which nobody begins while another is at work.

    Parameters
    ----------
    base
        Who decides else.
    """

    base: TeamPolicy

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose for one table."""
        wait = wait_of(state.table.num_objects)
        usual = self.base.decide(state, key)
        is_to_wait = possible_actions(state)[wait]
        return surely(jnp.where(is_to_wait, wait, usual.action).astype(jnp.int32))


def plans_of(rule: GreedyPolicy) -> dict[str, tuple[Policy | TeamPolicy, Conditions]]:
    """Who clears the tables, and in which cell."""
    one, two = Conditions(stops=None), Conditions(stops=None, stations=PAIR)
    team = TeamOfRules(rule)
    return {ONE: (rule, one), TWO: (team, two), IN_TURN: (InTurn(team), two)}


def told_of(runs: Sequence[Run], base: Sequence[Run] | None) -> dict[str, Any]:
    """What came of some tables."""
    every = [asdict(run) for run in runs]
    counted = {name: sum(run[name] for run in every) for name in every[0] if name.startswith("num_")}
    seconds = np.array([run.seconds for run in runs])
    told: dict[str, Any] = {
        "tables": len(runs),
        **counted,
        "cut": sum(run.cause is not None for run in runs),
        "waited_s": sum(run.get("waited_s", 0.0) for run in every),
        "reward": float(np.mean([run.reward for run in runs])),
        "reward_without_luck": float(np.mean([run.reward - run.luck for run in runs])),
        "seconds": {"mean": float(seconds.mean()), "median": float(np.median(seconds))},
        "runs": every,
    }
    return told if base is None else told | {"ratio": ratio(seconds, np.array([run.seconds for run in base]))}


def ratio(seconds: Float[np.ndarray, " n"], of_one: Float[np.ndarray, " n"]) -> dict[str, float]:
    """Ratio of the times of all tables, with an interval from resampled tables; and the median of their ratios."""
    drawn = np.random.default_rng(0).integers(len(seconds), size=(NUM_RESAMPLED, len(seconds)))
    ratios = seconds[drawn].sum(axis=1) / of_one[drawn].sum(axis=1)
    low, high = np.quantile(ratios, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2]).tolist()
    each = seconds / of_one
    return {
        "value": float(seconds.sum() / of_one.sum()),
        "low": low,
        "high": high,
        "median": float(np.median(each)),
        "largest": float(each.max()),
    }


def print_told(name: str, told: Mapping[str, Any]) -> None:
    """Print a line or two of who cleared the tables."""
    print(
        f"{name:<18}{told['num_racked']:>4} of {told['num_cups']} cups in the rack, {told['num_toppled']} toppled, "
        f"{told['num_fallen']} fell; {told['seconds']['mean']:.1f} s a table, median {told['seconds']['median']:.1f}; "
        f"reward {told['reward']:+.2f}"
    )
    if "ratio" in told:
        of_one = told["ratio"]
        print(
            f"{'':<18}{of_one['value']:.3f} of one arm's time ({of_one['low']:.3f} to {of_one['high']:.3f}), median "
            f"{of_one['median']:.3f}, largest {of_one['largest']:.3f}; {told['num_collisions']} collisions, "
            f"{told['num_waits']} waits of {told['waited_s'] / max(told['num_waits'], 1):.1f} s, "
            f"{told['num_deadlocks']} deadlocks, {told['num_gave_way']} gave way"
        )


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
    belief, base = Belief(config, law.grip), None
    results: dict[str, Any] = {"seed": options.seed, "rule": options.rule}
    for name, (policy, conditions) in plans_of(rule).items():
        if options.only and name not in options.only:
            continue
        place = options.out.with_name(f"{options.out.stem}-{name.replace(' ', '-')}")
        campaign = Campaign(policy, belief, conditions, options.seed)
        what = f"{name}, {options.rule}, seed {options.seed}"
        with working_folder(place, what) as folder, Workers(options.workers).ready() as pool:
            done = campaign.runs(range(options.tables), folder, pool)
            runs = [run for _, run in tqdm(done, name, options.tables, leave=False, disable=None)]
        base = runs if name == ONE else base
        results[name] = told_of(runs, None if name == ONE else base)
        print_told(name, results[name])
        # What has been driven for so long is kept, whatever comes of the next.
        options.out.parent.mkdir(parents=True, exist_ok=True)
        write_file(options.out, json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
