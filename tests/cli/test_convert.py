import gzip
import json
import os
import sqlite3
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
import shell

from bags import SMALL, WITHOUT_CLOUD, cloud, one_trajectory, tables_of, text, two_trajectories, write_bag
from event_files import GERMAN, HISTORIAN, PLC, write_events
from foreign import arrays, episodes, rows_of, write_arrays, write_lerobot, write_rows
from halfseen.errors import HalfseenWarning, LogError, noted, warn
from halfseen.logs import Logs, read_logs
from halfseen.logs.formats import read_csv
from halfseen.perception import read_cloud
from halfseen.scene import table_paths
from refusals import refused
from small_logs import log_of


@pytest.fixture
def logs():
    stages = {"trajectory": [1, 1, 2], "stage": [1, 2, 1], "elapsed_s": [2.0, 5.0, None], "action": ["A", "B", None]}
    ends = {"end_s": [5.0, 3.0], "cause": [None, "battery"]}
    return log_of(ends, **stages, reward=[-0.1, 5.0, None], x=[0.1, 0.2, 0.3])


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    return tmp_path


run = partial(shell.run, "convert")


def refusal(*arguments):
    before = sorted(str(file) for file in Path().rglob("*"))
    with refused() as error:
        run(*arguments)
    assert sorted(str(file) for file in Path().rglob("*")) == before
    return str(error.value)


def same(left, right):
    return left.stages.equals(right.stages) and left.trajectories.equals(right.trajectories)


def test_round_the_forms_and_back(logs):
    logs.write("a")
    assert run("a", "--out", "csv:b").output == f"csv:b: {logs.summary()}\n"
    assert run("b", "--out", "minari:cell/c-v0").exit_code == 0
    assert run("minari:cell/c-v0", "--out", "d").exit_code == 0
    assert run(Path("minari") / "cell" / "c-v0", "--out", "csv:e").exit_code == 0
    assert same(read_logs("d"), logs)
    assert same(read_csv("e"), logs)


@pytest.mark.slow
@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_bag_by_its_folder_its_file_or_a_folder_of_bags(storage):
    Path("cell.toml").write_text(WITHOUT_CLOUD.replace('field = "data"', "", 1))
    write_bag(Path("bags") / "monday", two_trajectories(), storage)
    write_bag(Path("bags") / "tuesday", two_trajectories(), storage)
    (file,) = (file for file in Path("bags/monday").iterdir() if file.suffix != ".yaml")
    for source, num_trajectories in (("bags/monday", 2), (file, 2), ("bags", 4)):
        out = f"logs-{num_trajectories}-{Path(source).suffix}"
        assert run(source, "--mapping", "cell.toml", "--out", out).exit_code == 0
        assert read_logs(out).num_trajectories == num_trajectories
    (Path("bags/monday") / "metadata.yaml").unlink()
    assert run("bags/monday", "--mapping", "cell.toml", "--out", "torn").exit_code == 0


def seen_trajectory():
    cloud_file = read_cloud(table_paths()[0])
    look = cloud(0.1, "/points", cloud_file.points_m, cloud_file.shape)
    Path("cell.toml").write_text(tables_of(SMALL | {"trajectory": "/begin data"}) + '[cloud]\ntopic = "/points"\n')
    write_bag(Path("bag"), [text(0.0, "/begin", "p"), look, *one_trajectory(ending="operator")], "mcap")
    return cloud_file


def test_clouds_become_files_and_objects():
    cloud_file = seen_trajectory()
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


def test_what_fits_not_together_is_refused(logs):
    logs.write("a")
    seen_trajectory()
    Path("file").write_text("")
    Path("empty").mkdir()
    of_bag = ("bag", "--mapping", "cell.toml", "--out")
    for result, words in (
        ("nowhere: no such file or folder", ("nowhere", "--out", "b")),
        ("a: it already exists", ("a", "--out", "a")),
        ("a: it already exists", ("a", "--out", "csv:a")),
        ("a: it already exists", ("a", "--out", "a", "--check")),
        ("--check is for one SOURCE", ("a", "a", "--out", "b", "--check")),
        ("bag needs --mapping FILE", ("bag", "--out", "b")),
        ("--see is for a source of kind bag; this is parquet", ("a", "--out", "b", "--see")),
        ("--step-s is for a source of kind minari", ("a", "--out", "b", "--step-s", "0")),
        ("none.toml: it cannot be read", ("bag", "--mapping", "none.toml", "--out", "b")),
        ("empty", ("empty", "--out", "b")),
        *(("it is not a dataset name", ("a", "--out", f"minari:{name}")) for name in ("x", "x-v0/../../y", "", "a b")),
        # No clouds are left where the logs cannot be written, and neither takes a place of the other.
        ("cannot be written", (*of_bag, "file/logs", "--clouds", "clouds")),
        *(
            ("it is --out, or one contains the other", (*of_bag, out, "--clouds", clouds))
            for out, clouds in (("x", "x"), ("csv:x", "./x"), ("x/logs", "x"), ("x", "x/clouds"))
        ),
    ):
        assert result in refusal(*words)


