import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import halfseen.scene
from halfseen.perception import read_cloud
from halfseen.scene import random_table, read_table, read_truth, table_paths
from halfseen.scene.__main__ import main
from halfseen.scene.draw import MIN_RETURNS_PX
from halfseen.scene.shipped import (
    KEPT_WITHIN_M,
    NUM_TABLES,
    SEEDS,
    cloud_path,
    made_with,
    truth_path,
    versions,
)

PACKAGE = Path(halfseen.scene.__file__).parent
same_versions = pytest.mark.skipif(
    made_with(0) != versions(), reason=f"the shipped tables were made with {made_with(0)}; here is {versions()}"
)


def assert_same_files(folder: Path, k: int) -> None:
    for path_of in (cloud_path, truth_path):
        assert path_of(folder, k).read_bytes() == path_of(PACKAGE, k).read_bytes(), path_of(folder, k).name


@pytest.mark.parametrize("k", range(NUM_TABLES))
def test_cloud_agrees_with_its_truth(k):
    cloud, truth, table = read_cloud(table_paths()[k]), read_truth(k), read_table(k)
    assert cloud.shape == truth.labels.shape == (480, 640)
    assert np.array_equal(cloud.intrinsics, table.camera.intrinsics)
    assert 5 <= truth.num_cups <= 10
    assert np.array_equal(table.is_fallen, truth.is_fallen)
    depth_m = cloud.points_m[:, 2].reshape(cloud.shape)
    assert np.nanmax(depth_m) <= KEPT_WITHIN_M
    for index, centroid_m in enumerate(truth.centroid_m):
        mine_m = depth_m[(truth.labels == index) & np.isfinite(depth_m)]
        assert len(mine_m) >= MIN_RETURNS_PX
        assert abs(np.median(mine_m) - centroid_m[2]) < 0.1


def test_the_ten_are_varied():
    truths = [read_truth(k) for k in range(NUM_TABLES)]
    occlusion = np.concatenate([truth.occlusion for truth in truths])
    assert {truth.num_cups for truth in truths} == set(range(5, 11))
    assert sum(truth.is_fallen.any() for truth in truths) >= 8
    assert np.histogram(occlusion, [0.0, 0.1, 0.3, 0.5, 0.7, 0.85])[0].min() >= 3


@pytest.mark.slow
@same_versions
def test_all_ten_come_out_the_same(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "halfseen.scene", "--out", str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    for k in range(NUM_TABLES):
        assert_same_files(tmp_path, k)


def test_a_folder_that_cannot_be_is_told_in_one_line(tmp_path):
    (tmp_path / "tables").write_text("in the way")
    result = CliRunner().invoke(main, ["--out", str(tmp_path)])
    assert result.exit_code == 2
    lines = [line for line in result.output.splitlines() if line.strip()]
    assert len(lines) == 1
    assert "choose another folder" in lines[0]


def test_reading_does_not_load_mujoco():
    code = (
        "import sys, halfseen.scene as s; s.table_paths(); s.read_truth(0); s.read_table(0); s.Cup; "
        "sys.exit('mujoco' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_stored_tables_are_those_of_their_seeds():
    assert read_table(5) == random_table(SEEDS[5])
