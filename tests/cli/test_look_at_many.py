"""`halfseen look` at several clouds: a line each, whoever looks, and the bad ones named."""

import json
import shutil

import pytest

from halfseen.scene import table_paths


@pytest.fixture
def folder(tmp_path):
    for path in table_paths()[:3]:
        shutil.copy(path, tmp_path / path.name)
    (tmp_path / "notes.txt").write_text("no cloud")
    return tmp_path


def test_a_folder_has_a_line_a_cloud_in_the_order_of_their_names(typed, folder):
    status, out, err = typed("look", folder, "--workers", 1)
    assert (status, err) == (0, "")
    head, *rows = [line.split() for line in out.splitlines()]
    assert " ".join(head) == "cloud objects upright lying cut half hidden most hidden"
    assert [row[0] for row in rows] == [str(folder / f"table_0{k}.pcd") for k in range(3)]
    for row in rows:
        alone = json.loads(typed("look", row[0], "--json").out)["objects"]
        hidden = [each["occlusion"] for each in alone]
        upright = sum(each["is_upright"] for each in alone)
        assert [int(cell) for cell in row[1:4]] == [len(alone), upright, len(alone) - upright]
        assert int(row[5]) == sum(each >= 0.5 for each in hidden)
        assert float(row[6]) == pytest.approx(max(hidden), abs=0.005)


def test_json_is_that_of_each_cloud(typed, folder):
    told = json.loads(typed("look", folder, "--json", "--workers", 1).out)
    for each in told:
        assert each == {"cloud": each["cloud"], **json.loads(typed("look", each["cloud"], "--json").out)}


@pytest.mark.slow
def test_any_number_of_processes_prints_the_same(typed, folder):
    assert typed("look", folder, "--json", "--workers", 2) == typed("look", folder, "--json", "--workers", 1)


def test_a_bad_cloud_stops_no_other_and_each_is_named(typed, folder):
    (folder / "bad.ply").write_bytes(b"nonsense")
    status, out, err = typed("look", folder, folder / "missing.pcd", "--workers", 1)
    assert status == 2
    assert len(out.splitlines()) == 4
    first, second = err.splitlines()
    assert "bad.ply" in first
    assert second == f"halfseen: {folder / 'missing.pcd'}: no such file"


def test_where_no_cloud_can_be_looked_at_only_that_is_said(typed, tmp_path):
    (tmp_path / "bad.ply").write_bytes(b"nonsense")
    status, out, err = typed("look", tmp_path, "--workers", 1)
    assert (status, out, len(err.splitlines())) == (2, "", 1)


def test_what_is_of_one_cloud_is_refused_of_several(refused, folder, tmp_path):
    assert "--picture a.png: it is of one cloud" in refused("look", folder, "--picture", "a.png")
    assert "--labels a.csv: it is of one cloud" in refused("look", folder, "--labels", "a.csv")


def test_a_folder_without_clouds_is_refused(refused, tmp_path):
    assert "no cloud in it ends in .pcd, .ply, .npz; name another folder" in refused("look", tmp_path)