@pytest.fixture
def sources(logs):
    """The same two episodes as LeRobot, as a step table and as HDF5, and a log in a database."""
    found = episodes(lengths=(2, 3))
    write_lerobot(Path("lerobot"), found, extra={"next.done": [False, True, False, False, False]})
    rows = [
        {name: value for name, value in row.items() if name != "episode_id"} for row in rows_of(found, [True, False])
    ]
    Path("tables").mkdir()
    write_rows(Path("tables") / "0", rows[:3])
    write_rows(Path("tables") / "1", rows[3:])
    write_arrays("steps.hdf5", arrays(found, [0], [1], has_next=False))
    with sqlite3.connect("cell.db") as connection:
        for name, table in logs.tables.items():
            table.to_sql(name, connection, index=False)
    connection.close()
    return found


STARS = ("--stages", "SELECT * FROM stages", "--trajectories", "SELECT * FROM trajectories")
KINDS = {
    "lerobot": ("lerobot", ["--step-s", "0.5"]),
    "tables": ("steps", ["--step-s", "0.5"]),
    "tables/0.parquet": ("steps", ["--step-s", "0.5"]),
    "steps.hdf5": ("hdf5", ["--step-s", "0.5"]),
    "sql:sqlite:///cell.db": ("sql", STARS),
}


@pytest.mark.parametrize("source", KINDS)
def test_each_source_is_known_by_what_stands_there(sources, logs, source):
    kind, chosen = KINDS[source]
    report = shell.report("convert", source, "--out", "out", *chosen)
    assert (report["format"], report["losses"], report["warnings"]) == (kind, [], [])
    back = read_logs("out")
    if kind == "sql":
        assert same(back, logs)
    else:
        assert back.stages["reward"].tolist()[:2] == sources[0]["rewards"]
        assert back.end_s.tolist()[0] == 1.0


def test_others_steps_take_the_same_options(sources):
    for source in ("lerobot", "tables", "steps.hdf5"):
        run(source, "--out", f"{source}.out", "--step-s", "1", "--truncated", "finished")
        assert read_logs(f"{source}.out").is_finished.tolist() == [True, True]
    assert "--done is for a source of kind lerobot, steps or hdf5; this is sql" in refusal(
        "sql:sqlite:///cell.db", "--out", "x", "--done", "d"
    )
    assert "--stages is for a source of kind sql; this is lerobot" in refusal(
        "lerobot", "--out", "x", "--stages", "SELECT 1"
    )
    assert "step_s 0.0: a step lasts" in refusal("lerobot", "--out", "x", "--step-s", "0")


def test_warnings_of_readers_stand_in_the_answer_too(sources):
    done = run("tables", "--out", "out", "--json")
    (warning,) = json.loads(done.stdout)["warnings"]
    assert "every step counts as 1 s" in warning
    assert warning in done.stderr


def test_what_was_warned_of_before_a_refusal_is_reported():
    @noted()
    def read():
        warn("a.csv", "read as text")
        raise LogError("a.csv: refused")

    with pytest.warns(HalfseenWarning, match=r"a\.csv: read as text"), pytest.raises(LogError):
        read()


def test_a_database_takes_its_queries_from_options_or_a_file(sources, logs):
    Path("cell.toml").write_text('stages = "SELECT * FROM stages"\ntrajectories = "SELECT * FROM trajectories"\n')
    run("sql:sqlite:///cell.db", "--mapping", "cell.toml", "--out", "out")
    assert same(read_logs("out"), logs)
    assert "a database needs --stages and --trajectories" in refusal(
        "sql:sqlite:///cell.db", "--out", "x", "--stages", "SELECT 1"
    )
    both = refusal("sql:sqlite:///cell.db", "--out", "x", "--mapping", "cell.toml", "--trajectories", "SELECT 1")
    assert "it replaces --stages, --trajectories and --objects; leave these out" in both


