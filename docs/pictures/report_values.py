"""What the example's policy is worth, by later logs, as the first figure of `halfseen report` draws it."""

from pathlib import Path
from tempfile import TemporaryDirectory

from matplotlib.figure import Figure

from pictures.picture import ROOT, plot

EXAMPLE = ROOT / "examples" / "pick_cell"


def draw_report_values() -> Figure:
    """Learn, judge by the later logs, and draw the values, as `halfseen learn` and `halfseen report` do."""
    from click.testing import CliRunner

    from halfseen.cli import halfseen
    from halfseen.evaluation import evaluate
    from halfseen.evaluation.stored_model import specification_of
    from halfseen.logs import read_logs
    from halfseen.policies import read_policy
    from halfseen.report.values_figure import draw_values

    later = read_logs(EXAMPLE / "later_logs")
    with TemporaryDirectory() as folder:
        command = ["learn", str(EXAMPLE / "logs"), "--out", f"{folder}/policy", "--no-verdict"]
        done = CliRunner().invoke(halfseen, command, catch_exceptions=False)
        assert done.exit_code == 0, done.output
        stored = read_policy(Path(folder) / "policy")
    spec = specification_of(stored, later)
    return draw_values(evaluate(stored.policy, later, censoring=spec.censoring, q=spec.q, random_state=0))


REPORT_VALUES = plot("report-values", draw_report_values, seconds=30.0)
