"""The table of the guide that says which weights are biased: what its rows claim, and that they can be made again."""

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
PAGE = (ROOT / "docs" / "guide" / "which-censoring-model.md").read_text(encoding="utf-8")
NUMBER = r"[+−]?\d+\.\d+"


def rows(situation):
    """Bias [s], its standard error [s] and coverage [%], by share of cuts and model."""
    table = PAGE.split(f"<!-- benchmarks/dependent_cuts.py: {situation} -->\n")[1].split("\n\n")[0]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]
    numbers = {(cut, model): re.findall(NUMBER, bias + " " + covers) for cut, model, _, bias, covers in cells}
    return {key: [float(number.replace("−", "-")) for number in row] for key, row in numbers.items()}


@pytest.mark.parametrize("cut", ["1/3", "1/2"])
def test_kaplan_meier_is_biased_where_cuts_depend_on_covariates_and_cox_is_not(cut):
    biased, biased_error, biased_covers = rows("linear")[cut, "kaplan-meier"]
    bias, error, covers = rows("linear")[cut, "cox"]
    assert abs(biased) > 10 * biased_error
    assert biased_covers < 80
    assert abs(bias) < 2 * error
    assert covers >= 95


@pytest.mark.slow
@pytest.mark.parametrize("situation", ["linear", "curved"])
def test_the_table_is_what_the_benchmark_prints(situation):
    measured = runpy.run_path(str(ROOT / "benchmarks" / "dependent_cuts.py"))["measured"]
    written = rows(situation)
    for row in measured(situation, 200, ("drop", "kaplan-meier", "cox", "cox, z and z²")):
        bias, error, covers = written[row["share"], row["model"]]
        assert [row["bias_s"], row["bias_error_s"]] == pytest.approx([bias, error], abs=1e-3)
        # One interval of 200 may end so near the truth that rounding decides.
        assert 100 * row["coverage"] == pytest.approx(covers, abs=0.51)
