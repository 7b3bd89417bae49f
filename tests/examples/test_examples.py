import re
import subprocess
import sys
from pathlib import Path

import pytest
from cut_regression.comparison import compare
from cut_regression.methods import METHODS, REG
from cut_regression.settings import Setting
from matplotlib.image import imread

EXAMPLES = Path(__file__).parents[2] / "examples"
NUM_LINES = {"linear_median": 2, "quadratic_median": 2, "dependent_cuts": 4, "ten_covariates": 8}
SCRIPTS = sorted(NUM_LINES)
SMALL = ("--repetitions", "1", "--rows", "60", "--seed", "3")


def run(script: str, *options: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, EXAMPLES / f"{script}.py", *options],
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=False,
    )


def test_every_script_is_tested_and_listed():
    there = {path.stem for path in EXAMPLES.glob("*.py")}
    assert there == {*SCRIPTS, "tiger"}
    listed = re.findall(r"`python examples/(\w+)\.py`", (EXAMPLES / "README.md").read_text(encoding="utf-8"))
    assert sorted(listed) == sorted(there)


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_prints_and_draws_the_same_again(script, tmp_path):
    out = tmp_path / "figures"
    first = run(script, *SMALL, "--out", str(out))
    assert (first.returncode, first.stderr) == (0, "")
    figure = out / f"{script}.png"
    drawn = figure.read_bytes()
    height, width = imread(figure).shape[:2]
    assert min(height, width) > 500

    head, names, *lines, at_tau, sentence, path = first.stdout.splitlines()
    assert head.startswith("Mean |estimate − true median| [s] over one sample")
    assert names.split()[-6:] == ["Ĝ", "uncut", "only", "Cox", "times", "constant"]
    assert len(lines) == NUM_LINES[script]
    for line in lines:
        assert re.search(r" 60 +\d\d\.\d%( +\d\.\d{3}){7}$", line), line
    assert at_tau.startswith("Cox's curve of the times stays above ½ in ")
    assert sentence.startswith("With 60 rows, compared with the SVM on uncut rows only, ")
    assert "not told apart by one sample" in sentence
    assert path == f"Figure: {figure}"

    again = run(script, *SMALL, "--out", str(out))
    assert (again.stdout, figure.read_bytes()) == (first.stdout, drawn)


def test_what_else_is_asked_for_changes_no_number():
    setting = Setting("linear", 1, "uniform", 0.5)
    few, more = compare([setting], [60], 1, 3, REG), compare([setting], [60, 80], 2, 3, REG)
    for method in METHODS:
        assert few.errors_of(setting, 60, method) == more.errors_of(setting, 60, method)[0]
    assert (more.sizes, more.num_repetitions) == ([60, 80], 2)