def test_a_table_of_events_is_read_by_a_mapping_in_one_command(place):
    write_events(place)
    for name in ("events.csv", "events.parquet"):
        report = shell.report("convert", name, "--mapping", "events.toml", "--out", f"{name}.out")
        assert (report["format"], report["num_finished"], report["losses"]) == ("events", 1, [])
        assert report["causes"] == {"emergency stop": 1, "log ended": 1}
    assert same(read_logs("events.csv.out"), read_logs("events.parquet.out"))


def test_a_folder_of_tables_is_one_table(place):
    write_events(place)
    heading, *rows = GERMAN.splitlines(keepends=True)
    Path("days").mkdir()
    for name, some in (("monday", rows[:9]), ("tuesday", rows[9:])):  # trajectory 8 goes on in the next file
        Path(f"days/{name}.csv").write_text(heading + "".join(some), encoding="utf-8")
    Path("days/~$book.xlsx").write_bytes(b"lock of a workbook that is open")
    run("days", "--mapping", "events.toml", "--out", "logs")
    run("events.csv", "--mapping", "events.toml", "--out", "all")
    assert same(read_logs("logs"), read_logs("all"))
    assert 'field = "Lauf"' in run("days", "--mapping-template").output
    Path("days/tuesday.csv").write_text((heading + "".join(rows[9:])).replace("1,5", "much"), encoding="utf-8")
    assert "days, file tuesday.csv, line 3, column 'Wert': 'much' is not a number" in refusal(
        "days", "--mapping", "events.toml", "--out", "x"
    )
    Path("days/._monday.csv").write_bytes(b"\0")  # as a Mac leaves beside each file on foreign disks
    Path("days/tuesday.csv").write_text("a;b\n1;2\n")
    assert "tuesday.csv: its columns differ from those of days/monday.csv ('Ereignis', " in refusal(
        "days", "--mapping", "events.toml", "--out", "x"
    )


def test_folders_named_after_a_value_are_parts_of_one_table(place):
    write_events(place)
    pd.read_parquet("events.parquet").to_parquet("parts", partition_cols=["Lauf"])
    assert "halfseen convert parts --mapping-template" in refusal("parts", "--out", "x")
    draft = run("parts", "--mapping-template").output
    assert 'field = "Lauf"' in draft
    assert "for: halfseen convert parts --mapping THIS" in draft
    for source in ("parts", "events.parquet"):
        run(source, "--mapping", "events.toml", "--out", f"{source}.out")
    assert same(read_logs("parts.out"), read_logs("events.parquet.out"))
    Path("events.toml").write_text(Path("events.toml").read_text() + "\n[covariates.none]\nfield = 'none'\n")
    assert "there is no column 'none' in parts; " in refusal("parts", "--mapping", "events.toml", "--out", "x")
    steps = pd.DataFrame(rows_of(episodes(), [True, False, True]))
    steps.to_parquet("steps.parquet")
    steps.to_parquet("runs", partition_cols=["episode_id"])
    for source in ("runs", "steps.parquet"):
        run(source, "--step-s", "1", "--out", f"{source}.out")
    assert same(read_logs("runs.out"), read_logs("steps.parquet.out"))


def test_rows_of_a_database_are_events_too(place):
    write_events(place)
    frame = pd.read_csv("events.csv", sep=";", encoding="cp1252")
    with sqlite3.connect("cell.db") as connection:
        frame.assign(Wert=frame["Wert"].str.replace(",", ".").astype(float)).to_sql("seen", connection, index=False)
    connection.close()
    Path("cell.toml").write_text(HISTORIAN + 'table = {query = "SELECT * FROM seen WHERE Lauf < 9"}', encoding="utf-8")
    run("sql:sqlite:///cell.db", "--mapping", "cell.toml", "--out", "out")
    run("events.csv", "--mapping", "events.toml", "--out", "all")
    assert same(read_logs("out"), read_logs("all").select([7, 8]))
    Path("order.toml").write_text(
        'clock = {field = "Wert", unit = "s", since = "stage"}\naction = {field = "Text"}\nreward = {field = "Wert"}\n'
        'ending = {finished = "rewarded"}\ntable.query = "SELECT * FROM seen"\n'
    )
    message = "table.query: since = 'stage' takes the order of rows, which a database does not keep; add ORDER BY"
    assert message in refusal("sql:sqlite:///cell.db", "--mapping", "order.toml", "--out", "x")
    filled = Path("order.toml").read_text().replace('since = "stage"', 'since = "trajectory"')
    Path("order.toml").write_text(filled.replace('"rewarded"', '[""], field = "Text"') + 'table.fill_down = ["Lauf"]\n')
    message = "table.query: fill_down takes the order of rows"
    assert message in refusal("sql:sqlite:///cell.db", "--mapping", "order.toml", "--out", "x")
    assert "table.query: it is missing" in refusal("sql:sqlite:///cell.db", "--mapping", "events.toml", "--out", "x")
    assert "put the SELECT into it as table.query" in refusal("sql:sqlite:///cell.db", "--mapping-template")
    for words in (("--out", "x"), ("--out", "x", "--mapping", "cell.toml"), ("--mapping-template",)):
        assert "halfseen convert sql:sqlite:///cell.db --mapping cell.toml" in refusal("cell.db", *words)


