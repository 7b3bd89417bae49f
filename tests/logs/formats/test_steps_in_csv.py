"""Steps in CSV, whose columns have no types: what comes out was worked out by hand from the rows."""

import pytest

from halfseen.logs.formats import StepRules, read_steps
from refusals import refused

STEPS = """\
episode_id,is_first,is_last,is_terminal,observation.x,action,reward
{0},true,false,false,0.5,{2},1
{0},false,true,true,0.5,,
{1},true,false,false,{3},{2},2
{1},false,true,true,0.5,,
"""


@pytest.fixture
def read(tmp_path):
    def write_and_read(*cells):
        (tmp_path / "steps.csv").write_text(STEPS.format(*cells))
        return read_steps(tmp_path / "steps.csv", StepRules(step_s=1.0))

    return write_and_read


def test_names_keep_the_zeros_before_them(read):
    for cells, names, action in ((("007", "010", "02"), ["007", "010"], "02"), (("7", "10", "2"), [7, 10], 2)):
        logs = read(*cells, "1.5")
        assert logs.trajectory_ids.tolist() == names
        assert logs.stages["action"].tolist() == [action, action]


def test_a_text_among_numbers_is_no_category(read):
    assert read("a", "b", "go", "1.5").stages["observation.x"].tolist() == [0.5, 1.5]
    with refused(
        r"steps\.csv, row 4, column 'observation\.x': 'NA' is not a number, though most cells of the column "
        "are"
    ):
        read("a", "b", "go", "NA")
    with refused(r"trajectory 'b', stage 1: covariate observation\.x is null"):
        read("a", "b", "go", "")


def test_a_text_among_rewards_and_other_separators_are_told(tmp_path):
    file = tmp_path / "steps.csv"
    file.write_text(STEPS.format("a", "b", "go", "1.5").replace("0.5,,\nb", "0.5,NA,NA\nb"))
    with refused(r"steps\.csv, row 1: reward is 'NA', not a number; fix it, or name another column as reward"):
        read_steps(file, StepRules(step_s=1.0))
    file.write_text(STEPS.format("a", "b", "go", "1.5").replace(",", ";").replace(".5", ",5"))
    with refused(r"steps\.csv: its cells are separated by ';'; export it with commas between cells and points in"):
        read_steps(file, StepRules(step_s=1.0))
