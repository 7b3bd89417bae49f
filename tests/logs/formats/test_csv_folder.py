import json

import numpy as np
import pytest

from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.logs.formats import read_csv, write_csv
from valid_logs import small_tables


@pytest.fixture
def folder(tmp_path):
    write_csv(Logs(**small_tables()), tmp_path / "logs")
    return tmp_path / "logs"


def test_by_hand_without_types_the_rules_decide(tmp_path):
    (tmp_path / "paths.csv").write_bytes(
        b"\xef\xbb\xbfpath,end_s,ending,cause,room\r\n007,4,finished,,1\r\n8,3.5,cut,battery,2\r\n"
    )
    (tmp_path / "stages.csv").write_text(
        "path,stage,elapsed_s,action,reward,x,is_held,shares,note,empty\n"
        '007,1,1.5,1,0,1e-1,true,"[1, 2.5]",a,\n007,2,4,B,1,-2,false,[],"",\n8,1,,,,3,true,[3],,\n'
    )
    logs = read_csv(tmp_path)
    assert logs.path_ids.tolist() == ["007", "8"]
    assert logs.paths["cause"].tolist() == [None, "battery"]
    assert logs.paths["room"].dtype == np.int64
    assert logs.stages["action"].tolist() == ["1", "B", None]
    assert logs.stages["x"].tolist() == [0.1, -2.0, 3.0]
    assert logs.stages["is_held"].dtype == bool
    assert [shares.tolist() for shares in logs.stages["shares"]] == [[1.0, 2.5], [], [3.0]]
    assert logs.stages["note"].tolist() == ["a", "", None]
    assert logs.stages["empty"].isna().all()


def test_types_may_name_only_some_columns(folder):
    types = json.loads((folder / "columns.json").read_text())
    types["tables"] = {"stages": {"path": "string"}, "paths": {"path": "string"}, "objects": {"path": "string"}}
    (folder / "columns.json").write_text(json.dumps(types))
    logs = read_csv(folder)
    assert logs.path_ids.tolist() == ["1", "2", "3"]
    assert logs.objects["hidden_by"][0].tolist() == [0.0, 0.0]


TYPES = '{"format": "halfseen-csv", "version": 1, "tables": %s}'
NO_TABLE = "it is no CSV file of one table"


def refused(folder, message):
    with pytest.raises(LogError, match=message) as told:
        read_csv(folder)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("has_types", [True, False])
@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("stages", "1,1,1.5", "1,1,soon", r"stages\.csv, row 2, column 'elapsed_s': 'soon' is no double"),
        ("stages", "2,1,2,", "2,one,2,", r"stages\.csv, row 4, column 'stage': 'one' is no int64"),
        ("stages", "-0.1,0.5,10", "-0.1,0.5", rf"stages\.csv: {NO_TABLE} .*Row #2: Expected 8 columns, got 7"),
        ("stages", "-5,1,9", "-5,1,NA", r"stages\.csv, row 3, column 'steps_to_go': 'NA' is no (int64|number)"),
        ("stages", '"stage"', '"sta\nge"', r"stages\.csv: the column 'sta\\nge' has a name of two lines"),
        ("stages", '"stage"', '"path"', r"stages\.csv: there are two columns 'path'"),
        ("stages", '"stage"', '"stag"', r"there is no column 'stage' among .* rename 'stag'\?"),
        ("stages", "1,1,1.5", "9,1,1.5", r"paths has no such path"),
        ("stages", "1,1,1.5", "1,1,-1.5", r"path 1, stage 1: elapsed_s -1.5"),
        ("paths", ",", ";", r"paths\.csv: its cells are separated by ';'; export it with commas"),
        ("paths", "battery", b"b\xe4ttery", r"paths\.csv: it is no CSV file.*(utf-8|UTF8)"),
        *((name, None, b"", rf"{name}\.csv: {NO_TABLE}") for name in ("stages", "paths")),
        *((name, None, None, rf"{name}\.csv: it is missing") for name in ("stages", "paths")),
    ],
)
def test_a_wrong_cell_or_file_is_told_with_file_row_and_column(folder, name, old, new, message, has_types):
    if not has_types:
        (folder / "columns.json").unlink()
    file = folder / f"{name}.csv"
    content = file.read_bytes()
    if new is None:
        file.unlink()
    elif old is None:
        file.write_bytes(new)
    else:
        assert old.encode() in content
        new = new if isinstance(new, bytes) else new.encode()
        file.write_bytes(content.replace(old.encode(), new, -1 if old == "," else 1))
    refused(folder, message)


def test_a_broken_list_is_told(folder):
    file = folder / "objects.csv"
    file.write_text(file.read_text().replace('"[0.0, 0.0]"', '"[0.0, 0.0"', 1))
    refused(folder, r"objects\.csv, row 2, column 'hidden_by': '\[0\.0, 0\.0' is no list<double>")


@pytest.mark.parametrize(
    ("types", "message"),
    [
        ("{", "it cannot be read"),
        ("[]", "it is not of format"),
        ('{"format": "halfseen-csv", "version": 2}', "it is not of format 'halfseen-csv', version 1"),
        (TYPES % "[]", "tables does not name"),
        (TYPES % '{"paths": {"end_s": "metres"}}', "'metres' is unknown"),
        (TYPES % '{"paths": {"end_s": 3}}', "tables.paths.end_s is 3, which is no type"),
        (TYPES % '{"paths": {"end_s": {"type": 1}}}', "which is no type"),
    ],
)
def test_wrong_types_are_told(folder, types, message):
    (folder / "columns.json").write_text(types)
    refused(folder, message)