def test_a_mapping_is_made_from_a_table_printed_or_written(place, typed):
    (place / "plc.csv").write_text(PLC)
    printed = typed("convert", "plc.csv", "--mapping-template")
    assert printed.status == 0
    assert run("plc.csv", "--mapping-template", "--out", "cell.toml").exit_code == 0
    assert Path("cell.toml").read_text() == printed.out
    assert "cell.toml: it already exists" in refusal("plc.csv", "--mapping-template", "--out", "cell.toml")
    assert "--out is csv:x, but a mapping is one file" in refusal("plc.csv", "--mapping-template", "--out", "csv:x")
    assert run("--mapping-template").output.startswith("# Which topic of a bag carries what")
    for words, message in (((), "Missing argument 'SOURCE...'"), (("plc.csv",), "Missing option '--out'")):
        assert message in typed("convert", *words).err


def test_parts_of_a_table_are_read_in_the_order_of_their_numbers(place):
    """DuckDB and pandas write data_10 beside data_2, which comes first."""
    Path("parts").mkdir()
    for number in (1, 2, 10):
        rows = {"is_first": [True, False], "is_last": [False, True], "action": ["A", None], "reward": [number, 0.0]}
        pd.DataFrame(rows | {"observation": 0.5, "is_terminal": rows["is_last"]}).to_parquet(
            f"parts/data_{number}.parquet"
        )
    run("parts", "--step-s", "1", "--out", "out")
    assert read_logs("out").stages["reward"].tolist() == [1.0, 2.0, 10.0]


def test_several_tables_are_read_from_a_folder(place):
    message = refusal("monday.csv", "tuesday.csv", "--mapping", "cell.toml", "--out", "x")
    assert (
        "--mapping is for one SOURCE, and 2 are given; put tables with the same columns, or bags, into one" in message
    )


def test_a_folder_of_tables_is_reported_how_to_be_read(place, typed):
    for name in ("a.txt", "b.txt"):
        (place / "texts").mkdir(exist_ok=True)
        (place / "texts" / name).write_text(GERMAN.replace(";7;", f";{name};"), encoding="utf-8")
    (place / "cell.toml").write_text(HISTORIAN, encoding="utf-8")
    assert "texts holds no logs; make a mapping of its tables: halfseen convert texts" in typed("inspect", "texts").err
    (place / "above").mkdir()
    (place / "texts").rename(place / "above" / "texts")
    assert "above: it holds no tables or bags itself; give a folder of" in refusal(
        "above", "--mapping", "cell.toml", "--out", "x"
    )
    assert "give a folder that Logs.write wrote" in typed("inspect", "above").err


def test_who_has_a_table_and_no_mapping_hears_of_the_command_that_makes_one(place, typed):
    for name, quoted in (("events.csv", "events.csv"), ("my events.csv", "'my events.csv'")):
        (place / name).write_text(GERMAN, encoding="cp1252")
        for words in (("inspect", name), ("convert", name, "--out", "logs")):
            status, out, err = typed(*words)
            assert (status, out, err.count("\n")) == (2, "", 1)
            assert f"halfseen convert {quoted} --mapping-template --out cell.toml" in err
    (place / "book.xls").write_bytes(b"PK")
    assert "book.xls: such workbooks are not read; save it as .xlsx" in refusal("book.xls", "--out", "logs")
    assert "`halfseen convert --help` lists the files that are read" in typed("inspect", "book.xls").err
    assert "halfseen convert book.xlsx --mapping-template" in (
        (place / "book.xls").rename(place / "book.xlsx") and typed("inspect", "book.xlsx").err
    )
    (place / "events.zip").write_bytes(b"PK")
    assert "unpack it, and read its contents" in refusal("events.zip", "--out", "logs")
    (place / "events.csv.GZ").write_bytes(gzip.compress(GERMAN.encode("cp1252")))
    assert "halfseen convert events.csv.GZ --mapping-template" in refusal("events.csv.GZ", "--out", "logs")
    (place / "MORE.CSV").write_text(GERMAN, encoding="cp1252")
    assert "halfseen convert MORE.CSV --mapping-template --out cell.toml" in typed("inspect", "MORE.CSV").err
    broken = GERMAN.replace("1,25", "viel")
    (place / "events.csv").write_text(broken, encoding="cp1252")
    (place / "cell.toml").write_text(HISTORIAN, encoding="utf-8")
    assert "events.csv, line 4, column 'Wert': 'viel' is not a number" in refusal(
        "events.csv", "--mapping", "cell.toml", "--out", "logs"
    )


