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


def test_a_text_among_rewards_and_other_separators_are_reported(tmp_path):
    file = tmp_path / "steps.csv"
    file.write_text(STEPS.format("a", "b", "go", "1.5").replace("0.5,,\nb", "0.5,NA,NA\nb"))
    with refused(r"steps\.csv, row 1: reward is 'NA', not a number; fix it, or name another column as reward"):
        read_steps(file, StepRules(step_s=1.0))
    file.write_text(STEPS.format("a", "b", "go", "1.5").replace(",", ";").replace(".5", ",5"))
    with refused(r"steps\.csv: its cells are separated by ';'; export it with commas between cells and points in"):
        read_steps(file, StepRules(step_s=1.0))


@pytest.mark.parametrize("name", ["step_id", "frame_index"])
def test_steps_that_are_not_in_the_order_of_their_numbers_are_refused(tmp_path, name):
    def read_numbered(*numbers):
        rows = (STEPS.format("a", "b", "go", "1.5") + "b2,true,false,false,1,go,3\n").splitlines()
        text = "".join(f"{row},{number}\n" for row, number in zip(rows, (name, *numbers), strict=True))
        (tmp_path / "steps.csv").write_text(text)
        return read_steps(tmp_path / "steps.csv", StepRules(step_s=1.0))

    assert list(read_numbered(0, 1, 0, 1, 0).stage_covariates) == ["observation.x"]
    for second in (0, 1):
        with refused(rf"steps\.csv, row 3: {name} is {second} after 1 in one episode; put the rows in order"):
            read_numbered(0, 1, 1, second, 0)
