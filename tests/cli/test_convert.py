import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from halfseen.cli.convert import convert
from halfseen.errors import ArgumentError, HalfseenError, LogError
from halfseen.logs import Logs, read_logs
from halfseen.logs.formats import MAPPING_TEMPLATE, read_csv
from halfseen.perception import Cloud, read_cloud, write_pcd
from halfseen.scene import table_paths

sys.path.insert(0, str(Path(__file__).parents[1] / "logs" / "formats"))
from bags import cloud, number, text, two_paths, write_bag

WITHOUT_CLOUD = MAPPING_TEMPLATE[: MAPPING_TEMPLATE.index("# sensor_msgs/PointCloud2")]


@pytest.fixture
def logs():
    stages = {"path": [1, 1, 2], "stage": [1, 2, 1], "elapsed_s": [2.0, 5.0, None], "action": ["A", "B", None]}
    return Logs(
        stages={**stages, "reward": [-0.1, 5.0, None], "x": [0.1, 0.2, 0.3]},
        paths={"path": [1, 2], "end_s": [5.0, 3.0], "ending": ["finished", "cut"], "cause": [None, "battery"]},
    )


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    return tmp_path


def run(*arguments):
    return CliRunner().invoke(convert, [str(argument) for argument in arguments], catch_exceptions=False)


def refused(*arguments):
    before = sorted(str(file) for file in Path().rglob("*"))
    result = CliRunner().invoke(convert, [str(argument) for argument in arguments])
    assert isinstance(result.exception, HalfseenError), result.output
    assert result.output == ""
    assert sorted(str(file) for file in Path().rglob("*")) == before
    return str(result.exception)


def same(left, right):
    return left.stages.equals(right.stages) and left.paths.equals(right.paths)


def test_round_the_forms_and_back(logs):
    logs.write("a")
    assert run("a", "--out", "csv:b").output == f"csv:b: {logs.summary()}\n"
    assert run("b", "--out", "minari:cell/c-v0").exit_code == 0
    assert run("minari:cell/c-v0", "--out", "d").exit_code == 0
    assert run(Path("minari") / "cell" / "c-v0", "--out", "csv:e").exit_code == 0
    assert same(read_logs("d"), logs)
    assert same(read_csv("e"), logs)


def test_json_tells_what_was_read(logs):
    logs.write("a")
    report = json.loads(run("a", "--out", "csv:b", "--json").output)
    assert (report["format"], report["target"], report["num_cut"]) == ("parquet", "csv:b", 1)


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_bag_by_its_folder_its_file_or_a_folder_of_bags(storage):
    Path("cell.toml").write_text(WITHOUT_CLOUD.replace('field = "data"', "", 1))
    write_bag(Path("bags") / "monday", two_paths(), storage)
    write_bag(Path("bags") / "tuesday", two_paths(), storage)
    (file,) = (file for file in Path("bags/monday").iterdir() if file.suffix != ".yaml")
    for source, num_paths in (("bags/monday", 2), (file, 2), ("bags", 4)):
        out = f"logs-{num_paths}-{Path(source).suffix}"
        assert run(source, "--mapping", "cell.toml", "--out", out).exit_code == 0
        assert read_logs(out).num_paths == num_paths
    (Path("bags/monday") / "metadata.yaml").unlink()
    assert run("bags/monday", "--mapping", "cell.toml", "--out", "torn").exit_code == 0


def seen_path():
    cloud_file = read_cloud(table_paths()[0])
    messages = [
        text(0.0, "/begin", "p"),
        cloud(0.1, "/points", cloud_file.points_m, cloud_file.shape),
        text(1.0, "/action", "A"),
        number(2.0, "/reward", 1.0),
        text(3.0, "/end", "operator"),
    ]
    tables = {"path": "/begin", "action": "/action", "reward": "/reward", "ending": "/end"}
    mapping = "".join(f'[{key}]\ntopic = "{topic}"\nfield = "data"\n' for key, topic in tables.items())
    Path("cell.toml").write_text(mapping + '[cloud]\ntopic = "/points"\n')
    write_bag(Path("bag"), messages, "mcap")
    return cloud_file


