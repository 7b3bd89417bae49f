"""A pick cell with three grippers, a person to hand parts to, and cuts that come where clutter is.

python examples/pick_cell/pick_cell.py

Read down: `cell_parts` (parts, actions, rewards, cuts) → `cell_trajectories` (who decides; logs) → `cell_optimum` (what
a policy is worth, exactly) → `cell_comparison` (learners on the same logs). `record` writes the logs that the guide
uses.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from cell_comparison import BY_COX, METHODS, compare, learner
from cell_optimum import best_order, optimum, policy_value
from cell_parts import ACTIONS, COVARIATES
from cell_trajectories import rule_of_thumb
from record import LOGS
from scipy import stats
from threadpoolctl import threadpool_limits

from halfseen.learning import bootstrap
from halfseen.logs import Logs, read_logs

FIRST, RULE = "default", "rule of thumb"
ASKED = pd.DataFrame([[0.3, 0.9, 0.2], [2.5, 0.2, 0.1], [0.4, 0.1, 0.8]], columns=pd.Index(COVARIATES))
"""A light shiny part, a heavy one with room around it, and a light one in clutter."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Compare the policies, then ask the recorded logs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=Path, default=LOGS, help="recorded logs (%(default)s)")
    parser.add_argument(
        "--trajectories", type=_at_least(100), default=1000, help="trajectories of a simulated log (%(default)s)"
    )
    parser.add_argument("--repetitions", type=_at_least(2), default=5, help="simulated logs (%(default)s)")
    parser.add_argument("--replicates", type=_at_least(2), default=50, help="of the bootstrap (%(default)s)")
    parser.add_argument("--seed", type=_at_least(0), default=0, help="seed (%(default)s)")
    options = parser.parse_args(arguments)
    print(plain_policies())
    print(f"\nLearned from {options.trajectories} trajectories, logs: {options.repetitions}")
    print(table(compare(options.trajectories, options.repetitions, options.seed)))
    print(f"\n{options.logs}: {read_logs(options.logs).summary()}")
    print(intervals(read_logs(options.logs), options.replicates, options.seed))


def plain_policies() -> str:
    """Tell what needs no learning, exactly."""
    best = optimum()[0]
    order_value, order = best_order()
    rule = policy_value(rule_of_thumb)
    return (
        f"Expected reward of a part: optimum {best:.3f}; rule of thumb {rule:.3f}; best fixed order "
        f"({', '.join(order)}) {order_value:.3f}."
    )


def table(found: pd.DataFrame) -> str:
    """Mean value of each method, and the 95 % interval of its difference from the default on the same logs."""
    values = found.pivot_table(index="log", columns="method", values="value").assign(
        **{RULE: policy_value(rule_of_thumb)}
    )
    lines = []
    for method in (name for name in (*METHODS, RULE) if name in values.columns):
        line = {"method": method, "value": f"{values[method].mean():.3f}"}
        line["of the optimum"] = f"{values[method].mean() / optimum()[0]:.1%}"
        difference = values[FIRST] - values[method]
        reach = stats.t.ppf(0.975, len(difference) - 1) * stats.sem(difference)
        line["default is better by"] = "" if method == FIRST else f"{difference.mean():+.3f} ± {reach:.3f}"
        lines.append(line)
    return f"{pd.DataFrame(lines).to_string(index=False)}\nTrajectories cut: {found['cut_share'].mean():.0%}"


def intervals(logs: Logs, num_replicates: int, seed: int) -> str:
    """Learn from a log, and tell Q in the first stage with 95 % bootstrap intervals for some parts."""
    with threadpool_limits(1):
        fitted = learner(censoring=BY_COX).fit(logs)
        drawn = bootstrap(fitted, logs, num_replicates, seed)
    q = fitted.q_values(ASKED, 1)
    low, high = drawn.q_interval(ASKED, 1)
    shares = drawn.decision_shares(ASKED, 1)
    lines = []
    for row, part in enumerate(ASKED.to_dict("records")):
        line = {name: f"{value:.1f}" for name, value in part.items()}
        for column, name in enumerate(ACTIONS[1]):
            interval = f"{low[row, column]:.2f} to {high[row, column]:.2f}"
            line[name] = f"{q[row, column]:.2f} ({interval}), best in {shares[row, column]:.0%}"
        lines.append(line)
    head = f"Q of the first stage, with 95 % intervals over {num_replicates} draws of the trajectories"
    return f"{head}\n{pd.DataFrame(lines).to_string(index=False)}"


def _at_least(least: int):
    def number(text: str) -> int:
        value = int(text) if text.isdecimal() else least - 1
        if value < least:
            raise argparse.ArgumentTypeError(f"{text!r} is no whole number ≥ {least}")
        return value

    return number


if __name__ == "__main__":
    main()
