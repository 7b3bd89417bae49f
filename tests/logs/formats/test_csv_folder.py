import json

import numpy as np
import pytest

from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.logs.formats import read_csv, write_csv
from refusals import refused
from valid_logs import small_tables


@pytest.fixture
def folder(tmp_path):
    write_csv(Logs(**small_tables()), tmp_path / "logs")
    return tmp_path / "logs"


def test_by_hand_without_types_the_rules_decide(tmp_path):
    (tmp_path / "trajectories.csv").write_bytes(
        b"\xef\xbb\xbftrajectory,end_s,ending,cause,room\r\n007,4,finished,,1\r\n8,3.5,cut,battery,2\r\n"
    )
    (tmp_path / "stages.csv").write_text(
        "trajectory,stage,elapsed_s,action,reward,x,is_held,shares,note,empty\n"
        '007,1,1.5,1,0,1e-1,true,"[1, 2.5]",a,\n007,2,4,B,1,-2,false,[],"",\n8,1,,,,3,true,[3],,\n'
    )
    logs = read_csv(tmp_path)
    assert logs.trajectory_ids.tolist() == ["007", "8"]
    assert logs.trajectories["cause"].tolist() == [None, "battery"]
    assert logs.trajectories["room"].dtype == np.int64
    assert logs.stages[["action", "x", "note"]].values.tolist() == [["1", 0.1, "a"], ["B", -2.0, ""], [None, 3.0, None]]
    assert logs.stages["is_held"].dtype == bool
    assert [shares.tolist() for shares in logs.stages["shares"]] == [[1.0, 2.5], [], [3.0]]
    assert logs.stages["empty"].isna().all()


def test_types_may_name_only_some_columns(folder):
    types = json.loads((folder / "columns.json").read_text())
    types["tables"] = {name: {"trajectory": "string"} for name in ("stages", "trajectories", "objects")}
    (folder / "columns.json").write_text(json.dumps(types))
    logs = read_csv(folder)
    assert logs.trajectory_ids.tolist() == ["1", "2", "3"]
    assert logs.objects["hidden_by"][0].tolist() == [0.0, 0.0]


NO_TABLE = "it is not a CSV file of one table"
WRONG = [
    ("stages.csv", "1,1,1.5", "1,1,soon", r", row 2, column 'elapsed_s': 'soon' is not of type double"),
    ("stages.csv", "2,1,2,", "2,one,2,", r", row 4, column 'stage': 'one' is not of type int64"),
    ("stages.csv", "-0.1,0.5,10", "-0.1,0.5", rf": {NO_TABLE} .*Row #2: Expected 8 columns, got 7"),
    ("stages.csv", "-5,1,9", "-5,1,NA", r", row 3, column 'steps_to_go': 'NA' is not (of type int64|a number)"),
    ("stages.csv", '"stage"', '"sta\nge"', r": the column 'sta\\nge' has a name of two lines"),
    ("stages.csv", '"stage"', '"trajectory"', r": there are two columns 'trajectory'"),
    ("stages.csv", '"stage"', '"stag"', r"there is no column 'stage' among .* rename 'stag'\?"),
    ("stages.csv", "1,1,1.5", "9,1,1.5", r"trajectories does not list this trajectory"),
    ("stages.csv", "1,1,1.5", "1,1,-1.5", r"trajectory 1, stage 1: elapsed_s -1.5"),
    ("trajectories.csv", ",", ";", r": its cells are separated by ';'; export it with commas"),
    ("trajectories.csv", "battery", b"b\xe4ttery", r": it is not a CSV file.*(utf-8|UTF8)"),
    *((name, None, b"", f": {NO_TABLE}") for name in ("stages.csv", "trajectories.csv")),
    *((name, None, None, ": it is missing") for name in ("stages.csv", "trajectories.csv")),
]
"""File, what stands in it, what is put there, and what is reported."""
TYPES = [
    ("{", "it is not of format .*Expecting property name"),
    ("[]", "it is not of format"),
    ('{"format": "halfseen-csv", "version": 1}', "it is not of format 'halfseen-csv', version 2"),
    *(
        (f'{{"format": "halfseen-csv", "version": 2, "tables": {tables}}}', message)
        for tables, message in (
            ("[]", r"it is not of format .*`\$\.tables`"),
            ('{"trajectories": {"end_s": "metres"}}', "'metres' is unknown"),
            ('{"trajectories": {"end_s": 3}}', "tables.trajectories.end_s is 3, which is not a type"),
            ('{"trajectories": {"end_s": {"type": 1}}}', "which is not a type"),
        )
    ),
]


def check_wrong(folder, name, old, new, message):
    file = folder / name
    content = file.read_bytes()
    new = new.encode() if isinstance(new, str) else new
    if new is None:
        file.unlink()
    else:
        assert old is None or old.encode() in content
        file.write_bytes(new if old is None else content.replace(old.encode(), new, -1 if old == "," else 1))
    with refused((name if message.startswith((":", ",")) else "") + message, LogError):
        read_csv(folder)
    file.write_bytes(content)


@pytest.mark.parametrize("has_types", [True, False])
def test_what_is_wrong_is_reported_with_file_row_and_column(folder, has_types):
    if not has_types:
        (folder / "columns.json").unlink()
    for case in WRONG:
        check_wrong(folder, *case)
    if has_types:
        message = r", row 2, column 'hidden_by': '\[0\.0, 0\.0' is not of type list<double>"
        check_wrong(folder, "objects.csv", '"[0.0, 0.0]"', '"[0.0, 0.0"', message)
        for types, message in TYPES:
            check_wrong(folder, "columns.json", None, types, message)


def test_text_among_numbers_is_refused_without_a_type(folder):
    (folder / "columns.json").unlink()
    file = folder / "stages.csv"
    heading, *rows = file.read_text().splitlines()

    def read(*cells):
        given = [*cells, *["7"] * len(rows)]
        file.write_text("\n".join([f"{heading},x", *(f"{row},{given[k]}" for k, row in enumerate(rows))]))
        return read_csv(folder).stages["x"]

    message = (
        r"stages\.csv, row 2, column 'x': 'nan' is not a number, though most cells of the column are; fix the cell"
    )
    with refused(message, LogError):
        read("nan", "0.5", "0.5")
    assert read("7", "0.5").tolist()[:2] == [7.0, 0.5]
    assert read(*["tin", "can"] * len(rows)).tolist()[:2] == ["tin", "can"]


def test_a_column_without_a_name_is_refused(folder):
    file = folder / "stages.csv"
    file.write_text("\n".join(f"{'' if k == 0 else k},{row}" for k, row in enumerate(file.read_text().splitlines())))
    with refused(r"stages\.csv: column 1 has no name; name it, or leave it out if it only numbers the rows", LogError):
        read_csv(folder)
