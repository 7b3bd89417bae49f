"""``halfseen look`` and ``halfseen watch``: what a camera sees, what looks dirty, and what is shown of it."""

import json
import os
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import shell

from drawn_tables import TWO_CARDS, Can, K, depth_of_cards, draw
from few_cups import draw_small_tables
from halfseen.logs import read_logs
from halfseen.perception import Cloud, StainCounter, perceive, read_cloud, write_pcd
from halfseen.scene import table_paths
from halfseen.tables.first_look import PRIOR, first_look
from halfseen.view.recording import read_recording
from halfseen.view.stages import watched_cloud
from halfseen.world import WorldConfig

run = partial(shell.run, "look")


@pytest.fixture
def table(tmp_path) -> Path:
    depth = depth_of_cards(*TWO_CARDS)
    write_pcd(Cloud.from_depth(depth, K, "table"), tmp_path / "table.pcd")
    return tmp_path / "table.pcd"


def objects_of(*words):
    return shell.report("look", *words)["objects"]


def test_the_first_line_is_a_plain_sentence_and_the_table_is_aligned(table):
    lines = run(table).output.splitlines()
    assert lines[0].startswith("2 objects on the table; object 1 is hidden most, by object 0 (0.")
    assert len(lines) == 5
    end = lines[2].index("height [m]") + len("height [m]")
    assert [line[end - 5 : end - 2] for line in lines[3:]] == ["0.1", "0.1"]


def test_what_is_cut_is_named_where_it_hides_an_object(tmp_path):
    drawn = draw(Can(-0.40, 0.02), Can(-0.43, -0.08, 0.06, 0.14))
    write_pcd(drawn.cloud, tmp_path / "cut.pcd")
    first, second, *_, row = run(tmp_path / "cut.pcd").output.splitlines()
    assert first.startswith("1 object on the table; object 0 is hidden most, by something cut by the image border or ")
    assert second == "Left out: 1 cut by the image border."
    share = float(row.split()[7])
    assert share == pytest.approx(drawn.occlusion[0], abs=0.04)
    assert row.endswith(f"{share:.2f}  other ({share:.2f})")


def test_json_has_exactly_the_promised_keys(table):
    result = shell.report("look", table)
    assert list(result) == ["table", "objects", "hides"]
    assert list(result["table"]) == ["normal", "offset_m"]
    assert np.linalg.norm(result["table"]["normal"]) == pytest.approx(1.0)
    assert result["table"]["offset_m"] == pytest.approx(-0.6, abs=0.01)
    for number, seen in enumerate(result["objects"]):
        assert list(seen) == ["id", "centroid_m", "place_m", "height_m", "occlusion", "num_points", "is_upright"]
        assert seen["id"] == number
        assert [type(value) for value in seen["centroid_m"] + seen["place_m"]] == [float] * 6
        assert (type(seen["num_points"]), type(seen["is_upright"])) == (int, bool)
        assert seen["height_m"] == pytest.approx(0.12, abs=0.01)
        assert 0 <= seen["occlusion"] <= 1
    assert np.array(result["hides"]).shape == (2, 2)
    assert result["hides"][1][0] == pytest.approx(0.125, abs=0.02)  # counted in the image of the rear card alone


@pytest.fixture
def stained(tmp_path) -> Path:
    """White cards; the nearer one has a brown patch of 20 by 20 pixels."""
    depth = depth_of_cards(*TWO_CARDS)
    colours = np.full((240, 320, 3), (238, 236, 230), dtype=np.uint8)
    row, column = np.argwhere(np.isclose(depth, depth[120, 160], atol=0.05)).mean(axis=0).astype(int)
    colours[row - 10 : row + 10, column - 10 : column + 10] = (98, 62, 30)
    write_pcd(Cloud.from_depth(depth, K, "stained", colours), tmp_path / "stained.pcd")
    return tmp_path / "stained.pcd"


