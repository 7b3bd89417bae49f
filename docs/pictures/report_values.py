"""What the example's policy is worth, by later logs, as the first figure of `halfseen report` draws it."""

from matplotlib.figure import Figure

from pictures.example_policy import BIN_CELL, example_policy
from pictures.picture import plot


def draw_report_values() -> Figure:
    """Learn, judge by the later logs, and draw the values, as `halfseen learn` and `halfseen report` do."""
    from halfseen.evaluation import evaluate
    from halfseen.evaluation.specification import specification_of
    from halfseen.logs import read_logs
    from halfseen.view.policy_figures import draw_values

    later = read_logs(BIN_CELL / "later_logs")
    stored = example_policy(BIN_CELL)
    spec = specification_of(stored, later)
    return draw_values(evaluate(stored.policy, later, censoring=spec.censoring, q=spec.q, random_state=0))


REPORT_VALUES = plot("report-values", draw_report_values, seconds=30.0)
