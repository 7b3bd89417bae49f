"""Cuts that depend on the covariate: a linear and a quadratic median, one covariate, 30 % and 50 % of the rows cut.

python examples/dependent_cuts.py [--out folder] [--repetitions N] [--rows N ...] [--seed S] [--reg λ]
"""

from cut_regression.command import run
from cut_regression.layouts import dependent_figure
from cut_regression.settings import CUT_SHARES, Setting

SETTINGS = [Setting(median, 1, "dependent", share) for median in ("linear", "quadratic") for share in CUT_SHARES]

if __name__ == "__main__":
    run(
        "dependent_cuts",
        __doc__,
        SETTINGS,
        sizes=(800,),
        num_repetitions=10,
        pairs=[("kaplan-meier", "uncut"), ("cox", "kaplan-meier"), ("cox", "cox-times")],
        draw=dependent_figure,
    )
