"""A clinical trial of three stages with survival times as rewards: learned policies and the best fixed sequence.

python examples/clinical_trial/clinical_trial.py

Read down: `trial_patients` (the trial and its log) → `trial_optimum` (what a policy is worth, exactly) →
`trial_comparison` (learners on the same trials) → `trial_words` (table and sentences) → `trial_figure`.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits
from trial_comparison import METHODS, compare, decision_of
from trial_figure import write_figure
from trial_optimum import optimum, policy_value
from trial_patients import YEAR_S, trial
from trial_words import paired_differences, plain_policies, table

FIGURE_SHARE = 0.3


def main(arguments: Sequence[str] | None = None) -> None:
    """Compare, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/examples"), help="folder of the figure (%(default)s)")
    parser.add_argument("--patients", type=_at_least(50), default=1000, help="patients of a trial (%(default)s)")
    parser.add_argument("--trials", type=_at_least(1), default=5, help="trials (%(default)s)")
    parser.add_argument("--seed", type=_at_least(0), default=0, help="seed (%(default)s)")
    options = parser.parse_args(arguments)
    print(plain_policies())
    found = compare(options.patients, options.trials, options.seed)
    print(f"\nShare of the optimum that is learned from {options.patients} patients, trials: {options.trials}")
    print(table(found))
    print(f"\n{paired_differences(found)}")

    logs = trial(options.patients, FIGURE_SHARE, options.seed)
    print(f"\n{logs.summary()}")
    # Rewards are times: the clock of a log is the sum of its rewards.
    elapsed_s = logs.elapsed_s()
    spent = np.diff(elapsed_s, axis=1, prepend=0.0)[~np.isnan(elapsed_s)] / YEAR_S
    largest = float(np.abs(spent - logs.stages["reward"].dropna()).max())
    print(f"Rewards are times: reward − difference of elapsed_s is at most {largest:.0e} years.")
    with threadpool_limits(1):
        fitted = METHODS["default"](logs)
    ratio = policy_value(decision_of(fitted)) / optimum()[0]
    sentence = (
        f"Stage 1, {options.patients} patients, {logs.cut_share:.0%} cut: the learned policy lives {ratio:.0%} of the "
        "optimum.\nA is better where violet, B where orange; solid: as good as each other, dashed: in truth"
    )
    path = options.out / "clinical_trial.png"
    write_figure(fitted, sentence, path)
    print(f"Figure: {path}")


def _at_least(least: int):
    def number(text: str) -> int:
        value = int(text) if text.isdecimal() else least - 1
        if value < least:
            raise argparse.ArgumentTypeError(f"{text!r} is no whole number ≥ {least}")
        return value

    return number


if __name__ == "__main__":
    main()
