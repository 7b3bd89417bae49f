"""Ten covariates, of which only the first matters: both medians, both kinds of cuts, 30 % and 50 % of the rows cut.

python examples/ten_covariates.py [--out folder] [--repetitions N] [--rows N ...] [--seed S] [--reg λ]
"""

from itertools import product

from cut_regression.command import run
from cut_regression.layouts import ten_figure
from cut_regression.settings import CUT_SHARES, Setting

SETTINGS = [
    Setting(median, 10, cuts, share)
    for median, cuts, share in product(("linear", "quadratic"), ("uniform", "dependent"), CUT_SHARES)
]

if __name__ == "__main__":
    run(
        "ten_covariates",
        __doc__,
        SETTINGS,
        sizes=(400,),
        num_repetitions=8,
        pairs=[("kaplan-meier", "uncut"), ("kaplan-meier", "cox-times"), ("kaplan-meier", "constant")],
        draw=ten_figure,
    )