def test_a_password_is_never_printed(sources, typed):
    select = ("--stages", "SELECT 1", "--trajectories", "SELECT 1", "--out", "x")
    for kind in ("postgresql+psycopg2://", "mysql+pymysql://", "no://", ""):
        url = f"{kind}me:hidden@127.0.0.1:1/d"
        status, out, err = typed("convert", f"sql:{url}", *select)
        assert status == 2
        assert "hidden" not in out + err
        assert err.count("\n") == 1
    report = json.loads(typed("convert", "sql:sqlite:///cell.db?password=hidden", "--out", "x", "--json", *STARS).out)
    assert report["source"] == "sql:sqlite:///cell.db?password=***"


def test_check_says_what_is_lost_and_writes_nothing(typed):
    log_of({"raw": b"a"}, pose=[{"x": 1.0}]).write("a")
    status, out, err = typed("convert", "a", "--out", "csv:b", "--check")
    _, second, *rest = out.splitlines()
    assert (status, err, second) == (1, "", "What would be lost:")
    assert [line[:33] for line in rest] == ["- stages: column 'pose' holds str", "- trajectories: column 'raw' hold"]
    report = json.loads(typed("convert", "a", "--out", "minari:b-v0", "--check", "--json").out)
    assert [(loss["table"], loss["column"], loss["is_refused"]) for loss in report["losses"]] == [
        ("stages", "pose", True),
        ("trajectories", "raw", True),
    ]
    assert typed("convert", "a", "--out", "b", "--check").out.splitlines()[1] == "Nothing would be lost."
    assert os.listdir() == ["a"]
    refusal = typed("convert", "a", "--out", "csv:b")
    assert refusal.status == 2
    assert "stages: column 'pose' holds" in refusal.err
    assert "trajectories: column 'raw' holds" in refusal.err
    assert os.listdir() == ["a"]


def test_what_is_lost_or_kept_for_halfseen_alone_is_reported_of_what_is_written(logs):
    tables = logs.tables
    serial = pd.array([1, 2], dtype=pd.ArrowDtype(pa.int32()))
    Logs(tables["stages"].assign(lamp="on"), tables["trajectories"].assign(serial=serial)).write("a")
    output = run("a", "--out", "csv:b").output.splitlines()[1:]
    assert output == [
        "What is lost:",
        "- trajectories: column 'serial' is read back as pandas stores such values, not as int32[pyarrow]",
    ]
    checked = run("a", "--out", "minari:c-v0", "--check")
    assert checked.exit_code == 1
    last = "Kept as notes that only halfseen reads: stages.lamp, trajectories.cause, trajectories.serial."
    assert checked.output.splitlines()[-1] == last
    assert run("a", "--out", "minari:c-v0").output.splitlines()[-1] == last


def test_a_covariate_that_has_no_value_is_to_be_left_out():
    Path("stages.csv").write_text("run,tool,ms,worth,grip,force\na,x,1500,2.5,,1\na,y,2500,1,,\n")
    Path("cell.toml").write_text(
        'clock = {field = "ms", unit = "ms", since = "trajectory"}\ntrajectory = {field = "run"}\n'
        'action = {field = "tool"}\nreward = {field = "worth"}\nending = {finished = "rewarded"}\n'
        'covariates = {grip = {field = "grip"}, force = {field = "force"}}\n'
    )
    said = run("stages.csv", "--mapping", "cell.toml", "--out", "logs").stdout
    assert "Missing: grip in 2 of 2 stages (100 %); leave it out of the log." in said
    assert "Missing: force in 1 of 2 stages (50 %); fill it in with --missing when you learn." in said
