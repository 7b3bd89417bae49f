"""A linear median, one covariate, uniform cuts of 30 % and 50 % of the rows.

python examples/linear_median.py [--out folder] [--repetitions N] [--rows N ...] [--seed S] [--reg λ]
"""

from cut_regression.command import run
from cut_regression.layouts import sizes_figure
from cut_regression.settings import CUT_SHARES, Setting

SETTINGS = [Setting("linear", 1, "uniform", share) for share in CUT_SHARES]

if __name__ == "__main__":
    run(
        "linear_median",
        __doc__,
        SETTINGS,
        sizes=(100, 200, 400),
        num_repetitions=10,
        pairs=[("kaplan-meier", "uncut"), ("kaplan-meier", "cox-times")],
        draw=sizes_figure,
    )