def test_clouds_become_files_and_objects():
    cloud_file = seen_path()
    assert run("bag", "--mapping", "cell.toml", "--out", "logs", "--clouds", "clouds", "--see").exit_code == 0
    logs = read_logs("logs")
    assert logs.stages["cloud"].tolist() == ["bag-0.pcd", "bag-0.pcd"]
    back = read_cloud(Path("clouds") / "bag-0.pcd")
    assert back.shape == cloud_file.shape
    np.testing.assert_array_equal(back.points_m, cloud_file.points_m.astype(np.float32))
    assert logs.objects is not None
    first = logs.objects[logs.objects["stage"] == 1]
    assert len(first) >= 3
    assert first["occlusion"].between(0, 1).all()
    assert first["hidden_by"].map(len).eq(len(first)).all()


def test_no_clouds_are_left_where_the_logs_cannot_be_written():
    seen_path()
    Path("file").write_text("")
    message = refused("bag", "--mapping", "cell.toml", "--out", "file/logs", "--clouds", "clouds")
    assert "cannot be written" in message


def test_a_name_that_is_none_of_minari_is_refused(logs):
    logs.write("logs")
    for name in ("x", "x-v0/../../y", ""):
        assert "it is no name of a dataset" in refused("logs", "--out", f"minari:{name}")


@pytest.mark.parametrize(("out", "clouds"), [("x", "x"), ("csv:x", "./x"), ("x/logs", "x"), ("x", "x/clouds")])
def test_clouds_and_logs_take_no_place_of_one_another(out, clouds):
    seen_path()
    message = refused("bag", "--mapping", "cell.toml", "--out", out, "--clouds", clouds)
    assert "it is --out, or one lies in the other" in message
    assert not Path("x").exists()


def test_clouds_that_show_no_table_are_refused():
    seen_path()
    write_pcd(Cloud(np.zeros((4, 3)) + 1.0, name="dot"), "dot.pcd")
    write_bag(
        Path("dots"),
        [
            text(0.0, "/begin", "p"),
            cloud(0.1, "/points", read_cloud("dot.pcd").points_m, (1, 4)),
            text(1.0, "/action", "A"),
            number(2.0, "/reward", 1.0),
            text(3.0, "/end", "operator"),
        ],
        "mcap",
    )
    assert "dots-0" in refused("dots", "--mapping", "cell.toml", "--out", "logs", "--see")


def test_the_template_is_printed_without_a_source():
    result = run("--mapping-template")
    assert (result.exit_code, result.output) == (0, MAPPING_TEMPLATE)


def test_what_fits_not_together_is_refused(logs):
    logs.write("a")
    write_bag(Path("bag"), two_paths())
    assert "nowhere: there is no such file or folder" in refused("nowhere", "--out", "b")
    assert "a: it is there already" in refused("a", "--out", "a")
    assert "a: it is there already" in refused("a", "--out", "csv:a")
    assert "bag needs --mapping FILE" in refused("bag", "--out", "b")
    assert "--see is for a source of kind bag; this is parquet" in refused("a", "--out", "b", "--see")
    assert "--step-s is for a source of kind minari" in refused("a", "--out", "b", "--step-s", "0")
    assert "cell.toml: it cannot be read" in refused("bag", "--mapping", "cell.toml", "--out", "b")
    Path("empty").mkdir()
    assert "empty" in refused("empty", "--out", "b")
    with pytest.raises(LogError, match="nowhere"):
        run("nowhere", "--out", "b")
    with pytest.raises(ArgumentError, match="no name of a dataset"):
        run("a", "--out", "minari:no name")


def test_help_has_an_example():
    assert "Example: halfseen convert" in CliRunner().invoke(convert, ["--help"]).output


def test_bad_input_is_one_line_and_status_two(logs, typed, refused):
    logs.write("a")
    assert typed("convert", "a", "--out", "csv:b").out.startswith("csv:b: 2 paths")
    again = refused("convert", "a", "--out", "csv:b")
    assert again == "halfseen: b: it is there already; choose another folder, or move it away first\n"
    assert sorted(os.listdir()) == ["a", "b"]
