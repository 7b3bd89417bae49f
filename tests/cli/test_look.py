import json
import os
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import shell

from drawn_tables import TWO_CARDS, K, depth_of_cards
from halfseen.perception import Cloud, write_pcd
from halfseen.scene import table_paths

run = partial(shell.run, "look")


@pytest.fixture
def table(tmp_path) -> Path:
    depth = depth_of_cards(*TWO_CARDS)
    write_pcd(Cloud.from_depth(depth, K, "table"), tmp_path / "table.pcd")
    return tmp_path / "table.pcd"


def objects_of(*words):
    return json.loads(run(*words, "--json").output)["objects"]


def test_the_first_line_is_a_plain_sentence_and_the_table_is_aligned(table):
    lines = run(table).output.splitlines()
    assert lines[0].startswith("2 objects on the table; object 1 is hidden most, by object 0 (0.")
    assert len(lines) == 5
    end = lines[2].index("height [m]") + len("height [m]")
    assert [line[end - 5 : end - 2] for line in lines[3:]] == ["0.1", "0.1"]


def test_json_has_exactly_the_promised_keys(table):
    told = json.loads(run(table, "--json").output)
    assert list(told) == ["table", "objects", "hides"]
    assert list(told["table"]) == ["normal", "offset_m"]
    assert np.linalg.norm(told["table"]["normal"]) == pytest.approx(1.0)
    assert told["table"]["offset_m"] == pytest.approx(-0.6, abs=0.01)
    for number, seen in enumerate(told["objects"]):
        assert list(seen) == ["id", "centroid_m", "place_m", "height_m", "occlusion", "num_points", "is_upright"]
        assert seen["id"] == number
        assert [type(value) for value in seen["centroid_m"] + seen["place_m"]] == [float] * 6
        assert (type(seen["num_points"]), type(seen["is_upright"])) == (int, bool)
        assert seen["height_m"] == pytest.approx(0.12, abs=0.01)
        assert 0 <= seen["occlusion"] <= 1
    assert np.array(told["hides"]).shape == (2, 2)
    assert told["hides"][1][0] == pytest.approx(0.125, abs=0.02)  # counted in the image of the rear card alone


@pytest.fixture
def stained(tmp_path) -> Path:
    """White cards; the nearer one has a brown patch of 20 by 20 pixels."""
    depth = depth_of_cards(*TWO_CARDS)
    colours = np.full((240, 320, 3), (238, 236, 230), dtype=np.uint8)
    row, column = np.argwhere(np.isclose(depth, depth[120, 160], atol=0.05)).mean(axis=0).astype(int)
    colours[row - 10 : row + 10, column - 10 : column + 10] = (98, 62, 30)
    write_pcd(Cloud.from_depth(depth, K, "stained", colours), tmp_path / "stained.pcd")
    return tmp_path / "stained.pcd"


def test_colour_tells_what_looks_dirty_and_labels_of_a_file_stand_before_it(stained, table, tmp_path):
    lines = run(stained).output.splitlines()
    assert lines[2].endswith("in view  label  P(dirty)")
    assert [line.split()[-2] for line in lines[3:]] == ["dirty", "clean"]
    told = objects_of(stained)
    assert [seen["label"] for seen in told] == ["dirty", "clean"]
    for seen in told:
        assert list(seen)[-3:] == ["label", "share_in_view", "p_dirty"]
        assert seen["share_in_view"] == pytest.approx(0.3 * (1 - seen["occlusion"]))
    # All but the labels is as without colour.
    plain = run(table).output.splitlines()
    assert [line[: len(plain[2])].rstrip() for line in lines[2:]] == plain[2:]
    (tmp_path / "labels.csv").write_text("object,label,share_in_view\n0,unknown,\n1,dirty,0.9\n")
    for cloud in (stained, table):
        told = objects_of(cloud, "--labels", tmp_path / "labels.csv")
        assert [seen["label"] for seen in told] == ["unknown", "dirty"]
        assert told[1]["share_in_view"] == 0.9


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
    told = json.loads(typed("look", folder, "--json", "--workers", 1).out)
    for row, each in zip(rows, told, strict=True):
        assert each == {"cloud": row[0], **json.loads(typed("look", row[0], "--json").out)}
        hidden = [one["occlusion"] for one in each["objects"]]
        upright = sum(one["is_upright"] for one in each["objects"])
        assert [int(cell) for cell in row[1:4]] == [len(hidden), upright, len(hidden) - upright]
        assert int(row[5]) == sum(one >= 0.5 for one in hidden)
        assert float(row[6]) == pytest.approx(max(hidden), abs=0.005)


@pytest.mark.slow
def test_any_number_of_processes_prints_the_same(typed, folder):
    assert typed("look", folder, "--json", "--workers", 2) == typed("look", folder, "--json", "--workers", 1)


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