@pytest.mark.slow
def test_colour_tells_what_looks_dirty_and_labels_of_a_file_stand_before_it(stained, table, tmp_path):
    lines = run(stained).output.splitlines()
    assert lines[2].endswith("in view  label  P(dirty)")
    assert [line.split()[-2] for line in lines[3:]] == ["dirty", "clean"]
    labels = objects_of(stained)
    assert [seen["label"] for seen in labels] == ["dirty", "clean"]
    for seen in labels:
        assert list(seen)[-3:] == ["label", "share_in_view", "p_dirty"]
        assert seen["share_in_view"] == pytest.approx(0.3 * (1 - seen["occlusion"]))
    both = shell.report("look", stained, table, "--workers", 1)
    assert [each["objects"] for each in both] == [labels, objects_of(table)]
    # All but the labels is as without colour.
    plain = run(table).output.splitlines()
    assert [line[: len(plain[2])].rstrip() for line in lines[2:]] == plain[2:]
    (tmp_path / "labels.csv").write_text("object,label,share_in_view\n0,unknown,\n1,dirty,0.9\n")
    for cloud in (stained, table):
        labels = objects_of(cloud, "--labels", tmp_path / "labels.csv")
        assert [seen["label"] for seen in labels] == ["unknown", "dirty"]
        assert labels[1]["share_in_view"] == 0.9


@pytest.mark.slow
def test_a_picture_takes_the_place_of_a_file_where_that_is_said_and_of_no_pipe(refused, table, tmp_path):
    folder = tmp_path / "pictures"
    folder.mkdir()
    (folder / "a.png").write_bytes(b"mine")
    os.mkfifo(tmp_path / "pipe.png")
    assert "a device, a pipe" in refused("look", table, "--picture", tmp_path / "pipe.png", "--overwrite")
    run(table, "--picture", folder / "a.png", "--overwrite")
    assert (folder / "a.png").read_bytes().startswith(b"\x89PNG")
    assert os.listdir(folder) == ["a.png"]


def test_an_empty_table_is_refused_with_status_2(refused, tmp_path):
    write_pcd(Cloud.from_depth(depth_of_cards(), K, "empty"), tmp_path / "empty.pcd")
    assert "no objects on the table" in refused("look", tmp_path / "empty.pcd", "--json")
    cloud = read_cloud(table_paths()[0])
    write_pcd(Cloud(10.0 * cloud.points_m, cloud.shape, cloud.intrinsics), tmp_path / "far.pcd")
    assert "(points are 7.85 m away: check that they are in metres)" in refused("look", tmp_path / "far.pcd")


@pytest.fixture
def folder(tmp_path):
    for path in table_paths()[:2]:
        shutil.copy(path, tmp_path / path.name)
    (tmp_path / "notes.txt").write_text("no cloud")
    return tmp_path


def test_a_folder_has_a_line_a_cloud_in_the_order_of_their_names_and_json_is_that_of_each(typed, folder):
    status, out, err = typed("look", folder, "--workers", 1)
    assert (status, err) == (0, "")
    head, *rows = [line.split() for line in out.splitlines()]
    assert " ".join(head) == "cloud objects upright lying cut half hidden most hidden"
    assert [row[0] for row in rows] == [str(folder / f"table_0{k}.pcd") for k in range(2)]
    result = json.loads(typed("look", folder, "--json", "--workers", 1).out)
    for row, each in zip(rows, result, strict=True):
        assert each == {"cloud": row[0], **json.loads(typed("look", row[0], "--json").out)}
        hidden = [one["occlusion"] for one in each["objects"]]
        upright = sum(one["is_upright"] for one in each["objects"])
        assert [int(cell) for cell in row[1:4]] == [len(hidden), upright, len(hidden) - upright]
        assert int(row[5]) == sum(one >= 0.5 for one in hidden)
        assert float(row[6]) == pytest.approx(max(hidden), abs=0.005)


@pytest.mark.slow
def test_any_number_of_processes_prints_the_same(typed, folder):
    assert typed("look", folder, "--json", "--workers", 2) == typed("look", folder, "--json", "--workers", 1)


