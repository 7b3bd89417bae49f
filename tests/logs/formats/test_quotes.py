"""A stray quote takes the rows below it into its cell, and is reported."""

import pytest

from halfseen.errors import HalfseenWarning, LogError
from halfseen.logs.formats import StepRules, read_csv, read_steps
from refusals import refused

ROWS = 40
NEVER_CLOSED = r"line 6: a quote opens a cell here and is not closed"
LIKE_ROWS = r"line 6: a quote opens a cell here that ends in line 20, and each line of it looks like a row"
MAPPING = """
clock = {field = "s", unit = "s", since = "trajectory"}
trajectory = {field = "run"}
action = {field = "tool"}
reward = {field = "worth"}
ending = {field = "stop", finished = [""]}
"""


def quoted(heading, row, *lines):
    """A table whose last column is text, with a quote before that of some lines, numbered from 1."""
    rows = [heading, *(row.format(k) for k in range(ROWS))]
    for line in lines:
        before, _, note = rows[line - 1].rpartition(",")
        rows[line - 1] = f'{before},"{note}' if line == lines[0] else f'{before},{note}"'
    return "\n".join(rows) + "\n"


@pytest.mark.parametrize(("lines", "message"), [((6,), NEVER_CLOSED), ((6, 20), LIKE_ROWS)])
def test_a_stray_quote_in_others_tables_is_refused_with_its_line(tmp_path, read_table, lines, message):
    with refused(message, LogError):
        read_table(quoted("run,tool,s,worth,stop", "{0},a,{0},1,x", *lines), MAPPING)
    names = "episode_id,is_first,is_last,is_terminal,observation,action,reward,note"
    (tmp_path / "steps.csv").write_text(quoted(names, "{0},true,false,false,1.5,a,1,x", *lines))
    with refused(message, LogError):
        read_steps(tmp_path / "steps.csv", StepRules(step_s=1.0))


def test_a_stray_quote_in_logs_as_csv_is_reported(tmp_path):
    stages = ("trajectory,stage,elapsed_s,action,reward,note", "{},1,1.0,a,1,x")
    trajectories = ("trajectory,end_s,ending,note", "{},1.0,finished,x")

    def read(in_stages=(), in_trajectories=()):
        (tmp_path / "stages.csv").write_text(quoted(*stages, *in_stages))
        (tmp_path / "trajectories.csv").write_text(quoted(*trajectories, *in_trajectories))
        return read_csv(tmp_path)

    assert len(read().stages) == ROWS
    for lines in [((6,), ()), ((), (6,))]:
        with refused(NEVER_CLOSED, LogError):
            read(*lines)
    # Our own writer may have written such a cell.
    with pytest.warns(HalfseenWarning, match=LIKE_ROWS):
        assert len(read((6, 20), (6, 20)).stages) == ROWS - 14


@pytest.mark.parametrize("note", [r'"a \"b\" c"', r'"\"b\""', '"x\n\\"y"'])
def test_quotes_escaped_by_a_backslash_are_refused(tmp_path, read_table, note):
    with refused("line 2: a quote within a cell is escaped by a backslash; export it doubled", LogError):
        read_table(f"run,tool,s,worth,stop\n1,{note},1,1,\n", MAPPING)
    (tmp_path / "steps.csv").write_text(f"is_last,action,is_terminal\nfalse,{note},false\n")
    with refused("line 2: a quote within a cell is escaped by a backslash", LogError):
        read_steps(tmp_path / "steps.csv")
    found = read_table('run,tool,s,worth,stop\n1,"C:\\bin\\",1,1,\n2,"a \\""b",1,1,\n', MAPPING)
    assert found.stages["action"].tolist() == ["C:\\bin\\", 'a \\"b']


def test_cells_of_several_lines_and_quotes_within_cells_are_read(read_table):
    text = 'run,tool,s,worth,stop\n1, "a, ""b""\n\nc",1,1,\n2,5" d,1,1,\n3,"x"y,1,1,"\n"\n'
    found = read_table(text, MAPPING).stages
    assert found["action"].tolist() == ['a, "b"\n\nc', '5" d', "xy"]


MARKED = "\ufeff3,x,1,1,\n"


@pytest.mark.parametrize(
    ("below", "message"),
    [("{0}3,x,1,1,\n", "line 4: the heading stands here"), (MARKED, "line 4: a byte order mark is here")],
)
def test_a_file_below_another_is_refused_in_each_table(tmp_path, read_table, below, message):
    heading = "run,tool,s,worth,stop\n"
    with refused(message, LogError):
        read_table(heading + "1,x,1,1,\n2,x,1,1,\n" + below.format(heading), MAPPING)
    heading = "episode_id,is_last,is_terminal,observation,action,reward\n"
    (tmp_path / "s.csv").write_text(heading + "a,false,false,1,x,1\na,true,true,1,,\n" + below.format(heading))
    with refused(message, LogError):
        read_steps(tmp_path / "s.csv", StepRules(step_s=1.0))
    heading = "trajectory,end_s,ending\n"
    (tmp_path / "stages.csv").write_text("trajectory,stage,elapsed_s,action,reward\n1,1,1,x,1\n2,1,1,x,1\n")
    (tmp_path / "trajectories.csv").write_text(heading + "1,1,finished\n2,1,finished\n" + below.format(heading))
    with refused(message, LogError):
        read_csv(tmp_path)
