"""`halfseen watch`: bad input is told in one line; what is shown can be written to a file."""

import numpy as np
import pytest

from few_cups import draw_small_tables
from halfseen.logs import read_logs
from halfseen.perception import perceive, read_cloud
from halfseen.scene import table_paths
from halfseen.view.recording import read_recording

TABLE = table_paths()[7]


def test_a_cloud_with_a_policy_is_written_as_a_page_and_a_picture(typed, house, tmp_path):
    html, gif = tmp_path / "out.html", tmp_path / "out.gif"
    done = typed("watch", TABLE, "--policy", house / "table-policy", "--export", html, "--export", gif)
    assert (done.status, done.err) == (0, "")
    num_objects = len(perceive(read_cloud(TABLE)).objects)
    text = html.read_text(encoding="utf-8")
    assert "stage 1 of 3" in text
    assert all(f"LIFT {k}" in text for k in range(num_objects))
    assert gif.read_bytes()[:4] == b"GIF8"


@pytest.mark.slow
def test_a_running_cell_is_recorded_and_its_logs_are_the_same(typed, refused, tmp_path, monkeypatch):
    draw_small_tables(monkeypatch)
    words = ["cell", "run", "--policy", "history-penalty", "--tables", 2, "--seed", 6]
    assert typed(*words, "--out", tmp_path / "watched", "--record", tmp_path / "record").status == 0
    assert typed(*words, "--out", tmp_path / "alone", "--workers", 1).status == 0
    for name in ("stages", "trajectories", "objects"):
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