@pytest.mark.slow
def test_a_bad_cloud_stops_no_other_and_each_is_named(typed, refused, folder, tmp_path):
    (folder / "bad.ply").write_bytes(b"nonsense")
    status, out, err = typed("look", folder, folder / "missing.pcd", "--workers", 1)
    assert (status, len(out.splitlines())) == (2, 3)
    first, second = err.splitlines()
    assert "bad.ply" in first
    assert second == f"halfseen: {folder / 'missing.pcd'}: no such file"
    (tmp_path / "alone").mkdir()
    shutil.copy(folder / "bad.ply", tmp_path / "alone")
    refused("look", tmp_path / "alone", "--workers", 1)


@pytest.fixture(scope="module")
def coloured():
    """A shipped table in white; one cup has a stain, another a pattern of all colours all over."""
    cloud = read_cloud(table_paths()[7])
    view, rng = perceive(cloud), np.random.default_rng(0)
    colours = np.full(cloud.points_m.shape, (238, 236, 230), dtype=np.uint8)
    colours[view.objects[0].pixels[:400]] = (98, 62, 30)
    pattern = view.objects[1].pixels
    colours[pattern] = rng.integers(0, 256, (len(pattern), 3), dtype=np.uint8)
    return replace(cloud, colours=colours), view


def by_hand(occlusion, says_dirty, prior=0.6):
    """By Bayes: a label is right with probability ½ + .3·(1 − occ)^1.5."""
    right = 0.5 + 0.3 * (1.0 - occlusion) ** 1.5
    if_dirty, if_clean = (right, 1.0 - right) if says_dirty else (1.0 - right, right)
    return prior * if_dirty / (prior * if_dirty + (1.0 - prior) * if_clean)


@pytest.mark.slow
def test_every_door_shows_one_probability_and_a_pattern_tells_nothing(coloured, tmp_path):
    cloud, view = coloured
    look = first_look(view, cloud)
    assert [label.word for label in look.labels] == ["dirty", "unknown", "clean", "clean", "clean"]
    assert look.labels[1].num_stained_px >= StainCounter.fewest_px
    occluded = view.scene().occlusion
    expected = [by_hand(occluded[k], k == 0) if k != 1 else 0.6 for k in range(5)]
    assert look.chances == pytest.approx(expected, abs=1e-6)
    assert WorldConfig().dirty_share == PRIOR
    (stage,) = watched_cloud(cloud, view, None, None, 0).stages
    assert [shown.is_dirty for shown in stage.objects] == look.chances
    assert stage.events[-1] == look.words
    assert look.words.startswith("Labels by colour (dirty: 0; clean: 2, 3, 4; unknown: 1); P(dirty) is 0: 0.8")
    write_pcd(cloud, tmp_path / "a.pcd")
    said = shell.report("look", tmp_path / "a.pcd")
    assert [seen["p_dirty"] for seen in said["objects"]] == look.chances
    table = shell.run("look", tmp_path / "a.pcd").output.splitlines()
    assert [line.split()[-1] for line in table[-5:]] == [f"{chance:.2f}" for chance in look.chances]


def test_without_colour_or_file_all_stand_at_the_prior_and_a_file_counts_without_a_policy(coloured, tmp_path):
    cloud, view = coloured
    plain = first_look(view, replace(cloud, colours=None), dirty_share=0.3)
    assert (plain.labels, plain.words) == (None, "")
    assert plain.chances == pytest.approx([0.3] * 5)
    (tmp_path / "l.csv").write_text(
        "object,label\n" + "".join(f"{k},{'dirty' if k == 2 else 'unknown'}\n" for k in range(5))
    )
    result = first_look(view, cloud, tmp_path / "l.csv")
    assert result.chances[2] == pytest.approx(by_hand(view.scene().occlusion[2], True), abs=1e-6)
    assert result.chances[0] == pytest.approx(0.6)


TABLE = table_paths()[7]


@pytest.mark.slow
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
