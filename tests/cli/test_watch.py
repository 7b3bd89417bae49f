"""`halfseen watch`: bad input is told in one line; what is shown can be written to a file."""

import socket
import sys

import numpy as np
import pytest

from halfseen.learning import CensoredQLearner
from halfseen.logs import read_logs
from halfseen.perception import perceive, read_cloud
from halfseen.policies import write_policy
from halfseen.scene import table_paths
from halfseen.watch import read_recording
from small_logs import flat_log, table_log

TABLE = table_paths()[7]


@pytest.fixture(scope="module")
def policies(tmp_path_factory):
    folder = tmp_path_factory.mktemp("watch")
    tables, flat = table_log(), flat_log()
    write_policy(CensoredQLearner.for_table(3, reg=0.1).fit(tables), tables, folder / "tables")
    learner = CensoredQLearner.of_paper(2, {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"], reg=0.1)
    write_policy(learner.fit(flat), flat, folder / "flat")
    flat.write(folder / "logs")
    return folder


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["none.pcd"], "none.pcd: no such file or folder"),
        ([TABLE, "--export", "film.mp4"], "film.mp4: an exported run ends in .html or .gif"),
        ([TABLE, "--clouds", "somewhere"], "--clouds is of logs"),
        ([TABLE, "--history", "logs"], "give a --policy"),
        ([TABLE, "--policy", "nowhere"], "nowhere"),
        ([TABLE, "--stages", "3-2"], "no span of stages"),
        ([TABLE, "--stages", "1-2"], "--stages is 1-2, and there are 1"),
    ],
)
def test_bad_input(refused, tmp_path, monkeypatch, words, told):
    monkeypatch.chdir(tmp_path)
    export = [] if "--export" in words else ["--export", "out.html"]
    assert told in refused("watch", *words, *export)
    assert list(tmp_path.iterdir()) == []


def test_a_policy_of_other_things(refused, policies, tmp_path):
    line = refused("watch", TABLE, "--policy", policies / "flat", "--export", tmp_path / "out.html")
    assert "it is no policy of tables" in line


def test_logs_without_clouds(refused, policies, tmp_path):
    export = ["--export", tmp_path / "out.html"]
    assert "logs hold no clouds" in refused("watch", policies / "logs", *export)
    assert "no column 'cloud'" in refused("watch", policies / "logs", "--clouds", tmp_path, *export)
    assert "has" in refused("watch", policies / "logs", "--clouds", tmp_path, "--path", 10_000, *export)


def test_a_port_that_is_taken(typed):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        status, out, err = typed("watch", TABLE, "--port", port)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert f"--port is {port}" in err


def test_a_viewer_that_is_not_there(refused, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "[watch]" in refused("watch", TABLE)
    assert "[watch]" in refused("watch", TABLE, "--export", tmp_path / "out.html")
    assert list(tmp_path.iterdir()) == []


def test_a_cloud_with_a_policy_is_written_as_a_page_and_a_picture(typed, policies, tmp_path):
    html, gif = tmp_path / "out.html", tmp_path / "out.gif"
    done = typed("watch", TABLE, "--policy", policies / "tables", "--export", html, "--export", gif)
    assert (done.status, done.err) == (0, "")
    num_objects = len(perceive(read_cloud(TABLE)).objects)
    text = html.read_text(encoding="utf-8")
    assert "stage 1 of 3" in text
    assert all(f"LIFT {k}" in text for k in range(num_objects))
    assert gif.read_bytes()[:4] == b"GIF8"


@pytest.mark.slow
def test_a_running_cell_is_recorded_and_its_logs_are_the_same(typed, refused, tmp_path):
    words = ["cell", "run", "--policy", "history-penalty", "--tables", 2, "--seed", 6]
    assert typed(*words, "--out", tmp_path / "watched", "--record", tmp_path / "record").status == 0
    assert typed(*words, "--out", tmp_path / "alone", "--workers", 1).status == 0
    for name in ("stages", "paths", "objects"):
        one, other = (tmp_path / which / f"{name}.parquet" for which in ("watched", "alone"))
        assert one.read_bytes() == other.read_bytes()
    watched = read_recording(tmp_path / "record")
    titles = [stage.title for stage in watched.stages]
    assert titles[0] == "table 0, stage 1 of 10"
    assert any(title.startswith("table 1, ") for title in titles)
    for stage in watched.stages:
        assert (stage.hand is None) <= (len(stage.poses) >= 1)
        assert stage.reason.startswith(stage.action)
        assert stage.target is None or stage.target in [shown.number for shown in stage.objects]
    assert any(stage.hand is not None for stage in watched.stages)
    assert any(event.startswith("tried: a grasp of") for event in watched.stages[-1].events)
    assert "--overwrite" in refused(*words, "--out", tmp_path / "third", "--record", tmp_path / "record")


@pytest.mark.slow
def test_two_arms_are_recorded_and_both_are_shown(typed, tmp_path):
    words = ["cell", "run", "--policy", "history-penalty", "--arms", 2, "--tables", 2, "--seed", 7, "--no-stops"]
    done = typed(*words, "--out", tmp_path / "logs", "--record", tmp_path / "record")
    assert done.status == 0
    assert "0 collisions" in done.out
    watched = read_recording(tmp_path / "record")
    assert watched.stages[0].title == "table 0, stage 1 of 20"
    assert len({part.colour for part in watched.parts if part.is_robot}) == 2
    names = {stage.action.split(":")[0] for stage in watched.stages}
    assert names == {"left", "right"}
    for stage in watched.stages:
        assert stage.action in stage.reason
        assert stage.target is None or stage.target in [shown.number for shown in stage.objects]
    moved = np.concatenate([np.ptp(stage.poses[..., :3], axis=0).max(axis=1)[None] for stage in watched.stages])
    for colour in {part.colour for part in watched.parts if part.is_robot}:
        own = [index for index, part in enumerate(watched.parts) if part.is_robot and part.colour == colour]
        assert moved[:, own].max() > 0.3
    logs = read_logs(tmp_path / "logs")
    assert set(logs.stages["robot"]) == {0, 1}
